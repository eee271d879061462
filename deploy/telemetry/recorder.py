"""Recorder of one robot: a decimated stream of the whole run, and every tick of the seconds around an event."""

import os
import re
import time
from collections.abc import Mapping
from pathlib import Path

from deploy.reasons import Reason
from deploy.runtime import Runtime
from deploy.state import Mode
from deploy.telemetry.disk_writer import WAIT_S
from deploy.telemetry.recording import Recording
from deploy.telemetry.signals import Ring, row_type
from robots.errors import OutputError, output_error

STREAM, STREAM_HZ = "run.mcap", 50
EVENT = r"event-[0-9]+\.mcap"
"""Pattern of the names of events: a file with another name is the user's."""
AFTER_S = 0.5
"""Share of the ring that comes after the event: the stop itself."""
ROWS_PER_TICK = 4
"""An event is written a few ticks at a time, so that no tick is late for it: 0.2 ms each."""
EVENTS_MAX = 20


def former_files(folder: Path) -> tuple[Path, ...]:
    """Return the files of a recording, and of its run's summary, that a new one in `folder` replaces."""
    events = [path for path in folder.glob("event-*.mcap") if re.fullmatch(EVENT, path.name)]
    return (*events, folder / STREAM, folder / "summary.json")


class Recorder:
    """Records robot 0 into `folder`: run.mcap, and event-<tick>.mcap for each of the first events.

    A disk that fails before anything moves is an error; one that fails later is noted in `lost`, and the robot goes on.

    Attributes:
        lost: failures of the disk in words, one for each file.
    """

    def __init__(self, folder: Path, runtime: Runtime, *, start_ns: int, about: Mapping[str, str]) -> None:
        """Replace the recording of a previous run in `folder`.

        Raises:
            OutputError: it cannot be written.
        """
        self._events: list[Recording] = []
        self.lost: list[str] = []
        self._failed: set[Path] = set()
        self._folder, self._spec, self._start_ns, self._about = folder, runtime.spec, start_ns, dict(about)
        self._goal_m = runtime.task.criterion.tolerance
        self._ring = Ring(runtime.spec, runtime.robot.robots, row_type(runtime.spec, runtime.task.size))
        self._every = max(1, runtime.spec.rates.control_hz // STREAM_HZ)
        self._after = round(AFTER_S / runtime.spec.dt)
        self._tick, self._mode, self._due, self._newest = -1, int(Mode.DISARMED), -1, -1
        self._unwritten = self._ring.last()[:, 0]
        self._stream = self._opened()

    def _opened(self) -> Recording:
        path, replaced = self._folder / STREAM, former_files(self._folder)
        for former in replaced:  # all of them before the first is deleted
            if os.path.isdir(former) and not os.path.islink(former):
                raise OutputError(f"--out {former}: found a folder, expected a file or nothing")
        try:
            for former in replaced:
                former.unlink(missing_ok=True)
        except OSError as e:
            raise OutputError(f"--out {self._folder}: {former.name} cannot be removed: {e.strerror}") from e
        stream = self._recording(path)
        stream.settle()
        if stream.error is not None:
            stream.finish()
            message = f"--out {path}: cannot be written: {stream.error.strerror}"
            raise output_error(message, stream.error) from stream.error
        return stream

    def _recording(self, path: Path) -> Recording:
        return Recording(path, self._spec, start_ns=self._start_ns, goal_m=self._goal_m, about=self._about)

    @property
    def path(self) -> Path:
        """Path of the stream."""
        return self._stream.path

    @property
    def events(self) -> tuple[Path, ...]:
        """Paths of events written or being written."""
        return tuple(event.path for event in self._events)

    def step(self, runtime: Runtime, reason: str) -> None:
        """Record the tick that has just ended; `reason` says in words why the robot does not run."""
        row, self._tick = self._ring.step(runtime)[0], runtime.ticks - 1
        if row["mode"] != self._mode:
            self._log_mode(Mode(int(row["mode"])), int(row["reason"]), reason)
        if self._tick % self._every == 0 and self._stream.error is None:
            self._stream.write(row)
        if self._tick == self._due:
            self._begin_event()
        self._write_event(ROWS_PER_TICK)
        self._check_disk()

    def _log_mode(self, mode: Mode, bits: int, reason: str) -> None:
        """Log a change of mode; a stop that the operator did not ask for is an event."""
        message = f"{Mode(self._mode).name} → {mode.name}{reason and f': {reason}'}"
        self._stream.log(self._tick, message, warning=bool(bits))
        cut = mode == Mode.LATCHED and self._mode not in (Mode.STOPPING, Mode.HOLDING)
        self._mode = int(mode)
        if (mode == Mode.STOPPING and bits != Reason.OPERATOR) or cut:
            self.event()

    def event(self) -> None:
        """Mark the present tick as an event: the ring is written once it holds the ticks that follow."""
        self._newest = self._tick
        if self._due < 0:
            self._schedule()

    def _schedule(self) -> None:
        if len(self._events) < EVENTS_MAX:
            self._due = self._newest + self._after

    def _begin_event(self) -> None:
        self._write_event(len(self._unwritten))
        tick = self._due - self._after
        self._events.append(self._recording(self._folder / f"event-{tick}.mcap"))
        self._due, self._unwritten = -1, self._ring.last()[:, 0]
        if self._newest > tick:
            self._schedule()

    def _write_event(self, count: int) -> None:
        """Write the next rows of the newest event, if any are left."""
        if not len(self._unwritten):
            return
        for row in self._unwritten[:count]:
            self._events[-1].write(row)
        self._unwritten = self._unwritten[count:]
        if not len(self._unwritten):
            self._events[-1].finish()

    def _check_disk(self, *older: Recording) -> None:
        """Note a failure of the stream, of the newest event, and of `older` ones."""
        for recording in (self._stream, *older, *self._events[-1:]):
            if recording.error is not None and recording.path not in self._failed:
                self._failed.add(recording.path)
                what = "recording" if recording is self._stream else "event"
                self.lost.append(f"{what} {recording.path}: cannot be written: {recording.error.strerror}")

    def close(self) -> None:
        """End every file; an event whose end has not come yet is written as it is."""
        if self._due >= 0:
            self._begin_event()
        self._write_event(len(self._unwritten))
        self._stream.finish()
        last = time.monotonic() + WAIT_S  # one for all: a disk that hangs has hung them all
        for recording in (self._stream, *self._events):
            recording.wait(max(0.0, last - time.monotonic()))
        self._check_disk(*self._events)
