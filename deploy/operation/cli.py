"""deploy-run: a policy drives one robot at a fixed rate, from arming to rest."""

import gc
import math
import re
import time
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from deploy.backends.backend import Backend, Request
from deploy.command_line import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.estimation.heat_file import PERIOD_S as HEAT_S
from deploy.estimation.heat_file import HeatFile
from deploy.operation.clock import Unpaced, WallClock
from deploy.operation.loop_timing import Every, Pace
from deploy.operation.robot_run import Ending, Shift
from deploy.operation.summary import report
from deploy.plugins import BACKENDS, installed, load
from deploy.policy.policy import Policy
from deploy.runtime import Runtime
from deploy.telemetry.console import Show, snapshot
from deploy.telemetry.recorder import Recorder, check_folder
from robots.distributions import load_distributions
from robots.draws import Draw, load_draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

SEED = 7
SPEED_MAX = 1000.0
SHOW_S, VIEW_S = 0.2, 1 / 30
EXIT = {Ending.DONE: PASSED, Ending.INTERRUPTED: INTERRUPTED}


def run(
    policy: Annotated[Path, typer.Option(help="ONNX file that policy-export wrote")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="name in robots/, or a folder")] = "arm6",
    backend: Annotated[
        str, typer.Option(help=f"wire to the robot: {', '.join(installed(BACKENDS))}")
    ] = "sim",
    duration: Annotated[float, typer.Option(help="s of robot time; inf: until Ctrl-C")] = math.inf,
    speed: Annotated[str, typer.Option(help="robot time by wall time: a factor, or max")] = "1",
    seed: Annotated[
        int | None, typer.Option(help=f"of the goals, and of the simulated robot  [{SEED}]")
    ] = None,
    draw: Annotated[
        str | None,
        typer.Option(
            help="SEED:ROBOT, or FILE:ROBOT with a soak's draws.json: a robot of it, its noise, its goals"
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="folder; a former run in it is replaced, its motors stay warm")
    ] = Path("out/run"),
    view: Annotated[bool, typer.Option("--view", help="open MuJoCo's viewer")] = False,
) -> int:
    """Drive one robot by a policy: arm, work, and come to rest.

    Ctrl-C asks for a controlled stop, a second one cuts power. Exit codes: 0 done, 1 the robot stopped and could
    not go on, 2 bad input and nothing moved, 70 something broke, 130 interrupted.
    """
    factor = _factor(speed)
    if not duration > 0:
        raise ConfigError(f"--duration {duration}: expected s above 0, or inf")
    wire = _backend(backend, {"--draw": draw is not None, "--view": view})
    spec = load_robot(robot)
    origin, source, given = _source(spec, seed, draw)
    brain = Policy.load(policy, spec)
    request = Request(spec=spec, seed=source, gains=brain.contract.action.gains, draw=given)
    wire.check(request)
    check_folder(out)
    about = {"robot": spec.name, "robot_digest": spec.digest, "policy": str(policy)}
    about |= {"policy_digest": brain.digest, "backend": backend, "seed": origin, "speed": speed}
    with closing(wire.open(request)) as body:
        view_step = wire.viewer(body) if view else None
        runtime = Runtime(spec, brain.contract, body, [source], brain)
        heat_file = HeatFile(out / "heat.json", runtime, same=draw is None)
        wire.attach(body, runtime)
        recorder = Recorder(out, runtime, start_ns=time.time_ns(), about=about)
        watchers: list[Every[Shift]] = [Every(HEAT_S, heat_file.offer)]
        if view_step:
            watchers.append(Every(VIEW_S, view_step))
        return _lived(
            runtime, recorder, heat_file, factor=factor, duration=duration, about=about, watchers=watchers
        )


def _factor(speed: str) -> float:
    """Robot time by wall time; infinite for `max`."""
    if speed == "max":
        return math.inf
    try:
        factor = float(speed)
    except ValueError:
        factor = math.nan
    if not 0 < factor <= SPEED_MAX:
        raise ConfigError(f"--speed {speed}: expected a factor above 0 and at most {SPEED_MAX:g}, or max")
    return factor


def _backend(name: str, simulation_options: Mapping[str, bool]) -> Backend[Any]:
    backend: Backend[Any] = load(BACKENDS, name, f"--backend {name}")()
    given = [option for option, is_given in simulation_options.items() if is_given]
    if given and not backend.abilities.simulated:
        raise ConfigError(f"--backend {name}: found {given[0]}, which only simulated robots have")
    return backend


def _source(
    spec: RobotSpec, seed: int | None, draw: str | None
) -> tuple[str, np.random.SeedSequence, Draw | None]:
    """All that is random about the robot, in words and as it is: the first of a seed, or one of a soak."""
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


def _lived(
    runtime: Runtime,
    recorder: Recorder,
    heat_file: HeatFile,
    *,
    factor: float,
    duration: float,
    about: dict[str, str],
    watchers: list[Every[Shift]],
) -> int:
    """Everything from the first tick to the summary."""
    hz = runtime.spec.rates.control_hz
    asked = None if math.isinf(factor) else hz * factor
    pace = Pace(Unpaced() if asked is None else WallClock(1 / asked), hz)
    screen, title = Show(), f"{about['robot']}  {about['policy']}  {about['backend']}"

    def show(shift: Shift) -> None:
        picture = snapshot(
            runtime,
            pace,
            title=title,
            reason=shift.reason,
            left=shift.left,
            hz=asked,
            stops=list(shift.tally.last),
            notes=[lost for lost in (recorder.lost, heat_file.lost) if lost],
        )
        screen.offer(picture)

    shift = Shift(runtime, pace, recorder, duration=duration, watchers=[Every(SHOW_S, show), *watchers])
    # What was made for good is not looked at again in the middle of a tick.
    gc.collect()
    gc.freeze()
    try:
        ending = shift.live()
    finally:
        gc.unfreeze()
        if runtime.ticks:
            show(shift)
        recorder.close()
        heat_file.close()
        screen.close()
        report(shift, about, recorder.path.parent / "summary.json", lost=heat_file.lost)
    return EXIT.get(ending, BUDGET_EXCEEDED)


def cli() -> None:
    """The command line."""
    main(run)


if __name__ == "__main__":
    cli()
