"""soak-replay: simulate the seconds around an event again and compare them with the recording."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.operation.loop_timing import RateLimited, WallClock
from deploy.telemetry.output_files import check_file, replacing
from deploy.telemetry.plain_console import plain_console
from eval.replay.capture_window import write_mcap
from eval.replay.event_video import EventVideo
from eval.replay.replay_text import mismatch, table
from eval.replay.replayer import Replay
from eval.video.film import check_film
from robots.errors import OutputError, printable

VIEW_S = 1 / 30
"""s between two frames of the viewer."""


BundleFolder = Annotated[Path, typer.Argument(help="Folder of an event from soak-test.")]
View = Annotated[bool, typer.Option("--view", help="Show the replay in MuJoCo's viewer.")]
VideoFile = Annotated[
    Path | None, typer.Option(help="GIF or MP4 file to render to; needs OpenGL (EGL), but no display.")
]
McapFile = Annotated[
    Path | None,
    typer.Option(help="MCAP file for every signal of the replay; the bundle contains the original."),
]


def soak_replay(
    bundle: BundleFolder, view: View = False, video: VideoFile = None, mcap: McapFile = None
) -> int:
    """Simulate an event again and check that it is the same, bit for bit.

    Exit codes: 0 reproduced, 1 not reproduced, 2 bad input.
    """
    console = plain_console()
    outputs = {name: path for name, path in (("--video", video), ("--mcap", mcap)) if path is not None}
    _keep_bundle(bundle, outputs)
    if video is not None:
        check_film(video)
    replay = Replay(bundle)
    for option, path in outputs.items():
        check_file(path, option)
    _print_event(replay, console)
    renderer = None if video is None else EventVideo(replay.spec)
    result = replay.run(_viewer(replay) if view else lambda: None)
    with replay.reading_state():
        lines = list(table(replay, result))
    for line in lines:
        _print(console, line)
    if mcap is not None:
        with replacing(mcap, "--mcap") as file:
            write_mcap(
                file, replay.spec, result.rows, goal_m=replay.goal_m, about=replay.info.event.as_text()
            )
    if video is not None and renderer is not None:
        renderer.write(video, replay, result)
    difference = mismatch(replay, result)
    _print(console, f"not reproduced: {difference}" if difference else _reproduced(len(result.rows)))
    return BUDGET_EXCEEDED if difference else PASSED


def _keep_bundle(folder: Path, written: dict[str, Path]) -> None:
    """Refuse (OutputError) to write into the bundle itself, or two files into one place."""
    places = {option: Path(os.path.realpath(path)) for option, path in written.items()}
    for option, place in places.items():
        if place.is_relative_to(os.path.realpath(folder)):
            raise OutputError(
                f"{option} {written[option]}: found a place in the bundle, expected another one"
            )
    if len({*places.values()}) < len(places):
        raise OutputError(f"{' and '.join(places)}: found the same file, expected two")


def _reproduced(ticks: int) -> str:
    return (
        f"reproduced: all signals of {ticks} ticks, the event, and the state of all robots at the end agree"
        " bit for bit"
    )


def _print_event(replay: Replay, console: Console) -> None:
    info, dt = replay.info, replay.spec.dt
    event = info.event
    joint = f" of {event.joint}" if event.joint else ""
    _print(console, f"robot {event.robot} of seed {info.job.seed}: {event.monitor}{joint}")
    worst = "not finite" if event.worst is None else f"{event.worst:.4g} of its limit"
    _print(console, f"starts at {event.start * dt:.3f} s, lasts {event.ticks} ticks, worst load {worst}")
    _print(console, f"replaying from {info.begin * dt:.3f} s to {info.end * dt:.3f} s")
    for name, (here, there) in replay.differences.items():
        _print(console, f"differs: {name}: {here:.40} here, {there:.40} in the bundle")


def _print(console: Console, line: str) -> None:
    console.print(printable(line), soft_wrap=True, highlight=False)


def _viewer(replay: Replay) -> Callable[[], None]:
    from deploy.backends.sim.view import View as Viewer

    clock, view = WallClock(replay.spec.dt), RateLimited(VIEW_S, Viewer(replay.shard.robot, replay.row).step)

    def step() -> None:
        clock.wait()
        view(None)

    return step


def cli() -> None:
    """Entry point of `soak-replay`."""
    main(soak_replay)
