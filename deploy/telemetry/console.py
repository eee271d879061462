"""The runtime's end of the picture that `deploy.telemetry.console_display` draws in another process."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deploy.operation.loop_timing import Pace
from deploy.runtime import Runtime
from deploy.state import Mode

WAIT_S = 5.0


class Screen:
    """Takes snapshots and never waits: what the other side is too slow for is left out."""

    def __init__(self, pipe: int) -> None:
        """Send to a pipe's writing end."""
        os.set_blocking(pipe, False)
        self._pipe: int | None = pipe
        self._rest = b""

    def offer(self, snapshot: dict[str, Any]) -> None:
        """Send a snapshot, or the rest of the one before, which the pipe took half."""
        if self._pipe is None:
            return
        data = self._rest or json.dumps(snapshot).encode() + b"\n"
        try:
            self._rest = data[os.write(self._pipe, data) :]
        except BlockingIOError:
            pass
        except OSError:  # nobody is looking any more
            self._hang_up()

    def close(self) -> None:
        """No more snapshots."""
        self._hang_up()

    def _hang_up(self) -> None:
        if self._pipe is not None:
            os.close(self._pipe)
        self._pipe = None


class Show(Screen):
    """A screen with somebody behind it: `deploy.telemetry.console_display` on this process's standard output."""

    def __init__(self) -> None:
        """Start the other process, out of reach of this terminal's Ctrl-C."""
        reading, writing = os.pipe()
        command = [sys.executable, "-P", str(Path(__file__).with_name("console_display.py"))]
        self._process = subprocess.Popen(command, stdin=reading, process_group=0)
        os.close(reading)
        super().__init__(writing)

    def close(self) -> None:
        """Let it draw the last picture."""
        super().close()
        try:
            self._process.wait(WAIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def snapshot(
    runtime: Runtime,
    pace: Pace,
    *,
    title: str,
    reason: str,
    left: float | None,
    hz: float | None,
    stops: Sequence[str],
    notes: Sequence[str],
) -> dict[str, Any]:
    """Robot 0 now, as plain data.

    Args:
        runtime: after a tick.
        pace: of its ticks.
        title: which run this is. reason: why the robot does not run, in words.
        left: s of robot time until the end, None if there is none.
        hz: the rate asked for, None if it is as fast as possible.
        stops: the last ones, in words.
        notes: what else the operator should know.
    """
    late = pace.lateness
    return {
        "title": title,
        "t": runtime.t,
        "elapsed": pace.elapsed,
        "left": left,
        "mode": Mode(int(runtime.supervisor.mode[0])).name,
        "reason": reason,
        "rate": pace.recent_rate(),
        "hz": hz,
        "late_us": None if hz is None else (late.p50_us, late.p99_us, late.max_us),
        "skipped": pace.skipped,
        "reached": int(runtime.task.reached[0]),
        "attempted": int(runtime.task.attempted[0]),
        "stops": list(stops),
        "notes": list(notes),
        "joints": _joints(runtime),
    }


def _joints(runtime: Runtime) -> list[list[Any]]:
    state, sent, spec = runtime.state, runtime.setpoint, runtime.spec
    numbers = (
        state.q[0],
        state.qd[0],
        sent.q[0] - state.q[0],
        runtime.command.tau[0],
        *(state.temperature[0], spec.motor_array("housing_soft_c"), spec.motor_array("housing_max_c")),
        *(state.winding[0], spec.motor_array("winding_soft_c"), spec.motor_array("winding_max_c")),
    )
    columns = [[round(float(x), 4) for x in column] for column in numbers]
    return [list(row) for row in zip(spec.joint_names, *columns, strict=True)]
