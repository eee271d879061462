"""What the operator sees: snapshots of a run, one JSON line each on standard input, drawn as they come.

Runs as a process of its own, started by `deploy.telemetry.console`: drawing a table takes longer than a tick, and a
terminal that is stopped or slow must not stop a robot. Imports nothing of this project.
"""

import json
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

Snapshot = dict[str, Any]
COLOURS = {"RUNNING": "green", "STOPPING": "yellow", "HOLDING": "yellow", "LATCHED": "red"}
COLUMNS = ("joint", "q rad", "qd rad/s", "error mrad", "torque N·m", "housing °C", "winding °C")


def table(s: Snapshot) -> RenderableType:
    """The whole picture of one snapshot."""
    head = Table.grid(padding=(0, 2))
    for name, text in _head(s):
        head.add_row(Text(name, style="dim"), text)
    joints = Table(title=s["title"], title_justify="left")
    for column in COLUMNS:
        joints.add_column(column, justify="left" if column == "joint" else "right")
    for name, q, qd, error, tau, *heat in s["joints"]:
        numbers = (f"{q:+.3f}", f"{qd:+.3f}", f"{error * 1e3:+.1f}", f"{tau:+.1f}")
        joints.add_row(name, *numbers, _heat(*heat[:3]), _heat(*heat[3:]))
    return Group(joints, head)


def _head(s: Snapshot) -> Iterable[tuple[str, Text]]:
    yield "mode", Text(f"{s['mode']} {s['reason']}".strip(), style=COLOURS.get(s["mode"], ""))
    yield "time", Text(f"{s['t']:.1f} s{_left(s)}")
    yield "rate", Text(f"{s['rate']:.0f} Hz of {_asked(s)}, {s['skipped']} slots skipped")
    if s["late_us"] is not None:
        p50, p99, worst = s["late_us"]
        yield "late", Text(f"p50 {p50:.0f} µs, p99 {p99:.0f} µs, max {worst:.0f} µs")
    yield "goals", Text(f"{s['reached']} of {s['attempted']} reached")
    yield "stops", Text("\n".join(s["stops"]) or "none")
    for note in s["notes"]:
        yield "note", Text(note, style="red")


def _heat(celsius: float, soft: float, limit: float) -> Text:
    style = "red" if celsius >= limit else "yellow" if celsius >= soft else ""
    return Text(f"{celsius:.0f} of {limit:.0f}", style=style)


def _left(s: Snapshot) -> str:
    return "" if s["left"] is None else f", {s['left']:.1f} s left"


def _asked(s: Snapshot) -> str:
    return "any" if s["hz"] is None else f"{s['hz']:.0f}"


def line(s: Snapshot) -> str:
    """One snapshot where there is no terminal to draw on."""
    hottest = max(joint[5] for joint in s["joints"])
    parts = [f"{s['t']:.1f} s", s["mode"], f"{s['rate']:.0f} Hz", f"{s['skipped']} skipped"]
    parts += [f"goals {s['reached']}/{s['attempted']}", f"{hottest:.0f} °C"]
    return "  ".join([*parts, s["reason"]]).strip()


def follow(lines: Iterable[str], console: Console) -> None:
    """Draw snapshots until there are no more."""
    with ExitStack() as stack:
        draw: Callable[[Snapshot], None] = _Lines(console)
        if console.is_terminal:
            draw = _Table(stack.enter_context(Live(console=console, auto_refresh=False)))
        for text in lines:
            if text.endswith("\n"):  # the last one may have been cut
                draw(json.loads(text))


class _Table:
    """The table, redrawn in place."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def __call__(self, s: Snapshot) -> None:
        """Draw it."""
        self._live.update(table(s), refresh=True)


class _Lines:
    """A line for every second of wall time, and one for everything new."""

    def __init__(self, console: Console) -> None:
        self._console, self._second = console, -1
        self._said: tuple[object, ...] = ()

    def __call__(self, s: Snapshot) -> None:
        """Print it or not."""
        news = (s["mode"], s["notes"])
        if int(s["elapsed"]) != self._second or news != self._said:
            self._console.print(line(s), soft_wrap=True, highlight=False, markup=False)
            for note in s["notes"] if news != self._said else ():
                self._console.print(f"note: {note}", soft_wrap=True, highlight=False, markup=False)
        self._second, self._said = int(s["elapsed"]), news


if __name__ == "__main__":
    follow(sys.stdin, Console())
