"""Display of the console: draws snapshots, read as JSON lines from standard input.

python -P -m deploy.telemetry.console_display LIFELINE < snapshots

Runs as a process of its own, started by `deploy.telemetry.console`: drawing a table takes longer than a tick, and a
stopped or slow terminal must not stop a robot. Imports nothing from this project but what ends it with that process.
"""

import json
import math
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from robots.child_process import end_with

Snapshot = dict[str, Any]
COLOURS = {"RUNNING": "green", "STOPPING": "yellow", "HOLDING": "yellow", "LATCHED": "red"}
LAST_S = 2.0
"""s after the end of the robot's process in which the last snapshot can be drawn, and the cursor shown again."""
COLUMNS = ("joint", "q rad", "qd rad/s", "error mrad", "torque N·m", "housing °C", "winding °C")


def table(s: Snapshot) -> RenderableType:
    """Lay out one snapshot as a table of joints with a list of facts below."""
    facts = Table.grid(padding=(0, 2))
    for name, text in _facts(s):
        facts.add_row(Text(name, style="dim"), text)
    joints = Table(title=s["title"], title_justify="left")
    for column in COLUMNS:
        joints.add_column(column, justify="left" if column == "joint" else "right")
    for name, q, qd, error, tau, *heat in s["joints"]:
        numbers = (f"{q:+.3f}", f"{qd:+.3f}", f"{error * 1e3:+.1f}", f"{tau:+.1f}")
        joints.add_row(name, *numbers, _heat(*heat[:3]), _heat(*heat[3:]))
    return Group(joints, facts)


def _facts(s: Snapshot) -> Iterable[tuple[str, Text]]:
    left = "" if s["left"] is None else f", {s['left']:.1f} s left"
    requested = "any" if s["hz"] is None else f"{s['hz']:.0f}"
    yield "mode", Text(f"{s['mode']} {s['reason']}".strip(), style=COLOURS.get(s["mode"], ""))
    yield "time", Text(f"{s['t']:.1f} s{left}")
    yield "rate", Text(f"{s['rate']:.0f} Hz of {requested}, {s['skipped']} slots skipped")
    if s["late_us"] is not None:
        p50, p99, worst = s["late_us"]
        yield "lateness", Text(f"p50 {p50:.0f} µs, p99 {p99:.0f} µs, max {worst:.0f} µs")
    yield "goals", Text(f"{s['reached']} of {s['attempted']} reached")
    yield "stops", Text("\n".join(s["stops"]) or "none")
    for note in s["notes"]:
        yield "note", Text(note, style="red")


def _heat(celsius: float, soft: float, limit: float) -> Text:
    style = "red" if celsius >= limit else "yellow" if celsius >= soft else ""
    return Text(f"{celsius:.0f} of {limit:.0f}", style=style)


def line(s: Snapshot) -> str:
    """Format one snapshot as a line, for an output that is no terminal."""
    hottest = max(joint[5] for joint in s["joints"])
    parts = [f"{s['t']:.1f} s", s["mode"], f"{s['rate']:.0f} Hz", f"{s['skipped']} skipped"]
    parts += [f"goals {s['reached']}/{s['attempted']}", f"{hottest:.0f} °C"]
    if s["joint"] is not None:
        name, q, *_ = s["joints"][s["joint"]]
        parts.append(f"{name} {math.degrees(q):+.1f}°")
    return "  ".join([*parts, s["reason"]]).strip()


def follow(lines: Iterable[str], console: Console) -> None:
    """Draw snapshots until the input ends."""
    with ExitStack() as stack:
        draw: Callable[[Snapshot], None] = _LinePrinter(console)
        if console.is_terminal:
            live = stack.enter_context(Live(console=console, auto_refresh=False))
            draw = lambda s: live.update(table(s), refresh=True)  # noqa: E731
        for text in lines:
            if text.endswith("\n"):  # the last line may have been cut
                draw(json.loads(text))


class _LinePrinter:
    """One line per second of wall time, and one for each change of mode, notes or the operator's joint.

    Each note is printed once.
    """

    def __init__(self, console: Console) -> None:
        self._console, self._second = console, -1
        self._printed: tuple[object, ...] = ()
        self._notes: set[str] = set()

    def __call__(self, s: Snapshot) -> None:
        news = (s["mode"], s["notes"], s["joint"])
        if int(s["elapsed"]) != self._second or news != self._printed:
            self._console.print(line(s), soft_wrap=True, highlight=False)
            for note in s["notes"]:
                if note not in self._notes:
                    self._console.print(f"note: {note}", soft_wrap=True, highlight=False)
            self._notes.update(s["notes"])
        self._second, self._printed = int(s["elapsed"]), news


if __name__ == "__main__":
    end_with(int(sys.argv[1]), LAST_S)
    try:
        with open(sys.stdin.fileno(), encoding="utf-8") as lines:  # whatever the terminal's encoding
            follow(lines, Console(markup=False, emoji=False))
    except OSError:  # nobody can see it any more: the output was closed, or is full
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
