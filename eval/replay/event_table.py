"""An event in words: the ticks around its start, one line each."""

from collections.abc import Iterator

from deploy.safety.supervisor import describe
from deploy.state import Mode
from deploy.telemetry.ring import Rows
from eval.replay.replayer import Again, Replay

BEFORE, AFTER = 5, 10
"""Ticks that are shown before an event, and from its first on."""
OF_TOOL = ("x m", "y m", "z m", "speed m/s")
OF_JOINT = ("q sent", "q true", "q est.", "qd true", "N·m sent", "N·m true", "winding °C")


def table(replay: Replay, again: Again) -> Iterator[str]:
    """Load, which is 1 at the limit, mode and what moved, bad ticks marked; then each stop, and what it was about."""
    event, spec = replay.about.event, replay.spec
    joint = None if event.joint is None else spec.joint_names.index(event.joint)
    names = OF_TOOL if joint is None else OF_JOINT
    yield _line(" tick", "mode", "load", names, "reasons")
    start = event.start - replay.about.begin
    for place in range(max(0, start - BEFORE), min(len(again.rows), start + AFTER)):
        row, load = again.rows[place], again.load[place]
        numbers = _of_tool(row) if joint is None else _of_joint(row, joint)
        mark, reason = " " if load <= 1 else "!", int(row["reason"])
        shown = tuple(f"{x:.4g}" for x in numbers)
        tick, mode = f"{mark}{place - start:+4d}", Mode(int(row["mode"])).name
        yield _line(tick, mode, f"{load:.4g}", shown, describe(reason) if reason else "")
    for place, why in again.stops.items():
        yield f"stopped in tick {place - start:+d}: {why}"


def _line(tick: str, mode: str, load: str, numbers: tuple[str, ...], reasons: str) -> str:
    return f"{tick} {mode:<9}{load:>8}{''.join(f'{x:>11}' for x in numbers)}  {reasons}".rstrip()


def _of_tool(row: Rows) -> tuple[float, ...]:
    velocity = row["tool_velocity_true"]
    return (*row["tool_true"].tolist(), float(velocity @ velocity) ** 0.5)


def _of_joint(row: Rows, joint: int) -> tuple[float, ...]:
    names = ("q_sent", "q_true", "q", "qd_true", "tau_sent", "tau_true", "winding_true_c")
    return tuple(float(row[name][joint]) for name in names)
