"""Replay of an event: simulate its window again from the state saved before it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deploy.operation.stop_explanation import StopDetector, explain_reasons
from deploy.policy.compatibility import sensors_read
from deploy.policy.policy import Policy
from deploy.policy.tried_policy import read_tried_policy
from deploy.stage import Arrays
from deploy.telemetry.signals import Rows
from eval.faults.catalogue import check_names
from eval.faults.schedule import hours_max
from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from eval.replay import bundle
from eval.replay.bundle import BundleInfo, EventRecord
from eval.replay.bundle_files import read_arrays, state_digest
from eval.replay.capture_window import Window, columns, from_columns, window_type
from eval.replay.event_capture import WINDOW_POLLS, select_events
from eval.shard.job import POLL_S, WIDTH, ShardJob
from eval.shard.judging import judge_tick, make_judge
from eval.shard.shard import Shard
from robots.arrays import Floats
from robots.distributions import Distributions, load_distributions
from robots.draws import Draw, load_draw
from robots.errors import ConfigError
from robots.models.sandbox import check_compiles
from robots.spec import RobotSpec, load_robot

JOINT_NAMES = tuple(monitor.name for monitor in MONITORS if monitor.per_joint)


class ReplayResult(NamedTuple):
    """Outcome of a replay.

    Attributes:
        rows: (T,) of the event's robot, of `window_type`. load: (T,) of its monitor and joint, 1 at the limit.
        event: recorded by the judge this time; None if it recorded none with the same start.
        stops: reason in words by tick, counted from the first, at which the event's robot began a stop.
        end_digest: of the state at the end.
    """

    rows: Rows
    load: Floats
    event: EventRecord | None
    stops: dict[int, str]
    end_digest: str


class Replay:
    """Opened and checked bundle, and its shard in the state before the event.

    Attributes:
        info: bundle.json. spec: the bundle's robot. row: its row in the shard.
        shard: before tick `info.begin`.
        recorded: (T,) the recorded window, of `window_type`.
        differences: items of the identity that differ here, by name: (here, in the bundle).
    """

    def __init__(self, folder: Path) -> None:
        """Build the shard and restore the saved state.

        Raises:
            FirstshiftError: naming the file and the field.
        """
        self._state_path = folder / bundle.STATE
        self.info = info = bundle.open_bundle(folder)
        self.spec = load_robot(folder / bundle.ROBOT)
        check_compiles(self.spec.model_path, self.spec.folder)
        read_tried_policy(folder / bundle.POLICY)
        distributions = load_distributions(self.spec)
        self.differences = _identity_differences(info, self.spec, distributions)
        self.row = info.event.robot - info.job.first
        _check_info(folder / bundle.INFO, info, self.spec)
        _check_classes(folder, info, self.spec)
        self.shard = _shard(folder, info, self.spec, _load_draw(folder, info, self.spec, distributions))
        state = self._read_arrays(folder / bundle.STATE, self.shard.snapshot())
        _check_equal(folder / bundle.STATE, "runtime.ticks", int(state["runtime.ticks"]), info.begin)
        with self.reading_state():
            self.shard.restore(state)
        row = window_type(self.spec, self.shard.runtime.task.size)
        expected = columns(np.zeros(info.end - info.begin, dtype=row))
        self.recorded = from_columns(self._read_arrays(folder / bundle.WINDOW, expected), row)

    def _read_arrays(self, path: Path, expected: Arrays) -> Arrays:
        """Read a file of the bundle; other code may have saved other arrays, and the error says so."""
        try:
            return read_arrays(path, expected)
        except ConfigError as e:
            if "code_digest" not in self.differences:
                raise
            here, there = self.differences["code_digest"]
            other = f"code_digest: found {here:.12} here, {there:.12} in the bundle"
            raise ConfigError(f"{e}; {other}: replay it with the code that made it") from e

    @property
    def goal_m(self) -> float:
        """Distance at which a goal counts as reached, m."""
        return self.shard.runtime.task.criterion.tolerance

    def run(self, observe: Callable[[], None] = lambda: None) -> ReplayResult:
        """Simulate the window, once; `observe` is called after every tick.

        Raises:
            ConfigError: the saved state is none of a simulated shard.
        """
        shard, info = self.shard, self.info
        window = Window(self.spec, WIDTH, shard.runtime.task.size, len(self.recorded) * self.spec.dt)
        # A second judge, whose highest load is reset in each tick.
        tick_judge = make_judge(self.spec, shard.runtime.contract, WIDTH, counted=info.job.robots)
        load = np.zeros(len(self.recorded))
        tick_judge.restore(shard.judge.save())
        channel = _channel(tick_judge.counts(), info.event)
        detector, stops = StopDetector(), dict[int, str]()
        detector.step(shard.runtime)  # before the window
        for place in range(len(load)):
            with self.reading_state():
                shard.tick()
            if self.row in detector.step(shard.runtime):
                reason = int(shard.runtime.supervisor.reason[self.row])
                stops[place] = explain_reasons(shard.runtime, reason, self.row)
            window.record(shard.runtime, shard.truth)
            tick_judge.worst[:] = 0.0
            judge_tick(tick_judge, shard.truth, shard.runtime, shard.action)
            load[place] = tick_judge.counts().worst[self.row, channel]
            observe()
        with self.reading_state():
            event = self._find_peak(load) if info.event.peak else self._find_event(shard.judge.counts())
        return ReplayResult(
            rows=window.between(info.begin, info.end, self.row),
            load=load,
            event=event,
            stops=stops,
            end_digest=state_digest(shard.snapshot()),
        )

    @contextmanager
    def reading_state(self) -> Iterator[None]:
        """Context in which errors are taken for those of integers in the saved state, which are not checked before.

        Nor are its other numbers, and numpy warns of none: what they lead to is part of the replay.

        Raises:
            ConfigError: in place of an IndexError, OverflowError or ValueError.
        """
        try:
            with np.errstate(all="ignore"):
                yield
        except (IndexError, OverflowError, ValueError) as e:
            said = next(iter(str(e).splitlines()), "")
            raise ConfigError(f"{self._state_path}: holds an integer that no state has: {said}") from e

    def _find_event(self, counts: Counts) -> EventRecord | None:
        info, keys = self.info, ("robot", "monitor", "start")
        for event in select_events(counts, info.job.robots):
            record = EventRecord.from_event(event, info.job.first)
            if all(getattr(record, key) == getattr(info.event, key) for key in keys):
                return record
        return None

    def _find_peak(self, load: Floats) -> EventRecord:
        place, worst = int(np.argmax(load)), float(load.max())
        found = {"start": self.info.begin + place, "worst": worst if np.isfinite(worst) else None}
        return self.info.event.model_copy(update=found)


def _channel(counts: Counts, event: EventRecord) -> int:
    joint = 0 if event.joint is None else counts.joints.index(event.joint)
    return counts.columns(event.monitor).start + joint


def _shard(folder: Path, info: BundleInfo, spec: RobotSpec, draw: Draw) -> Shard:
    job = ShardJob(
        robot=folder / bundle.ROBOT,
        policy=folder / bundle.POLICY,
        robot_digest=spec.digest,
        policy_digest=info.files[bundle.POLICY],
        **dict(info.job),
    )
    return Shard(job, draw=draw)


def _load_draw(folder: Path, info: BundleInfo, spec: RobotSpec, distributions: Distributions) -> Draw:
    path = folder / bundle.DRAWS
    seed, draw = load_draw(path, distributions, spec)
    _check_equal(path, "seed", seed, info.job.seed)
    _check_equal(path, "robots", draw.robots, WIDTH)
    return draw


def _check_info(path: Path, info: BundleInfo, spec: RobotSpec) -> None:
    event, job = info.event, info.job
    _check_at_most(path, "job.robots", job.robots, WIDTH)
    if not job.first <= event.robot < job.first + job.robots:
        raise ConfigError(
            f"{path}: event.robot: found {event.robot}, expected one of the {job.robots} from {job.first} on"
        )
    joints = spec.joint_names if event.monitor in JOINT_NAMES else (None,)
    if event.joint not in joints:
        raise ConfigError(f"{path}: event.joint: found {event.joint!r:.40}, expected one of {joints}")
    _check_at_most(path, "job.ticks", job.ticks, round(hours_max(job.faults) * 3600 / spec.dt))
    _check_at_most(path, "end", info.end, info.begin + round((WINDOW_POLLS + 1) * POLL_S / spec.dt))


def _check_classes(folder: Path, info: BundleInfo, spec: RobotSpec) -> None:
    """Check the names of fault classes, if any: without a known one there is nothing to inject."""
    if info.job.faults and info.job.faults.classes:
        read = sensors_read(Policy.load(folder / bundle.POLICY, spec).contract, spec)
        check_names(info.job.faults.classes, spec, read, f"{folder / bundle.INFO}: job.faults.classes")


def _identity_differences(
    info: BundleInfo, spec: RobotSpec, distributions: Distributions
) -> dict[str, tuple[str, str]]:
    here = bundle.identity(spec.digest, distributions.digest, info.files[bundle.POLICY])
    names = sorted(here.keys() | info.identity.keys())
    both = {name: (here.get(name, "none"), info.identity.get(name, "none")) for name in names}
    return {name: values for name, values in both.items() if values[0] != values[1]}


def _check_equal(path: Path, field: str, found: int, expected: int) -> None:
    if found != expected:
        raise ConfigError(f"{path}: {field}: found {found}, expected {expected}")


def _check_at_most(path: Path, field: str, found: int, bound: int) -> None:
    if found > bound:
        raise ConfigError(f"{path}: {field}: found {found}, expected at most {bound}")
