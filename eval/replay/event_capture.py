"""Capture of events during a soak: when the judge finds one, its window is simulated again and written as a bundle.

Nothing is recorded in advance: events are rare, and the same state leads to the same ticks bit for bit.
"""

from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deploy.stage import Arrays
from eval.judge.counts import Counts, Event
from eval.replay import bundle
from eval.replay.bundle_files import new_bundle, state_digest, write_arrays
from eval.replay.capture_window import Window, columns, write_mcap
from eval.shard.job import POLL_S, ShardJob
from eval.shard.shard import Shard, check_robot
from robots.distributions import load_distributions
from robots.files import read_file
from robots.models.files import FILES_BYTES_MAX
from robots.spec import load_robot

EVENTS = "events"
"""Folder of bundles, beside the report."""
HARD_BUNDLES, SOFT_BUNDLES = 4, 1
"""Bundles of each hard or soft monitor that a shard writes, of its earliest events; about 1 MB each."""
WINDOW_POLLS = 3
"""Length of a whole window in poll intervals: before the event, the event, after it."""


class EventCapture:
    """Observer of a shard that writes bundles of the first events of each monitor.

    The bundles depend on the judge's log and on the ticks of checkpoints, not on whether the soak was resumed there.
    """

    def __init__(self, job: ShardJob, shard: Shard, folder: Path) -> None:
        """Copy the inputs of bundles that might change during the soak; the first bundle makes `folder`.

        Raises:
            FirstshiftError: the robot is no longer the one that the shard has loaded.
        """
        spec = shard.runtime.spec
        self._job, self._folder, self._spec = job, folder, spec
        self._poll = round(POLL_S / spec.dt)
        self._policy = shard.policy_data
        self._robot = {
            name: read_file(spec.folder / name, FILES_BYTES_MAX) for name in bundle.robot_files(spec)
        }
        distributions = load_distributions(spec)
        check_robot(job, load_robot(job.robot))
        self._draws = shard.robot.draw.to_json(job.seed, distributions, spec)
        self._identity = bundle.identity(spec.digest, distributions.digest, job.policy_digest)
        self._since = shard.runtime.ticks
        self._states: deque[tuple[int, Arrays]] = deque(
            [(self._since, shard.snapshot())], maxlen=WINDOW_POLLS
        )

    def observe(self, shard: Shard) -> None:
        """Call after every tick; works once per poll interval."""
        tick = shard.runtime.ticks
        if tick % self._poll == 0:
            # An event is written one interval later, so that the window shows what followed it.
            self._capture(shard, tick - self._poll)
            self._states.append((tick, shard.snapshot()))

    def flush(self, shard: Shard) -> None:
        """Call before a checkpoint: write all events so far, and forget older states as a resumed shard would."""
        self._capture(shard, shard.runtime.ticks)
        self._states.clear()
        self._states.append((shard.runtime.ticks, shard.snapshot()))

    def write_peak(self, shard: Shard, peak: Event) -> None:
        """Write a bundle of the tick with the highest load, from the oldest state there is to the present tick."""
        begin, state = self._states[0]
        window, end_digest = self._record_window(shard, begin, state)
        record = bundle.EventRecord.from_event(peak, self._job.first, peak=True)
        self._write(record, window, end_digest, shard)

    def _capture(self, shard: Shard, before: int) -> None:
        """Write bundles of new events that began before tick `before`."""
        counts = shard.judge.counts()
        new = self._new_events(counts, before)
        if new:
            window, end_digest = self._record_window(shard, *self._state_before(min(e.start for e in new)))
            for event in new:
                self._write(bundle.EventRecord.from_event(event, self._job.first), window, end_digest, shard)
        self._since = max(self._since, before)

    def _record_window(self, shard: Shard, begin: int, state: Arrays) -> tuple[Window, str]:
        """Simulate again from `state` to the present tick; return all robots' rows and the digest of the end state.

        Raises:
            RuntimeError: the end state differs from the present one, so that a bundle would be wrong.
        """
        end, expected = shard.runtime.ticks, state_digest(shard.snapshot())
        goal_size, seconds = shard.runtime.task.size, (end - begin) * self._spec.dt
        window = Window(self._spec, shard.robot.robots, goal_size, seconds)
        shard.resimulate(state, lambda: window.record(shard.runtime, shard.truth))
        if state_digest(shard.snapshot()) != expected:
            raise RuntimeError(f"ticks {begin} to {end} differ when they are simulated again")
        return window, expected

    def _new_events(self, counts: Counts, before: int) -> list[Event]:
        # Selecting events is expensive, so it is skipped where none has begun.
        if not ((counts.log_start >= self._since) & (counts.log_start < before)).any():
            return []
        return [e for e in select_events(counts, self._job.robots) if self._since <= e.start < before]

    def _write(self, record: bundle.EventRecord, window: Window, end_digest: str, shard: Shard) -> None:
        begin, state = self._state_before(record.start)
        end, goal_m = shard.runtime.ticks, shard.runtime.task.criterion.tolerance
        rows = window.between(begin, end, record.robot - self._job.first)
        job = bundle.JobRecord(**{name: getattr(self._job, name) for name in bundle.JobRecord.model_fields})
        extent: dict[str, Any] = {"begin": begin, "end": end, "end_digest": end_digest}
        info = bundle.BundleInfo(identity=self._identity, job=job, event=record, files={}, **extent)
        with new_bundle(
            self._folder / bundle.bundle_name(record.robot, record.start, record.monitor)
        ) as folder:
            self._write_inputs(folder)
            write_arrays(folder / bundle.STATE, state)
            write_arrays(folder / bundle.WINDOW, columns(rows))
            write_mcap(folder / bundle.MCAP, self._spec, rows, goal_m=goal_m, about=record.as_text())
            bundle.seal(folder, info)

    def _write_inputs(self, folder: Path) -> None:
        for name, data in self._robot.items():
            copy = folder / bundle.ROBOT / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(data)
        (folder / bundle.POLICY).write_bytes(self._policy)
        (folder / bundle.DRAWS).write_text(self._draws, encoding="utf-8")

    def _state_before(self, start: int) -> tuple[int, Arrays]:
        """Newest saved state at least one poll interval before an event, or the oldest state there is."""
        old = [state for state in self._states if state[0] <= start - self._poll]
        return old[-1] if old else self._states[0]


def select_events(counts: Counts, robots: int) -> Iterator[Event]:
    """Yield the earliest events of each monitor, of the first `robots` robots.

    Of events of one monitor and robot within one poll interval, whose joints fail together, only the first is taken;
    of events in the same tick the worst.
    """
    selected: Counter[str] = Counter()
    until: dict[tuple[str, int], int] = {}
    for event in sorted(counts.log(), key=lambda e: (e.start, e.robot, -e.worst)):
        name, key = event.monitor.name, (event.monitor.name, event.robot)
        if event.robot >= robots or event.start < until.get(key, 0):
            continue
        until[key], selected[name] = event.start + round(POLL_S / counts.dt), selected[name] + 1
        if selected[name] <= (HARD_BUNDLES if event.monitor.hard else SOFT_BUNDLES):
            yield event
