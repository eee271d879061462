"""Console of a running robot: snapshots are sent to a process that draws them, `console_display`."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from deploy.runtime import Runtime
from deploy.state import Mode
from robots.child_process import Lifeline
from robots.errors import printable

if TYPE_CHECKING:
    from deploy.operation.robot_run import RobotRun

WAIT_S = 5.0


class SnapshotPipe:
    """Writing end of a pipe that takes snapshots and never blocks: those that find it full are dropped."""

    def __init__(self, pipe: int) -> None:
        os.set_blocking(pipe, False)
        self._pipe: int | None = pipe
        self._unsent = b""

    def offer(self, snapshot: dict[str, Any]) -> None:
        """Send a snapshot, or the rest of an earlier one that was sent in part."""
        if self._pipe is None:
            return
        data = self._unsent or json.dumps(snapshot).encode() + b"\n"
        try:
            self._unsent = data[os.write(self._pipe, data) :]
        except BlockingIOError:
            pass
        except OSError:  # the reader has gone
            SnapshotPipe.close(self)

    def close(self) -> None:
        """End the stream of snapshots."""
        if self._pipe is not None:
            os.close(self._pipe)
        self._pipe = None


class ConsoleProcess(SnapshotPipe):
    """Snapshots drawn by `console_display`, a process of its own, on this process's standard output."""

    def __init__(self) -> None:
        """Start the process in its own group, so that Ctrl-C does not reach it."""
        reading, writing = os.pipe()
        self._lifeline = Lifeline()
        end = self._lifeline.end.fileno()
        command = [sys.executable, "-P", "-m", "deploy.telemetry.console_display", str(end)]
        encoding = getattr(sys.stdout, "encoding", None) or ""
        # What a terminal cannot show is written as an escape, as `deploy.start` has it for this process.
        environment = os.environ | {"PYTHONIOENCODING": f"{encoding}:backslashreplace"}
        self._process = subprocess.Popen(
            command, stdin=reading, process_group=0, env=environment, pass_fds=(end,)
        )
        os.close(reading)
        super().__init__(writing)

    def close(self) -> None:
        """Wait until the last snapshot is drawn, but not forever."""
        super().close()
        with self._lifeline:
            try:
                self._process.wait(WAIT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def snapshot(run: "RobotRun", *, title: str, notes: Sequence[str], joint: int | None) -> dict[str, Any]:
    """Return the present state of robot 0 as plain data, with a title, notes and the operator's joint, if any."""
    runtime, timing = run.runtime, run.timing
    late = timing.lateness
    return {
        "title": printable(title),
        "t": runtime.t,
        "elapsed": timing.elapsed,
        "left": run.time_left,
        "mode": Mode(int(runtime.supervisor.mode[0])).name,
        "reason": run.reason,
        "rate": timing.recent_rate(),
        "hz": timing.clock.hz,
        "late_us": None if timing.clock.hz is None else (late.p50_us, late.p99_us, late.max_us),
        "skipped": timing.clock.skipped,
        "reached": int(runtime.task.reached[0]),
        "attempted": int(runtime.task.attempted[0]),
        "stops": list(run.statistics.last_stops),
        "notes": [printable(note) for note in notes],
        "joint": joint,
        "joints": _joints(runtime),
    }


def _joints(runtime: Runtime) -> list[list[Any]]:
    state, sent, spec = runtime.state, runtime.setpoint, runtime.spec
    numbers = (
        state.q[0],
        state.qd[0],
        sent.q[0] - state.q[0],
        runtime.command.tau[0],
        *(state.housing_c[0], spec.motor_array("housing_soft_c"), spec.motor_array("housing_max_c")),
        *(state.winding_c[0], spec.motor_array("winding_soft_c"), spec.motor_array("winding_max_c")),
    )
    columns = [[round(float(x), 4) for x in column] for column in numbers]
    return [list(row) for row in zip(spec.joint_names, *columns, strict=True)]
