"""Films of known images."""

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("mujoco")
av = pytest.importorskip("av")

from eval.video.film import write_film
from eval.video.renderer import HEIGHT, WIDTH, Renderer
from robots.errors import ConfigError, OutputError
from support.planar import PLANAR3

FRAMES = 10


def images():
    """A grey that becomes brighter from frame to frame."""
    for k in range(FRAMES):
        yield np.full((HEIGHT, WIDTH, 3), 20 * k, np.uint8)


def read_gif(path):
    with Image.open(path) as picture:
        frames = []
        for k in range(picture.n_frames):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB"), dtype=float))
        return frames, picture.info["duration"] / 1000


def read_mp4(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24").astype(float) for frame in container.decode(stream)]
        return frames, float(1 / stream.average_rate)


@pytest.mark.parametrize(("name", "read"), [("a.gif", read_gif), ("a.mp4", read_mp4)])
def test_film_holds_every_image_for_its_time(tmp_path, name, read):
    write_film(tmp_path / name, images(), 0.04)
    frames, frame_s = read(tmp_path / name)
    assert frame_s == pytest.approx(0.04)
    assert frames[0].shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose([frame.mean() for frame in frames], 20.0 * np.arange(FRAMES), atol=4)


def test_unknown_suffix_is_refused_before_anything_is_rendered(tmp_path):
    with pytest.raises(ConfigError, match=r"a.avi: found .avi, expected .gif or .mp4"):
        write_film(tmp_path / "a.avi", iter(()), 0.04)


def test_film_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "a.gif").mkdir()
    with pytest.raises(OutputError, match=r"--video .*a.gif: found a folder"):
        write_film(tmp_path / "a.gif", images(), 0.04)


def test_no_opengl_is_bad_input(monkeypatch):
    monkeypatch.setattr("eval.video.renderer.CONTEXTS", ("none", "either"))
    said = r"--video: needs OpenGL, found none of none \(No module named .*\), either \(No module named"
    with pytest.raises(ConfigError, match=said):
        Renderer(PLANAR3)
