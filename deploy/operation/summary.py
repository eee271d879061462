"""Summary of a run: its statistics, a table for the operator, and the same and more as JSON."""

import json
import sys
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from deploy.operation.stop_explanation import StopDetector
from deploy.reasons import Reason
from deploy.runtime import Runtime
from deploy.telemetry.output_files import replacing
from deploy.telemetry.plain_console import plain_console
from robots.arrays import Floats
from robots.errors import OutputError, printable

if TYPE_CHECKING:
    from deploy.operation.robot_run import RobotRun


STOPS_SHOWN = 4


@dataclass(slots=True, kw_only=True)
class RunStatistics:
    """Counts and maxima over the ticks of one run.

    Attributes:
        stops: stops by reason. last_stops: the newest of them in words, with their time.
        housing_max_c, winding_max_c: °C, estimate for the hottest motor over all ticks; None before the first.
    """

    stops: Counter[str] = field(default_factory=Counter)
    last_stops: deque[str] = field(default_factory=lambda: deque(maxlen=STOPS_SHOWN))
    housing_max_c: float | None = None
    winding_max_c: float | None = None
    _stop_events: StopDetector = field(default_factory=StopDetector)

    def step(self, runtime: Runtime, reason: str) -> None:
        """Count the tick that has just ended; `reason` says in words why the robot does not run."""
        self.housing_max_c = _maximum(self.housing_max_c, runtime.state.housing_c)
        self.winding_max_c = _maximum(self.winding_max_c, runtime.state.winding_c)
        if 0 in self._stop_events.step(runtime):
            bits = int(runtime.supervisor.reason[0])
            self.stops.update(bit.name.lower() for bit in Reason(bits) if bit.name)
            self.last_stops.append(f"{runtime.t:.2f} s: {reason}")


def _maximum(so_far: float | None, celsius: Floats) -> float | None:
    hottest = float(celsius.max())
    if not np.isfinite(hottest):  # not measured yet
        return so_far
    return hottest if so_far is None else max(so_far, hottest)


def report(
    run: "RobotRun", about: Mapping[str, str], path: Path, lost: Sequence[str], printing: ExitStack
) -> list[str]:
    """Write the summary of a finished run to `path`; return what of the run could not be kept.

    Args:
        run, about: for the summary. path: of the summary.
        lost: failures of other files, in words, which are printed, too.
        printing: prints the summary when it closes.
    """
    summary, lost = _summary(run, about), [*lost]
    try:
        with replacing(path) as partial:
            partial.write_text(json.dumps(summary, indent=2) + "\n")
    except OutputError as e:
        lost.append(f"summary {e}")
    printing.callback(_print, summary, lost)
    return lost


def _print(summary: Mapping[str, Any], lost: Sequence[str]) -> None:
    plain_console().print(_table(summary))
    for text in lost:
        print(printable(f"error: not kept: {text}"), file=sys.stderr)


def _summary(run: "RobotRun", about: Mapping[str, str]) -> dict[str, Any]:
    timing, task, statistics, recorder = run.timing, run.runtime.task, run.statistics, run.recorder
    return {
        "ended": run.ending.value if run.ending else None,
        "reason": run.reason,
        **about,
        "ticks": run.runtime.ticks,
        "time_s": run.runtime.t,
        "wall_s": timing.elapsed,
        "rate_hz": timing.rate,
        "late_us": timing.lateness._asdict(),
        "skipped": timing.clock.skipped,
        "stops": dict(statistics.stops),
        "last_stops": list(statistics.last_stops),
        "goals": {"reached": int(task.reached[0]), "attempted": int(task.attempted[0])},
        "housing_max_c": statistics.housing_max_c,
        "winding_max_c": statistics.winding_max_c,
        "recording": str(recorder.path),
        "lost": recorder.lost,
        "events": [str(event) for event in recorder.events],
    }


def _table(s: Mapping[str, Any]) -> Table:
    late, goals, housing, winding = s["late_us"], s["goals"], s["housing_max_c"], s["winding_max_c"]
    heat = "" if None in (housing, winding) else f"{housing:.0f} °C housings, {winding:.0f} °C windings"
    rows = {
        "ended": s["ended"] if s["ended"] == "done" else f"{s['ended']}: {s['reason']}",
        "robot": f"{s['robot']} {s['robot_digest'][:12]}",
        "policy": f"{s['policy']} {s['policy_digest'][:12]}",
        "ticks": f"{s['ticks']} in {s['wall_s']:.1f} s: {s['rate_hz']:.1f} Hz, {s['skipped']} slots skipped",
        "lateness": f"p50 {late['p50_us']:.0f} µs, p99 {late['p99_us']:.0f} µs, max {late['max_us']:.0f} µs",
        "stops": ", ".join(f"{name} {count}" for name, count in s["stops"].items()) or "none",
        "last stops": "\n".join(s["last_stops"]) or "none",
        "goals": f"{goals['reached']} of {goals['attempted']} reached (estimated)",
        "hottest motor": f"{heat} (estimated)" if heat else "unknown",
        "recording": " ".join([s["recording"], *s["events"]]),
    }
    table = Table.grid(padding=(0, 2))
    for name, text in rows.items():
        table.add_row(name, "\n".join(map(printable, text.split("\n"))))
    return table
