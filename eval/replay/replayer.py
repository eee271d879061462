"""The seconds around an event, lived again from the state before it, and compared bit for bit."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.safety.diagnostics import StopDetector, explain_reasons
from deploy.stage import Arrays
from deploy.telemetry.ring import Rows
from eval.faults.schedule import hours_max
from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from eval.replay import bundle
from eval.replay.bundle import About, Happened
from eval.replay.capture_window import Window, columns, from_columns, window_type
from eval.replay.event_capture import LOOKS, chosen
from eval.soak.shard import LOOK_S, WIDTH, Shard, ShardJob, judge_of, judge_tick
from robots.arrays import Floats
from robots.distributions import Distributions, load_distributions
from robots.draws import Draw, load_draw
from robots.errors import ConfigError
from robots.models.sandbox import check_compiles
from robots.spec import RobotSpec, load_robot

JOINT_NAMES = tuple(monitor.name for monitor in MONITORS if monitor.per_joint)


class Again(NamedTuple):
    """What came of it.

    Attributes:
        rows: (T,) of the event's robot, of `window_type`. load: (T,) of its monitor and joint, 1 at the limit.
        event: what the judge found there this time; None if it found nothing that begins there.
        stops: ticks, from the first on, in which the event's robot left its work, and why in words.
        end_digest: of the state at the end.
    """

    rows: Rows
    load: Floats
    event: Happened | None
    stops: dict[int, str]
    end_digest: str


class Difference(NamedTuple):
    """The first tick at which a signal is not what was recorded."""

    tick: int
    signal: str
    found: NDArray[np.generic]
    recorded: NDArray[np.generic]


class Replay:
    """A bundle that was opened and checked, and the shard that it was cut from, as it stood before the event.

    Attributes:
        about: bundle.json. spec: the bundle's robot. row: its place in the shard.
        shard: before tick `about.begin`.
        recorded: (T,) what happened, of `window_type`.
        differs: what here is not what it was there, by name: found, recorded.
    """

    def __init__(self, folder: Path) -> None:
        """Build the shard and put the saved state into it.

        Raises:
            FirstshiftError: naming the file and the field.
        """
        self.about = about = bundle.open_bundle(folder)
        self.spec = load_robot(folder / bundle.ROBOT)
        check_compiles(self.spec.model_path, self.spec.folder)
        distributions = load_distributions(self.spec)
        self.differs = _differs(about, self.spec, distributions)
        self.row = about.event.robot - about.job.first
        _check(folder / bundle.ABOUT, about, self.spec)
        self.shard = _shard(folder, about, self.spec, _draw(folder, about, self.spec, distributions))
        state = self._arrays(folder / bundle.STATE, self.shard.snapshot())
        _equal(folder / bundle.STATE, "runtime.ticks", int(state["runtime.ticks"]), about.begin)
        self.shard.restore(state)
        row = window_type(self.spec, self.shard.runtime.task.size)
        room = columns(np.zeros(about.end - about.begin, dtype=row))
        self.recorded = from_columns(self._arrays(folder / bundle.WINDOW, room), row)

    def _arrays(self, path: Path, room: Arrays) -> Arrays:
        """What is in a file of the bundle, as large as `room`; other code may have kept other arrays."""
        try:
            return bundle.read_arrays(path, room)
        except ConfigError as e:
            if "code_digest" not in self.differs:
                raise
            here, there = self.differs["code_digest"]
            other = f"code_digest: found {here:.12} here, {there:.12} in the bundle"
            raise ConfigError(f"{e}; {other}: replay it with the code that made it") from e

    @property
    def goal_m(self) -> float:
        """How near to a goal counts, m."""
        return self.shard.runtime.task.rule.tolerance

    def live(self, watch: Callable[[], None] = lambda: None) -> Again:
        """Live the window, once; `watch` is called after every tick."""
        shard, about = self.shard, self.about
        window = Window(self.spec, WIDTH, self.shard.runtime.task.size, len(self.recorded) * self.spec.dt)
        # A judge of its own, whose highest load begins anew with each tick.
        ticker = judge_of(self.spec, shard.runtime.contract, about.job.robots)
        load = np.zeros(len(self.recorded))
        ticker.restore(shard.judge.save())
        channel = _channel(ticker.counts(), about.event)
        leaving, stops = StopDetector(), dict[int, str]()
        leaving.step(shard.runtime)  # before the window
        for place in range(len(load)):
            shard.tick()
            if self.row in leaving.step(shard.runtime):
                reason = int(shard.runtime.supervisor.reason[self.row])
                stops[place] = explain_reasons(shard.runtime, reason, self.row)
            window.see(shard.runtime, shard.truth)
            ticker.worst[:] = 0.0
            judge_tick(ticker, shard.truth, shard.runtime, shard.heard)
            load[place] = ticker.counts().worst[self.row, channel]
            watch()
        return Again(
            rows=window.between(about.begin, about.end, self.row),
            load=load,
            event=self._found(shard.judge.counts()),
            stops=stops,
            end_digest=bundle.state_digest(shard.snapshot()),
        )

    def _found(self, counts: Counts) -> Happened | None:
        about = self.about
        events = (Happened.of(event, about.job.first) for event in chosen(counts, about.job.robots))
        where = ("robot", "monitor", "start")
        same = (e for e in events if all(getattr(e, name) == getattr(about.event, name) for name in where))
        return next(same, None)


def difference(found: Rows, recorded: Rows) -> Difference | None:
    """The first tick at which a bit of any signal differs; of several signals, the first in the order of a row."""
    first: Difference | None = None
    for name in recorded.dtype.names or ():
        a, b = found[name], recorded[name]
        ticks = np.flatnonzero((_bits(a) != _bits(b)).any(axis=1))
        if ticks.size and (first is None or recorded["tick"][ticks[0]] < first.tick):
            first = Difference(int(recorded["tick"][ticks[0]]), name, a[ticks[0]], b[ticks[0]])
    return first


def why_not(replay: Replay, again: Again) -> str:
    """What is not the same, in words; empty if all is."""
    about = replay.about
    if apart := difference(again.rows, replay.recorded):
        return (
            f"at tick {apart.tick - about.event.start:+d} of the event, {apart.signal}: found {apart.found.tolist()},"
            f" recorded {apart.recorded.tolist()}"
        )
    if again.event != about.event:
        return f"the judge found {again.event}, recorded {about.event}"
    return "" if again.end_digest == about.end_digest else "all signals agree, the state at the end does not"


def _bits(array: NDArray[np.generic]) -> NDArray[np.uint8]:
    """(T, bytes): equal where even what is no number has the same bits."""
    return np.ascontiguousarray(array).reshape(len(array), -1).view(np.uint8)


def _channel(counts: Counts, event: Happened) -> int:
    place = 0 if event.joint is None else counts.joints.index(event.joint)
    return counts.columns(event.monitor).start + place


def _shard(folder: Path, about: About, spec: RobotSpec, draw: Draw) -> Shard:
    job = ShardJob(
        robot=folder / bundle.ROBOT,
        policy=folder / bundle.POLICY,
        robot_digest=spec.digest,
        policy_digest=about.files[bundle.POLICY],
        **dict(about.job),
    )
    return Shard(job, given=draw)


def _draw(folder: Path, about: About, spec: RobotSpec, distributions: Distributions) -> Draw:
    path = folder / bundle.DRAWS
    seed, draw = load_draw(path, distributions, spec)
    _equal(path, "seed", seed, about.job.seed)
    _equal(path, "robots", draw.robots, WIDTH)
    return draw


def _check(path: Path, about: About, spec: RobotSpec) -> None:
    event, job = about.event, about.job
    _at_most(path, "job.robots", job.robots, WIDTH)
    if not job.first <= event.robot < job.first + job.robots:
        raise ConfigError(
            f"{path}: event.robot: found {event.robot}, expected one of the {job.robots} from {job.first} on"
        )
    known = spec.joint_names if event.monitor in JOINT_NAMES else (None,)
    if event.joint not in known:
        raise ConfigError(f"{path}: event.joint: found {event.joint!r:.40}, expected one of {known}")
    _at_most(path, "job.ticks", job.ticks, round(hours_max(job.faults) * 3600 / spec.dt))
    _at_most(path, "end", about.end, about.begin + round((LOOKS + 1) * LOOK_S / spec.dt))


def _differs(about: About, spec: RobotSpec, distributions: Distributions) -> dict[str, tuple[str, str]]:
    here = bundle.identity(spec.digest, distributions.digest, about.files[bundle.POLICY])
    names = sorted(here.keys() | about.identity.keys())
    both = {name: (here.get(name, "none"), about.identity.get(name, "none")) for name in names}
    return {name: values for name, values in both.items() if values[0] != values[1]}


def _equal(path: Path, field: str, found: int, expected: int) -> None:
    if found != expected:
        raise ConfigError(f"{path}: {field}: found {found}, expected {expected}")


def _at_most(path: Path, field: str, found: int, bound: int) -> None:
    if found > bound:
        raise ConfigError(f"{path}: {field}: found {found}, expected at most {bound}")
