"""Valid files of every kind that the importers and robot-init read, small and made in seconds."""

import shutil
from collections.abc import Callable
from pathlib import Path

import torch

from deploy.policy.policy_file import read_policy_file
from eval.fuzz import examples
from policies.bench import contract, write_files
from policies.training.checkpoint import ROLLOUT_MIN, save_checkpoint
from policies.training.networks import Actor
from policies.training.recipe import RECIPES
from robots.spec import load_robot

LAYERS = (8, 8)
DESCRIPTOR = """
actions:
- full_path: isaaclab.envs.mdp.actions.joint_actions.JointPositionAction
  joint_names: [a, b]
  scale: 0.5
  offset: [0.1, 0.2]
  clip: null
articulations:
  robot: {joint_names: [a, b], default_joint_stiffness: [40.0, 40.0], default_joint_damping: [1.0, 1.0]}
observations:
  policy:
  - name: joint_pos_rel
    shape: [2]
    overloads: {clip: null, scale: null, history_length: 0, flatten_history_dim: true}
    extras: {modifiers: null}
    joint_names: [a, b]
    joint_pos_offsets: [0.1, 0.2]
    joint_vel_offsets: null
scene: {dt: 0.02}
"""
DESCRIBED = 2
"""Observations of the descriptor."""
URDF = """<robot name="two">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.3"/><geometry><cylinder radius="0.03" length="0.3"/></geometry></collision></link>
<link name="lower"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.3"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="3"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/><limit effort="20" velocity="3"/></joint>
</robot>
"""


def make_import(kind: str) -> Callable[[Path], None]:
    """Return a function that writes a policy file of one kind of `policies.bench.write_files`."""

    def make(folder: Path) -> None:
        files = folder / "all"
        files.mkdir()
        path, _ = write_files(files, load_robot(examples.ARM), LAYERS)[kind]
        path.rename(folder / f"policy{path.suffix}")
        for beside in files.glob("policy.onnx.data"):
            beside.rename(folder / beside.name)
        shutil.rmtree(files)

    return make


def make_draft(folder: Path) -> None:
    """Write a contract's TOML, a recipe and a descriptor."""
    (folder / "draft.toml").write_text(contract(load_robot(examples.ARM), {}), encoding="utf-8")
    shutil.copyfile(RECIPES / "arm.toml", folder / "recipe.toml")
    (folder / "descriptor.yaml").write_text(DESCRIPTOR, encoding="utf-8")


def make_checkpoint(folder: Path) -> None:
    """Write a checkpoint of policy-train for the arm."""
    policy = examples.make_policy(folder)
    promise = read_policy_file(policy).contract
    actor = Actor(promise.observation_size, promise.action_size, LAYERS)
    rollout = torch.zeros(ROLLOUT_MIN, promise.observation_size)
    save_checkpoint(folder / "arm.pt", actor, promise, rollout, seed=examples.SEED, recipe="none")
    policy.unlink()


def make_stable_baselines(folder: Path) -> None:
    """Write the files of Stable-Baselines3: a policy and its normalizer."""
    import gymnasium
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    wrapped = VecNormalize(DummyVecEnv([lambda: gymnasium.make("Pendulum-v1")]))
    model = PPO("MlpPolicy", wrapped, seed=0, device="cpu", policy_kwargs={"net_arch": [*LAYERS]})
    model.save(folder / "policy.zip")
    wrapped.save(str(folder / "vecnormalize.pkl"))


def make_urdf(folder: Path) -> None:
    """Write a vendor's robot of two links."""
    (folder / "two.urdf").write_text(URDF, encoding="utf-8")
