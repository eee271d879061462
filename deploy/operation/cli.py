"""deploy-run: drive one robot by a policy at a fixed rate, from arming to rest."""

import gc
import math
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.backends.backend import Backend, Request
from deploy.command_line import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.operation.loop_timing import Clock, LoopTiming, RateLimited, Unpaced, WallClock
from deploy.operation.options import SEED, random_source, speed_factor
from deploy.operation.robot_run import Ending, RobotRun, Watcher
from deploy.operation.summary import report
from deploy.operation.temperature_file import PERIOD_S as HEAT_S
from deploy.operation.temperature_file import TemperatureFile
from deploy.plugins import BACKENDS, installed, load
from deploy.policy.policy import Policy
from deploy.runtime import Runtime
from deploy.telemetry.console import ConsoleProcess, snapshot
from deploy.telemetry.recorder import Recorder, check_folder
from robots.errors import ConfigError
from robots.spec import load_robot

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
    factor = speed_factor(speed)
    if not duration > 0:
        raise ConfigError(f"--duration {duration}: expected s above 0, or inf")
    connection = _backend(backend, simulation={"--draw": draw is not None, "--view": view})
    spec = load_robot(robot)
    seed_text, source, drawn = random_source(spec, seed, draw)
    loaded = Policy.load(policy, spec)
    action = loaded.contract.action
    request = Request(spec=spec, seeds=[source], gains=action.gains, mode=action.control_mode, draw=drawn)
    connection.check(request)
    check_folder(out)
    about = {"robot": spec.name, "robot_digest": spec.digest, "policy": str(policy)}
    about |= {"policy_digest": loaded.digest, "backend": backend, "seed": seed_text, "speed": speed}
    with closing(connection.open(request)) as connected:
        viewers = [RateLimited(VIEW_S, connection.viewer(connected))] if view else []
        runtime = Runtime(spec, loaded.contract, connected, [source], loaded)
        heat_file = TemperatureFile(
            out / "heat.json", spec, runtime.estimator.windings, same_robot=draw is None
        )
        connection.attach(connected, runtime)
        recorder = Recorder(out, runtime, start_ns=time.time_ns(), about=about)
        timing = _timing(spec.rates.control_hz, factor)
        files = recorder, heat_file
        return _execute(runtime, timing, files, duration=duration, about=about, viewers=viewers)


def _backend(name: str, simulation: dict[str, bool]) -> Backend[Any]:
    """Return the backend of that name; refuse given options of the `simulation` for any other."""
    backend: Backend[Any] = load(BACKENDS, name, f"--backend {name}")()
    given = [option for option, is_given in simulation.items() if is_given]
    if given and not backend.abilities.simulated:
        raise ConfigError(f"--backend {name}: found {given[0]}, which only simulated robots have")
    return backend


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
