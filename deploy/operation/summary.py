"""What is left of a run: a few lines for the operator, the same and more as JSON."""

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from deploy.operation.robot_run import Shift
from deploy.telemetry.output_files import replacing
from robots.errors import OutputError


def report(shift: Shift, about: Mapping[str, str], path: Path, *, lost: str | None = None) -> None:
    """Write the summary of a run that is over to `path`, and print it, with what else was lost to the disk.

    A disk that fails now is said and not raised: the exit code is about the robot.
    """
    summary = _summary(shift, about)
    warnings = [what for what in (shift.recorder.lost, lost) if what]
    try:
        with replacing(path) as partial:
            partial.write_text(json.dumps(summary, indent=2) + "\n")
    except OutputError as e:
        warnings.append(str(e))
    Console().print(_table(summary))
    for what in warnings:
        print(f"warning: {what}", file=sys.stderr)


def _summary(shift: Shift, about: Mapping[str, str]) -> dict[str, Any]:
    pace, task, tally, recorder = shift.pace, shift.runtime.task, shift.tally, shift.recorder
    return {
        "ended": shift.ending.value if shift.ending else None,
        "reason": shift.reason,
        **about,
        "ticks": shift.runtime.ticks,
        "time_s": shift.runtime.t,
        "wall_s": pace.elapsed,
        "rate_hz": pace.rate,
        "late_us": asdict(pace.lateness),
        "skipped": pace.skipped,
        "stops": dict(tally.stops),
        "last_stops": list(tally.last),
        "goals": {"reached": int(task.reached[0]), "attempted": int(task.attempted[0])},
        "housing_max_c": tally.housing_max_c,
        "winding_max_c": tally.winding_max_c,
        "recording": str(recorder.path),
        "recording_lost": recorder.lost,
        "events": [str(event) for event in recorder.events],
    }


def _heat(housing: float | None, winding: float | None) -> str:
    if housing is None or winding is None:
        return ""
    return f"housings at most {housing:.0f} °C, windings {winding:.0f} °C, as believed"


def _table(s: dict[str, Any]) -> Table:
    late, goals = s["late_us"], s["goals"]
    rows = {
        "ended": s["ended"] if s["ended"] == "done" else f"{s['ended']}: {s['reason']}",
        "robot": f"{s['robot']} {s['robot_digest'][:12]}",
        "policy": f"{s['policy']} {s['policy_digest'][:12]}",
        "ticks": f"{s['ticks']} in {s['wall_s']:.1f} s: {s['rate_hz']:.1f} Hz, {s['skipped']} slots skipped",
        "late": f"p50 {late['p50_us']:.0f} µs, p99 {late['p99_us']:.0f} µs, max {late['max_us']:.0f} µs",
        "stops": ", ".join(f"{name} {count}" for name, count in s["stops"].items()) or "none",
        "last stops": "\n".join(s["last_stops"]) or "none",
        "goals": f"{goals['reached']} of {goals['attempted']} reached, by the robot's own estimate",
        "heat": _heat(s["housing_max_c"], s["winding_max_c"]),
        "recording": " ".join([s["recording"], *s["events"]]),
    }
    table = Table.grid(padding=(0, 2))
    for name, text in rows.items():
        table.add_row(name, text)
    return table
