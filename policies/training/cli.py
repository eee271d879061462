"""Command policy-train: PPO of rsl-rl-lib with the shipped runtime as environment."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rsl_rl.models import MLPModel
from rsl_rl.runners import OnPolicyRunner
from torch import Tensor

from deploy.command_line import PASSED, main
from deploy.telemetry.folder_lock import locked
from deploy.telemetry.output_files import check_folder
from policies.training.checkpoint import bytes_of, save_checkpoint
from policies.training.curves import draw_curves
from policies.training.envs import RuntimeEnv
from policies.training.networks import Actor
from policies.training.recipe import Learner, Recipe, contract_of, find_recipe, load_recipe
from policies.training.watchers import Film, JointSpeeds, Window
from robots.bounded_text import read_text
from robots.errors import ConfigError, OutputError, ResultLostError, printable
from robots.spec import RobotSpec, load_robot
from robots.strict import TOML_CHARACTERS_MAX

SAVE_INTERVAL = 200
SPEEDS_EVERY = 10
"""Iterations between two lines of the largest joint speeds."""
ROLLOUT = 2048
"""Observations kept in a checkpoint, to compare torch and ONNX Runtime at export."""


def train(file: Path, out: Path, *, threads: int, view: bool = False, video: Path | None = None) -> Path:
    """Train by a recipe, write a checkpoint and return its path.

    A recipe that does not fit its robot is refused before anything is written; a folder that another training uses, or
    has used, before anything in it is replaced.

    Args:
        file: the recipe; a checkpoint keeps its text. out: folder for TensorBoard's events, curves and checkpoint.
        threads: for physics; results do not depend on it.
        view: show robot 0 while it learns. video: of the trained policy on robot 0.
    """
    recipe, text = load_recipe(file), read_text(file, TOML_CHARACTERS_MAX)
    spec = load_robot(recipe.robot, f"{file}: robot")
    contract_of(recipe, spec, {}, file)
    check_folder(out)
    with locked(out):
        _check_unused(out, recipe.name)
        return _train(recipe, text, spec, out, threads, view, video)


def _check_unused(out: Path, name: str) -> None:
    """Refuse (OutputError) a folder with a file that a training of that name would replace, or mix with its own."""
    patterns = ("*tfevents*", "model_*.pt", f"{name}.pt", f"{name}.png")  # TensorBoard reads all of the first
    for found in os.listdir(out):  # links that lead nowhere included
        if any(fnmatchcase(found, pattern) for pattern in patterns):
            raise OutputError(
                f"--out {out}: found {printable(found)} of another training, expected another folder"
            )


class _Runner(OnPolicyRunner):
    def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
        """Write the state of the training.

        Raises:
            OutputError: it cannot be written.
        """
        state = {**self.alg.save(), "iter": self.current_learning_iteration, "infos": infos}
        file = Path(path)
        try:
            file.unlink(missing_ok=True)  # a link that was made since the start
            with file.open("xb") as opened:
                opened.write(bytes_of(state))
        except OSError as e:
            with suppress(OSError):
                file.unlink()  # half of a state
            raise OutputError(f"--out {path}: cannot be written: {e.strerror}") from e


@contextmanager
def _work_at_stake(out: Path) -> Iterator[None]:
    """Time was spent on what cannot be written: that is no bad input.

    TensorBoard writes in a thread, and raises that thread's error in this one as well: it is printed once. The thread
    may still be about to raise it when the block has failed.
    """
    hook = threading.excepthook
    threading.excepthook = lambda ended: None if isinstance(ended.exc_value, OSError) else hook(ended)
    try:
        yield
    except OutputError as e:
        raise ResultLostError(f"not kept: {e}") from e
    except OSError as e:
        place, why = os.fsdecode(e.filename or out), e.strerror or e
        raise ResultLostError(f"not kept: --out {place}: cannot be written: {why}") from e
    threading.excepthook = hook


def _train(
    recipe: Recipe, text: str, spec: RobotSpec, out: Path, threads: int, view: bool, video: Path | None
) -> Path:
    """Train in a folder that is locked; return the path of the checkpoint, which keeps the recipe's text."""
    film = None if video is None else Film(video, spec, recipe.promise.policy_hz)
    env, policy = _learn(recipe, spec, out, threads, view)
    rollout, success = roll_out(env, policy, film)
    print(f"goals reached without exploration: {100 * success:.2f} %")
    trained = {"recipe": recipe.name, "seed": str(recipe.seed), "goals_reached": f"{success:.4f}"}
    actor, contract = Actor.from_rsl_rl(policy), contract_of(recipe, spec, trained)
    path = out / f"{recipe.name}.pt"
    with _work_at_stake(out):
        save_checkpoint(path, actor, contract, rollout, seed=recipe.seed, recipe=text)
        draw_curves(out, out / f"{recipe.name}.png")
        if film is not None:
            film.write()
    return path


def _learn(
    recipe: Recipe, spec: RobotSpec, out: Path, threads: int, view: bool
) -> tuple[RuntimeEnv, MLPModel]:
    """Run the recipe's learner; return the environment and the trained policy."""
    torch.manual_seed(recipe.seed)
    # One thread: torch's sums depend on the number of threads, so results would depend on the machine.
    torch.set_num_threads(1)
    env = RuntimeEnv(recipe, spec, threads=threads)
    env.watchers.append(JointSpeeds(env.episodes, spec, SPEEDS_EVERY * recipe.learner.num_steps_per_env))
    if view:
        env.watchers.append(Window(env.episodes))
    runner = _Runner(env, learner_settings(recipe.learner), log_dir=str(out), device="cpu")
    runner.logger.git_status_repos.clear()  # else it keeps the changes of the repository that it is installed in
    for number, stage in enumerate(recipe.learner.stages):
        _set_learning_rate(runner, stage.learning_rate)
        with _work_at_stake(out):
            try:
                runner.learn(stage.iterations, init_at_random_ep_len=number == 0)
            except (RuntimeError, ValueError) as e:  # of torch, which draws actions around no number
                _check_finite(runner, e)
                raise
            finally:
                if writer := runner.logger.writer:
                    writer.close()  # else its thread writes the last events later, or not at all
        _check_finite(runner)
        runner.current_learning_iteration += 1
    return env, runner.get_inference_policy()


def _check_finite(runner: OnPolicyRunner, cause: Exception | None = None) -> None:
    """Refuse (ConfigError) weights of the policy that are no finite numbers, the `cause` of an error or not yet."""
    if not all(bool(weights.isfinite().all()) for weights in runner.alg.actor.parameters()):
        after = f"after iteration {runner.current_learning_iteration}: try a lower learning_rate"
        raise ConfigError(f"learner: weights of the policy are not finite {after}") from cause


def _set_learning_rate(runner: OnPolicyRunner, rate: float) -> None:
    runner.alg.learning_rate = rate
    for group in runner.alg.optimizer.param_groups:
        group["lr"] = rate


def roll_out(env: RuntimeEnv, policy: MLPModel, film: Film | None = None) -> tuple[Tensor, float]:
    """Run one episode without exploration; return (ROLLOUT, N) observations over it and the share of goals reached."""
    seen, due, reached = [], 0, 0
    with torch.inference_mode():
        for _ in range(env.max_episode_length):
            observation = env.get_observations()
            seen.append(observation["actor"])
            if film is not None:
                film.capture(env.episodes)
            env.step(policy(observation))
            due += env.due
            reached += env.reached
    rows = np.linspace(0, len(seen) * env.num_envs - 1, ROLLOUT).round().astype(int)
    return torch.cat(seen)[torch.from_numpy(rows)], reached / max(1, due)


def learner_settings(learner: Learner) -> dict[str, Any]:
    """Return the recipe as rsl_rl's configuration."""
    network: dict[str, Any] = {"class_name": "MLPModel", "hidden_dims": list(learner.hidden)}
    network |= {"activation": "elu", "obs_normalization": True}
    distribution = {"class_name": "GaussianDistribution", "init_std": learner.init_std, "std_type": "log"}
    ppo = {"class_name": "PPO", "schedule": "fixed", "rnd_cfg": None, "symmetry_cfg": None}
    return {
        "num_steps_per_env": learner.num_steps_per_env,
        "save_interval": SAVE_INTERVAL,
        "obs_groups": {"actor": ["actor"], "critic": ["actor", "privileged"]},
        "actor": {**network, "distribution_cfg": distribution},
        "critic": network,
        "algorithm": ppo | learner.model_dump(exclude={"stages", "num_steps_per_env", "hidden", "init_std"}),
    }


RECIPE = typer.Option(help="Recipe: a name in policies/ or a path.")
OUT = typer.Option(help="Folder for checkpoint, curves and TensorBoard events.")
VIEW = typer.Option("--view", help="Show robot 0 in MuJoCo's viewer while it learns.")
VIDEO = typer.Option(
    help="GIF or MP4 file: the trained policy on robot 0; needs OpenGL (EGL), but no display."
)
THREADS = typer.Option(help="Threads for physics; results do not depend on it.", min=1, max=1024)


def policy_train(
    recipe: Annotated[str, RECIPE] = "arm",
    out: Annotated[Path, OUT] = Path("out/train"),
    threads: Annotated[int, THREADS] = 2,
    view: Annotated[bool, VIEW] = False,
    video: Annotated[Path | None, VIDEO] = None,
) -> int:
    """Train a policy by a recipe; the checkpoint is <out>/<recipe>.pt."""
    path = train(find_recipe(recipe), out, threads=threads, view=view, video=video)
    print(f"checkpoint: {printable(str(path))}")
    return PASSED


def cli() -> None:
    """Entry point of `policy-train`."""
    main(policy_train)
