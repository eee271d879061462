"""soak-replay: lives the seconds around an event again, from the state before it, and says whether it is the same."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.operation.clock import WallClock
from deploy.operation.loop_timing import RateLimited
from deploy.telemetry.output_files import replacing
from eval.replay.capture_window import write_mcap
from eval.replay.event_table import table
from eval.replay.event_video import Film
from eval.replay.replayer import Replay, why_not
from robots.errors import ConfigError

VIEW_S = 1 / 30
"""s between two pictures of the viewer."""


def soak_replay(
    bundle: Annotated[Path, typer.Argument(help="Folder of an event that soak-test wrote.")],
    view: Annotated[bool, typer.Option("--view", help="Show it in MuJoCo's viewer as it goes.")] = False,
    video: Annotated[
        Path | None, typer.Option(help="GIF to render it into; needs OpenGL (EGL) and no display.")
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(help="MCAP for every signal of the replay; the bundle holds the original's."),
    ] = None,
) -> int:
    """Live an event again and say whether it came out the same, bit for bit.

    Exit codes: 0 reproduced, 1 not reproduced, 2 bad input.
    """
    console = Console()
    if video is not None and video.suffix != ".gif":
        raise ConfigError(f"--video {video}: found {video.suffix or 'no suffix'}, expected .gif")
    replay = Replay(bundle)
    _introduce(replay, console)
    film = None if video is None else Film(replay.spec)
    again = replay.live(_viewer(replay) if view else lambda: None)
    for line in table(replay, again):
        _say(console, line)
    if mcap is not None:
        with replacing(mcap) as file:
            write_mcap(file, replay.spec, again.rows, goal_m=replay.goal_m, about=replay.about.event.said())
    if video is not None and film is not None:
        film.write(video, replay, again)
    apart = why_not(replay, again)
    ticks, rest = len(again.rows), "the event, and the state of all robots at the end"
    same = f"reproduced: commands and every other signal of {ticks} ticks, {rest} agree bit for bit"
    _say(console, f"not reproduced: {apart}" if apart else same)
    return BUDGET_EXCEEDED if apart else PASSED


def _introduce(replay: Replay, console: Console) -> None:
    about, dt = replay.about, replay.spec.dt
    event = about.event
    where = f" of {event.joint}" if event.joint else ""
    _say(console, f"robot {event.robot} of seed {about.job.seed}: {event.monitor}{where}")
    worst = "no number" if event.worst is None else f"{event.worst:.4g} of its limit"
    _say(console, f"from {event.start * dt:.3f} s on, for {event.ticks} ticks, at worst {worst}")
    _say(console, f"living from {about.begin * dt:.3f} s to {about.end * dt:.3f} s again")
    for name, (here, there) in replay.differs.items():
        _say(console, f"differs: {name}: {here:.40} here, {there:.40} in the bundle")


def _say(console: Console, line: str) -> None:
    console.print(line, soft_wrap=True, markup=False, highlight=False)


def _viewer(replay: Replay) -> Callable[[], None]:
    """Shows the robot in its own time."""
    from deploy.backends.sim.view import View

    clock, window = WallClock(replay.spec.dt), RateLimited(VIEW_S, View(replay.shard.robot, replay.row).step)

    def step() -> None:
        clock.wait()
        window(None)

    return step


def cli() -> None:
    """Entry point of `soak-replay`."""
    main(soak_replay)
