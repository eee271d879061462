"""The robot's black box: a thinned stream of the whole run, and the last seconds in full when something happens."""

import secrets
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.runtime import Runtime
from deploy.state import Mode, Reason
from deploy.telemetry.recording import WHOLE, Recording, row_type
from robots.arrays import Bools, Floats
from robots.errors import OutputError
from robots.spec import RobotSpec

STREAM_HZ = 50
RING_S = 2.0
AFTER_S = 0.5
"""How much of the ring comes after the event: the stop itself."""
ROWS_PER_TICK = 4
"""An event is written a few ticks at a time, so that no tick is late for it: 0.2 ms each."""
EVENTS_MAX = 20

Rows = NDArray[np.void]


def check_folder(folder: Path) -> None:
    """Make `folder` and see that files can be made in it.

    Raises:
        OutputError: they cannot.
    """
    probe = folder / f".{secrets.token_hex(4)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as e:
        raise OutputError(f"--out {folder}: cannot be written: {e.strerror}, expected a folder") from e


class Ring:
    """The last ticks of B robots at the full rate, in one preallocated array (T, B) of `row_type`."""

    def __init__(
        self, spec: RobotSpec, robots: int, *, seconds: float = RING_S, row: np.dtype[np.void] | None = None
    ) -> None:
        """Allocate for B robots, in rows of `row_type` or of a type that begins with it and adds more."""
        self.rows: Rows = np.zeros((round(seconds / spec.dt), robots), dtype=row or row_type(spec))
        self._ticks = 0
        plain = (*self.rows.shape, -1)
        self._whole = self.rows.view(np.int64).reshape(plain).transpose(0, 2, 1)[:, : len(WHOLE)]
        self._numbers = self.rows.view(np.float64).reshape(plain)[:, :, len(WHOLE) :]

    def step(self, runtime: Runtime) -> Rows:
        """Keep the tick that has just ended; return its row (B,)."""
        return self._keep(runtime, ())

    def _keep(self, runtime: Runtime, more: tuple[Floats | Bools, ...]) -> Rows:
        """The same, with more numbers (B, ...) behind its own. All at once: a field at a time takes twice as long."""
        self._ticks, task, supervisor = runtime.ticks, runtime.task, runtime.supervisor
        at = (self._ticks - 1) % len(self.rows)
        whole = self._ticks - 1, supervisor.mode, supervisor.reason, task.reached, task.attempted
        for place, value in zip(self._whole[at], whole, strict=True):
            place[...] = value
        state, sent = runtime.state, runtime.setpoint
        own = (
            *(state.q, state.qd, state.temperature, state.winding, runtime.action.q),
            *(sent.q, sent.qd, sent.qdd, runtime.command.tau, runtime.tool, task.goal),
            *(() if state.base is None else (state.base.quat_wxyz,)),
        )
        np.concatenate(own + more, axis=1, out=self._numbers[at])
        row: Rows = self.rows[at]
        return row

    def last(self) -> Rows:
        """A copy (≤ T, B) in the order of time."""
        count = min(self._ticks, len(self.rows))
        return self.rows[np.arange(self._ticks - count, self._ticks) % len(self.rows)]


class Recorder:
    """Records robot 0 into `folder`: run.mcap, and event-<tick>.mcap for each of the first events.

    A disk that fails before anything moves is an error; one that fails later is `lost`, and the robot goes on.

    Attributes:
        lost: what went wrong with the disk, in words.
    """

    def __init__(self, folder: Path, runtime: Runtime, *, start_ns: int, about: Mapping[str, str]) -> None:
        """Replace the recording of a former run in `folder`.

        Raises:
            OutputError: it cannot be written.
        """
        self._events: list[Recording] = []
        self.lost: str | None = None
        self._folder, self._spec, self._start_ns, self._about = folder, runtime.spec, start_ns, dict(about)
        self._goal_m = runtime.task.tolerance
        self._ring = Ring(runtime.spec, runtime.robot.robots)
        self._every = max(1, runtime.spec.rates.control_hz // STREAM_HZ)
        self._after = round(AFTER_S / runtime.spec.dt)
        self._tick, self._mode, self._due, self._newest = -1, int(Mode.DISARMED), -1, -1
        self._rows = self._ring.last()[:, 0]
        self._stream = self._opened()

    def _opened(self) -> Recording:
        path = self._folder / "run.mcap"
        try:
            for former in (*self._folder.glob("event-*.mcap"), self._folder / "summary.json"):
                former.unlink(missing_ok=True)
        except OSError as e:
            raise OutputError(f"--out {self._folder}: {former.name} cannot be removed: {e.strerror}") from e
        stream = self._recording(path)
        stream.settle()
        if stream.error is not None:
            raise OutputError(f"--out {path}: cannot be written: {stream.error.strerror}") from stream.error
        return stream

    def _recording(self, path: Path) -> Recording:
        return Recording(path, self._spec, start_ns=self._start_ns, goal_m=self._goal_m, about=self._about)

    @property
    def path(self) -> Path:
        """The stream."""
        return self._stream.path

    @property
    def events(self) -> tuple[Path, ...]:
        """Events written or being written."""
        return tuple(event.path for event in self._events)

    def step(self, runtime: Runtime, why: str) -> None:
        """Record the tick that has just ended, and why the robot does not run, in words."""
        row, self._tick = self._ring.step(runtime)[0], runtime.ticks - 1
        if self.lost is not None:
            return
        if row["mode"] != self._mode:
            self._changed(Mode(int(row["mode"])), int(row["reason"]), why)
        if self._tick % self._every == 0:
            self._stream.write(row)
        if self._tick == self._due:
            self._begin()
        self._write(ROWS_PER_TICK)
        self._listen()

    def _changed(self, mode: Mode, reason: int, why: str) -> None:
        said = f"{Mode(self._mode).name} → {mode.name}{why and f': {why}'}"
        self._stream.say(self._tick, said, warning=bool(reason))
        cut = mode == Mode.LATCHED and self._mode not in (Mode.STOPPING, Mode.HOLDING)
        self._mode = int(mode)
        if (mode == Mode.STOPPING and reason != Reason.OPERATOR) or cut:
            self.event()

    def event(self) -> None:
        """Something happened now: the ring will be kept once it holds what follows."""
        self._newest = self._tick
        if self._due < 0:
            self._await()

    def _await(self) -> None:
        if len(self._events) < EVENTS_MAX:
            self._due = self._newest + self._after

    def _begin(self) -> None:
        self._write(len(self._rows))
        happened = self._due - self._after
        self._events.append(self._recording(self._folder / f"event-{happened}.mcap"))
        self._due, self._rows = -1, self._ring.last()[:, 0]
        if self._newest > happened:
            self._await()

    def _write(self, count: int) -> None:
        """The next rows of the last event, if any are left."""
        if not len(self._rows):
            return
        for row in self._rows[:count]:
            self._events[-1].write(row)
        self._rows = self._rows[count:]
        if not len(self._rows):
            self._events[-1].finish()

    def _listen(self) -> None:
        for recording in (self._stream, *self._events[-1:]):
            if recording.error is not None:
                self.lost = f"{recording.path}: cannot be written: {recording.error.strerror}"

    def close(self) -> None:
        """End every file; an event that waits for its end is written as it is."""
        if self._due >= 0 and self.lost is None:
            self._begin()
        self._write(len(self._rows))
        self._stream.finish()
        for recording in (self._stream, *self._events):
            recording.wait()
        self._listen()
