"""Films: animated GIF and MP4 files of images."""

from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

import av
from PIL import Image as Picture

from deploy.telemetry.output_files import replacing
from eval.video.renderer import HEIGHT, WIDTH, Image
from robots.errors import ConfigError

FRAME_S = 0.04
"""s between two frames; GIF counts in hundredths of a second."""


def check_film(path: Path, option: str = "--video") -> None:
    """Refuse (ConfigError) a file name with an unknown suffix."""
    if path.suffix not in WRITERS:
        found = path.suffix or "no suffix"
        raise ConfigError(f"{option} {path}: found {found}, expected {' or '.join(WRITERS)}")


def write_film(path: Path, images: Iterable[Image], frame_s: float) -> None:
    """Write images of a `Renderer`, `frame_s` s each; the suffix of the path is the format.

    Raises:
        ConfigError: unknown suffix. OutputError: it cannot be written.
    """
    check_film(path)
    with replacing(path, "--video") as file:
        WRITERS[path.suffix](file, images, frame_s)


def _write_gif(file: Path, images: Iterable[Image], frame_s: float) -> None:
    first, *others = (Picture.fromarray(image) for image in images)
    options: dict[str, Any] = {"duration": round(1000 * frame_s), "loop": 0, "optimize": True}
    first.save(file, format="GIF", save_all=True, append_images=others, **options)


def _write_mp4(file: Path, images: Iterable[Image], frame_s: float) -> None:
    with av.open(str(file), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(1 / frame_s).limit_denominator(1000))
        stream.pix_fmt, stream.height, stream.width = "yuv420p", HEIGHT, WIDTH
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


Writer = Callable[[Path, Iterable[Image], float], None]
WRITERS: Mapping[str, Writer] = MappingProxyType({".gif": _write_gif, ".mp4": _write_mp4})
"""Writer of each format, by suffix."""
