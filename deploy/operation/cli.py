"""deploy-run: drive one robot by a policy at a fixed rate, from arming to rest."""

import gc
import math
import re
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from deploy.backends.backend import Backend, Request
from deploy.command_line import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.estimation.temperature_file import PERIOD_S as HEAT_S
from deploy.estimation.temperature_file import TemperatureFile
from deploy.operation.clock import Clock, Unpaced, WallClock
from deploy.operation.loop_timing import LoopTiming, RateLimited
from deploy.operation.robot_run import Ending, RobotRun, Watcher
from deploy.operation.summary import report
from deploy.plugins import BACKENDS, installed, load
from deploy.policy.policy import Policy
from deploy.runtime import Runtime
from deploy.telemetry.console import ConsoleProcess, snapshot
from deploy.telemetry.recorder import Recorder, check_folder
from robots.distributions import load_distributions
from robots.draws import Draw, load_draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

SEED = 7
SPEED_MAX = 1000.0
CONSOLE_S, VIEW_S = 0.2, 1 / 30
EXIT = {Ending.DONE: PASSED, Ending.INTERRUPTED: INTERRUPTED}

PolicyFile = Annotated[Path, typer.Option(help="ONNX file written by policy-export")]
RobotName = Annotated[str, typer.Option(help="name in robots/, or a folder")]
BackendName = Annotated[str, typer.Option(help=f"connection to the robot: {', '.join(installed(BACKENDS))}")]
Duration = Annotated[float, typer.Option(help="s of robot time; inf: until Ctrl-C")]
Speed = Annotated[str, typer.Option(help="robot time divided by wall time: a factor, or max")]
Seed = Annotated[int | None, typer.Option(help=f"of the goals and of a simulated robot  [{SEED}]")]
DrawName = Annotated[
    str | None,
    typer.Option(
        help="robot of a soak, with its noise and its goals: SEED:ROBOT, or FILE:ROBOT with the soak's draws.json"
    ),
]
Out = Annotated[
    Path, typer.Option(help="folder; a previous run in it is replaced, motor temperatures are kept")
]
ViewFlag = Annotated[bool, typer.Option("--view", help="open MuJoCo's viewer")]


def run(
    policy: PolicyFile = Path("out/arm.onnx"),
    robot: RobotName = "arm6",
    backend: BackendName = "sim",
    duration: Duration = math.inf,
    speed: Speed = "1",
    seed: Seed = None,
    draw: DrawName = None,
    out: Out = Path("out/run"),
    view: ViewFlag = False,
) -> int:
    """Drive one robot by a policy: arm, work, and come to rest.

    Ctrl-C asks for a controlled stop, a second one cuts power. Exit codes: 0 done, 1 the robot stopped and could
    not go on, 2 bad input and nothing moved, 70 internal error, 130 interrupted.
    """
    factor = _factor(speed)
    if not duration > 0:
        raise ConfigError(f"--duration {duration}: expected s above 0, or inf")
    connection = _backend(backend, simulation={"--draw": draw is not None, "--view": view})
    spec = load_robot(robot)
    seed_text, source, drawn = _source(spec, seed, draw)
    brain = Policy.load(policy, spec)
    request = Request(spec=spec, seed=source, gains=brain.contract.action.gains, draw=drawn)
    connection.check(request)
    check_folder(out)
    about = {"robot": spec.name, "robot_digest": spec.digest, "policy": str(policy)}
    about |= {"policy_digest": brain.digest, "backend": backend, "seed": seed_text, "speed": speed}
    with closing(connection.open(request)) as body:
        viewers = [RateLimited(VIEW_S, connection.viewer(body))] if view else []
        runtime = Runtime(spec, brain.contract, body, [source], brain)
        heat_file = TemperatureFile(
            out / "heat.json", spec, runtime.estimator.windings, same_robot=draw is None
        )
        connection.attach(body, runtime)
        recorder = Recorder(out, runtime, start_ns=time.time_ns(), about=about)
        timing = _timing(spec.rates.control_hz, factor)
        files = recorder, heat_file
        return _execute(runtime, timing, files, duration=duration, about=about, viewers=viewers)


def _factor(speed: str) -> float:
    """Return robot time divided by wall time; infinite for `max`."""
    if speed == "max":
        return math.inf
    try:
        factor = float(speed)
    except ValueError:
        factor = math.nan
    if not 0 < factor <= SPEED_MAX:
        raise ConfigError(f"--speed {speed}: expected a factor above 0 and at most {SPEED_MAX:g}, or max")
    return factor


def _backend(name: str, simulation: dict[str, bool]) -> Backend[Any]:
    """Return the backend of that name; refuse given options of the `simulation` for any other."""
    backend: Backend[Any] = load(BACKENDS, name, f"--backend {name}")()
    given = [option for option, is_given in simulation.items() if is_given]
    if given and not backend.abilities.simulated:
        raise ConfigError(f"--backend {name}: found {given[0]}, which only simulated robots have")
    return backend


def _source(
    spec: RobotSpec, seed: int | None, draw: str | None
) -> tuple[str, np.random.SeedSequence, Draw | None]:
    """Return the seed of everything random, in words and as such, and the draw if a file holds it."""
    if draw is None:
        number = SEED if seed is None else seed
        if number < 0:
            raise ConfigError(f"--seed {number}: expected 0 or more")
        return str(number), robot_seed(number, 0), None
    match = re.fullmatch(r"(.+):(\d{1,9})", draw)
    if not match:
        raise ConfigError(f"--draw {draw}: expected SEED:ROBOT, or FILE:ROBOT of a soak's draws.json")
    if seed is not None:
        raise ConfigError(f"--draw {draw}: found --seed {seed} beside it, expected one of them")
    robot = int(match[2])
    if re.fullmatch(r"\d{1,18}", match[1]):
        return draw, robot_seed(int(match[1]), robot), None
    number, robots = load_draw(Path(match[1]), load_distributions(spec), spec)
    if robot >= robots.robots:
        raise ConfigError(
            f"--draw {draw}: found robot {robot}, expected one of the {robots.robots} from 0 on"
        )
    return draw, robot_seed(number, robot), robots.robot(robot)


def _timing(control_hz: int, factor: float) -> LoopTiming:
    clock: Clock = Unpaced() if math.isinf(factor) else WallClock(1 / (control_hz * factor))
    return LoopTiming(clock, control_hz)


def _execute(
    runtime: Runtime,
    timing: LoopTiming,
    files: tuple[Recorder, TemperatureFile],
    *,
    duration: float,
    about: dict[str, str],
    viewers: Sequence[Watcher],
) -> int:
    """Run from the first tick to the summary; return the exit code."""
    recorder, heat_file = files
    console, title = ConsoleProcess(), f"{about['robot']}  {about['policy']}  {about['backend']}"

    def show(run: RobotRun) -> None:
        notes = [lost for lost in (recorder.lost, heat_file.error) if lost]
        console.offer(snapshot(run, title=title, notes=notes))

    watchers: list[Watcher] = [RateLimited(CONSOLE_S, show), RateLimited(HEAT_S, heat_file.save), *viewers]
    robot_run = RobotRun(runtime, timing, recorder, duration=duration, watchers=watchers)
    # Objects made so far stay: the garbage collector shall not visit them in the middle of a tick.
    gc.collect()
    gc.freeze()
    try:
        ending = robot_run.run()
    finally:
        gc.unfreeze()
        if runtime.ticks:
            show(robot_run)
        recorder.close()
        heat_file.close()
        console.close()
        report(robot_run, about, recorder.path.parent / "summary.json", lost=heat_file.error)
    return EXIT.get(ending, BUDGET_EXCEEDED)


def cli() -> None:
    """Run `deploy-run`."""
    main(run)


if __name__ == "__main__":
    cli()
