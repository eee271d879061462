import pytest

pytest.importorskip("mujoco")
pytest.importorskip("tomlkit")

import numpy as np
import tomlkit

from deploy.policy.action import ActionSpec
from deploy.simulation import simulate
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.contracts import arm_contract, term
from support.runtimes import Saying, every, heard

ANSWERS = {
    "height_min_m": 0.1,
    "command_min": [0.0, 0.0, 0.0],
    "command_max": [0.5, 0.0, 0.0],
    "tool": "panda_link8",
    "q_home": 0.0,
    "qd_max": 2.0,
    "qdd_max": 4.0,
    "qddd_max": 100.0,
    "source": "estimate",
    "housing_resistance_k_per_w": 4.0,
    "housing_capacity_j_per_k": 1200.0,
    "iron_w_s2": 3e-5,
    "winding_soft_c": 80.0,
    "winding_max_c": 110.0,
    "housing_soft_c": 70.0,
    "housing_max_c": 90.0,
    "gear": 101.0,
    "torque_constant": 0.1,
    "resistance_ohm": 0.5,
    "winding_resistance_k_per_w": 1.0,
    "winding_capacity_j_per_k": 40.0,
    "supply_v": 48.0,
    "kp": 6000.0,
    "kd": 300.0,
    "torque_max": 87.0,
    "armature": 0.5,
    "power_w": 400.0,
    "contact_n": 500.0,
    "torque_rate": 1000.0,
}
"""What somebody with the data sheets fills in."""


def fill_in(folder, answers=ANSWERS):
    """Every "?" by its key."""

    def fill(table):
        for key, value in list(table.items()):
            if value == "?":
                table[key] = answers[key]
            for inner in value if isinstance(value, list) else [value]:
                if isinstance(inner, dict):
                    fill(inner)

    for name in ("robot.toml", "limits.toml"):
        document = tomlkit.parse((folder / name).read_text())
        fill(document)
        (folder / name).write_text(tomlkit.dumps(document))
    return load_robot(folder)


def hold(spec, seconds, robots=2):
    """Arm simulated robots at home and let nobody move them: the runtime, and rad, the worst that they left home by."""
    size = spec.n
    contract = arm_contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        observation=(term("joint_position", size), term("last_action", size)),
        action=ActionSpec(
            mode="position_increment", size=size, scale=(0.05,) * size, clip=(-1.0, 1.0), leash_rad=0.3
        ),
    )
    seeds = [robot_seed(3, robot) for robot in range(robots)]
    policy = Saying(robots)
    policy.action = np.zeros((robots, size))
    runtime, _ = simulate(spec, contract, seeds, policy)
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    worst = 0.0
    for _ in range(round(seconds / spec.dt)):
        runtime.tick()
        worst = max(worst, np.abs(runtime.robot.truth().q - spec.joint_array("q_home")).max())
    return runtime, worst
