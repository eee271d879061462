"""Sees what the judge finds in a shard, and lives again what led to it.

Nothing is written down as it comes: an event is rare, and the same ticks come out of the same state in every bit.
"""

from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path

from deploy.stage import Arrays
from eval.judge.counts import Counts, Event
from eval.replay import bundle
from eval.replay.capture_window import Window, columns, write_mcap
from eval.soak.shard import LOOK_S, Shard, ShardJob
from robots.distributions import load_distributions

EVENTS = "events"
"""Folder of bundles, beside the report."""
HARD_KEPT, SOFT_KEPT = 4, 1
"""Events of each monitor, hard or soft, of which a shard leaves bundles: the earliest. About 1 MB each."""
LOOKS = 3
"""Looks of a whole window: what led to an event, the event, what followed."""


class Witness:
    """Called after every tick of a shard; writes bundles of the first events of each monitor.

    What it writes depends on what the judge has logged and on where the shard is kept, not on whether it was taken up
    there.
    """

    def __init__(self, job: ShardJob, shard: Shard, folder: Path) -> None:
        """Take copies of what a bundle needs and what might change meanwhile.

        Args:
            job: what the shard was told.
            shard: about to go on.
            folder: of the bundles; made with the first one.
        """
        spec = shard.runtime.spec
        self._job, self._folder, self._spec = job, folder, spec
        self._look = round(LOOK_S / spec.dt)
        self._policy = job.policy.read_bytes()
        self._robot = {name: (spec.folder / name).read_bytes() for name in bundle.robot_files(spec)}
        distributions = load_distributions(spec)
        self._draws = shard.robot.draw.to_json(job.seed, distributions, spec)
        self._identity = bundle.identity(spec.digest, distributions.digest, job.policy_digest)
        self._from = shard.runtime.ticks
        self._states: deque[tuple[int, Arrays]] = deque([(self._from, shard.snapshot())], maxlen=LOOKS)

    def watch(self, shard: Shard) -> None:
        """Look at the tick that has just ended, if it is time to."""
        tick = shard.runtime.ticks
        if tick % self._look == 0:
            # An event is told of one look later, so that the window holds what followed.
            self._tell(shard, tick - self._look)
            self._states.append((tick, shard.snapshot()))

    def begin(self, shard: Shard) -> None:
        """Tell of what is left, and go on like one that takes up the shard here: call it before that is kept."""
        self._tell(shard, shard.runtime.ticks)
        self._states.clear()
        self._states.append((shard.runtime.ticks, shard.snapshot()))

    def _tell(self, shard: Shard, before: int) -> None:
        """Write bundles of events that began before tick `before` and were not told of yet."""
        counts = shard.judge.counts()
        new = self._new(counts, before)
        if new:
            end, goal_m = shard.runtime.ticks, shard.runtime.task.rule.tolerance
            window, end_digest = self._again(shard, *self._before(min(e.start for e in new)))
            for event in new:
                self._write(event, window, end, end_digest, goal_m)
        self._from = max(self._from, before)

    def _again(self, shard: Shard, begin: int, state: Arrays) -> tuple[Window, str]:
        """What all robots lived through since a state, lived again, and the digest of the state that it leads to.

        Raises:
            RuntimeError: it leads to another state than it did, so that no bundle would tell the truth.
        """
        end, expected = shard.runtime.ticks, bundle.state_digest(shard.snapshot())
        window = Window(
            self._spec, shard.robot.robots, shard.runtime.task.size, (end - begin) * self._spec.dt
        )
        shard.live_again(state, lambda: window.see(shard.runtime, shard.truth))
        if bundle.state_digest(shard.snapshot()) != expected:
            raise RuntimeError(f"ticks {begin} to {end} were not the same when they were lived again")
        return window, expected

    def _new(self, counts: Counts, before: int) -> list[Event]:
        """Those to be told of. To choose is dear, so it is not done where nothing has begun since."""
        if not ((counts.log_start >= self._from) & (counts.log_start < before)).any():
            return []
        return [e for e in chosen(counts, self._job.robots) if self._from <= e.start < before]

    def _write(self, event: Event, window: Window, end: int, end_digest: str, goal_m: float) -> None:
        begin, state = self._before(event.start)
        rows = window.between(begin, end, event.robot)
        happened = bundle.Happened.of(event, self._job.first)
        job = {name: getattr(self._job, name) for name in bundle.Job.model_fields}
        about = bundle.About(
            identity=self._identity,
            job=bundle.Job(**job),
            event=happened,
            begin=begin,
            end=end,
            end_digest=end_digest,
            files={},
        )
        place = self._folder / bundle.bundle_name(happened.robot, event.start, event.monitor.name)
        with bundle.filling(place) as folder:
            for name, data in self._robot.items():
                copy = folder / bundle.ROBOT / name
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(data)
            (folder / bundle.POLICY).write_bytes(self._policy)
            (folder / bundle.DRAWS).write_text(self._draws, encoding="utf-8")
            bundle.write_arrays(folder / bundle.STATE, state)
            bundle.write_arrays(folder / bundle.WINDOW, columns(rows))
            write_mcap(folder / bundle.MCAP, self._spec, rows, goal_m=goal_m, about=happened.said())
            bundle.seal(folder, about)

    def _before(self, start: int) -> tuple[int, Arrays]:
        """The newest state that is a look older than an event, or the oldest there is."""
        old = [state for state in self._states if state[0] <= start - self._look]
        return old[-1] if old else self._states[0]


def chosen(counts: Counts, robots: int) -> Iterator[Event]:
    """The earliest events of each monitor, of robots that count.

    Of those that begin within a look on one robot, whose joints fail together, only the first; at one tick the worst.
    """
    kept: Counter[str] = Counter()
    until: dict[tuple[str, int], int] = {}
    for event in sorted(counts.log(), key=lambda e: (e.start, e.robot, -e.worst)):
        name, here = event.monitor.name, (event.monitor.name, event.robot)
        if event.robot >= robots or event.start < until.get(here, 0):
            continue
        until[here], kept[name] = event.start + round(LOOK_S / counts.dt), kept[name] + 1
        if kept[name] <= (HARD_KEPT if event.monitor.hard else SOFT_KEPT):
            yield event
