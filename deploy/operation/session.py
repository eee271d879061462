"""Session of one robot, from the options of a command line to the files that it leaves: deploy-run and deploy-check."""

import gc
import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.backends.backend import Backend, Request
from deploy.operation.interrupts import Interrupts, not_dropped
from deploy.operation.loop_timing import Clock, LoopTiming, RateLimited, Unpaced, WallClock
from deploy.operation.options import SEED, random_source, speed_factor
from deploy.operation.robot_run import RobotRun, Watcher
from deploy.operation.summary import report
from deploy.operation.temperature_file import PERIOD_S as HEAT_S
from deploy.operation.temperature_file import TemperatureFile
from deploy.plugins import BACKENDS, installed, load
from deploy.policy.actor import Actor
from deploy.runtime import Runtime
from deploy.telemetry.console import ConsoleProcess, snapshot
from deploy.telemetry.folder_lock import locked
from deploy.telemetry.output_files import check_folder, check_no_input
from deploy.telemetry.recorder import Recorder, former_files
from robots.errors import ConfigError, printable
from robots.spec import RobotSpec

CONSOLE_S, VIEW_S = 0.2, 1 / 30
HEAT = "heat.json"

RobotName = Annotated[str, typer.Option(help="name in robots/, or a folder")]
BackendName = Annotated[str, typer.Option(help=f"connection to the robot: {', '.join(installed(BACKENDS))}")]
Speed = Annotated[
    str, typer.Option(help="robot time divided by wall time: a factor from 0.1 to 1000, or max")
]
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of every command that drives one robot, as given.

    Attributes:
        duration: s of robot time.
    """

    spec: RobotSpec
    backend: str
    duration: float
    speed: str
    seed: int | None
    draw: str | None
    out: Path
    view: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """Policy or operator that moves the robot.

    Attributes:
        name: for the summary: the policy's file. actor: in the place of the policy.
        spec: the robot within whose limits it is moved.
        inputs: files that were read. outputs: files that are written besides those of a session.
        watchers: called after each tick.
        title: line for the console. joint: number of the joint that the operator moves; None where a policy moves all.
    """

    name: str
    actor: Actor
    spec: RobotSpec
    inputs: Sequence[Path] = ()
    outputs: Sequence[Path] = ()
    watchers: Sequence[Watcher] = ()
    title: Callable[[], str] | None = None
    joint: Callable[[], int] | None = None


class Session:
    """One robot, its clock and its folder.

    Attributes:
        seed_text: seed or draw, in words.
    """

    def __init__(self, options: Options, interrupts: Interrupts) -> None:
        """Check the options; nothing is opened or written. `interrupts` must handle signals during `run`.

        Raises:
            ConfigError: an option out of bounds.
        """
        self._options, self._interrupts, self._factor = options, interrupts, speed_factor(options.speed)
        if not options.duration > 0:
            raise ConfigError(f"--duration {options.duration}: expected s above 0, or inf")
        given = {"--draw": options.draw is not None, "--view": options.view}
        self._backend = _backend(options.backend, simulation=given)
        source = random_source(options.spec, options.seed, options.draw)
        self.seed_text, self._source, self._drawn, self._read = source

    def run(self, drive: Drive, printing: ExitStack) -> RobotRun:
        """Drive the robot from arming to rest, write its files, and return the finished run.

        Until the first file is written, a signal raises KeyboardInterrupt. `printing` prints the summary when it
        closes: once signals end the process again, which may wait for a reader.
        """
        options, action = self._options, drive.actor.contract.action
        request = Request(
            spec=options.spec,
            seeds=[self._source],
            gains=action.gains,
            mode=action.control_mode,
            draw=self._drawn,
        )
        self._backend.check(request)
        check_folder(options.out)
        for output in (*former_files(options.out), options.out / HEAT, *drive.outputs):
            check_no_input(output, (*drive.inputs, *self._read))
        with locked(options.out), closing(self._backend.open(request)) as robot:
            viewers = [RateLimited(VIEW_S, self._backend.viewer(robot))] if options.view else []
            runtime = Runtime(drive.spec, drive.actor.contract, robot, [self._source], drive.actor)
            heat_file = self._heat_file(runtime)
            self._backend.attach(robot, runtime)
            about = self._about(drive)
            self._interrupts.running = True
            recorder = Recorder(options.out, runtime, start_ns=time.time_ns(), about=about)
            return self._execute(runtime, (recorder, heat_file), drive, viewers, about, printing)

    def _heat_file(self, runtime: Runtime) -> TemperatureFile:
        path, same = self._options.out / HEAT, self._options.draw is None
        return TemperatureFile(path, self._options.spec, runtime.estimator.windings, same_robot=same)

    def _about(self, drive: Drive) -> dict[str, str]:
        spec, options = self._options.spec, self._options
        about = {"robot": spec.name, "robot_digest": spec.digest, "policy": drive.name}
        about |= {"policy_digest": drive.actor.digest, "backend": options.backend}
        about |= {"seed": self.seed_text, "speed": options.speed}
        return {key: printable(text) for key, text in about.items()}  # of file names that may not be UTF-8

    def _execute(
        self,
        runtime: Runtime,
        files: tuple[Recorder, TemperatureFile],
        drive: Drive,
        viewers: Sequence[Watcher],
        about: dict[str, str],
        printing: ExitStack,
    ) -> RobotRun:
        (recorder, heat_file), console = files, ConsoleProcess()
        title = drive.title or (lambda: f"{about['robot']}  {about['policy']}  {about['backend']}")

        def lost() -> list[str]:
            return [*recorder.lost, *filter(None, [heat_file.error])]

        def show(run: RobotRun) -> None:
            joint = drive.joint() if drive.joint else None
            console.offer(snapshot(run, title=title(), notes=lost(), joint=joint))

        shown: list[Watcher] = [RateLimited(CONSOLE_S, show), RateLimited(HEAT_S, heat_file.save), *viewers]
        watchers = [*drive.watchers, *shown]
        timing = _timing(runtime.spec.rates.control_hz, self._factor)
        run = RobotRun(
            runtime,
            timing,
            recorder,
            interrupts=self._interrupts,
            duration=self._options.duration,
            watchers=watchers,
        )

        def show_last() -> None:
            if runtime.ticks:
                show(run)

        def summarize() -> None:
            run.lost = report(run, about, recorder.path.parent / "summary.json", lost(), printing)

        # Objects made so far stay: the garbage collector shall not visit them in the middle of a tick.
        gc.collect()
        gc.freeze()
        with ExitStack() as ending:  # each of them in any case, the last one first
            for call in (summarize, console.close, heat_file.close, recorder.close, show_last, gc.unfreeze):
                ending.callback(call)
            run.run()
        return run


def _backend(name: str, simulation: dict[str, bool]) -> Backend[Any]:
    """Return the backend of that name; refuse given options of the `simulation` for any other."""
    with not_dropped():  # a library that is imported makes an ImportError of an interrupt
        backend: Backend[Any] = load(BACKENDS, name, f"--backend {name}")()
    given = [option for option, is_given in simulation.items() if is_given]
    if given and not backend.abilities.simulated:
        raise ConfigError(f"--backend {name}: found {given[0]}, which only simulated robots have")
    return backend


def _timing(control_hz: int, factor: float) -> LoopTiming:
    clock: Clock = Unpaced() if math.isinf(factor) else WallClock(1 / (control_hz * factor))
    return LoopTiming(clock, control_hz)
