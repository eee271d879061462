"""Films of events."""

import numpy as np
import pytest
from mcap.reader import make_reader
from onnx import helper
from PIL import Image

from support.eval.bundles import SCRIPT, replayed
from support.eval.soaks import soak_config
from support.faulty_policies import written
from support.walking import PLACES, QUADRUPED, walking_contract

pytest.importorskip("mujoco")

from eval.replay import bundle
from eval.replay.event_capture import EventCapture
from eval.replay.replayer import Replay
from eval.shard.shard import Shard

pytestmark = pytest.mark.slow


def frames_of(folder, path, places, script=SCRIPT):
    """Frames (H, W, 3) of the video of an event, its number of frames and its information.

    In a process of its own: Mesa's LLVM and the one that comes with torch do not bear each other.
    """
    done = replayed(folder, "--video", path, script=script)
    if "needs OpenGL" in done.stderr:
        pytest.skip("there is no OpenGL")
    assert (done.returncode, done.stderr) == (0, "")
    frames = []
    with Image.open(path) as picture:
        for place in places:
            picture.seek(place if place >= 0 else picture.n_frames + place)
            frames.append(np.asarray(picture.convert("RGB"), dtype=float))
        return frames, picture.n_frames, picture.info


def assert_moving(frames):
    assert frames[0].std() > 10
    assert np.abs(frames[1] - frames[0])[:300].max() > 50


def test_an_event_becomes_a_moving_picture(events, tmp_path):
    bundles = [(bundle.open_bundle(path), path) for path in events.iterdir()]
    about, folder = min(bundles, key=lambda b: b[0].end - b[0].begin)
    frames, count, info = frames_of(folder, tmp_path / "a.gif", (0, -1))
    assert count == pytest.approx((about.end - about.begin) / 8, abs=2)
    assert info["duration"] == 40
    assert_moving(frames)


@pytest.fixture(scope="module")
def fallen(tmp_path_factory):
    """The bundle of a quadruped whose policy folds it up, in a soak of a second."""
    folder, contract = tmp_path_factory.mktemp("fallen"), walking_contract()
    w = np.zeros((contract.observation_size, contract.action_size), np.float32)
    w[PLACES["projected_gravity"].stop - 1] = -2.0
    node = helper.make_node("MatMul", ["observation", "w"], ["action"])
    path = written(folder, [node], {"w": w}, contract)
    (job,) = soak_config(path, QUADRUPED, hours=1.0 / 3600, robots=1).jobs()
    shard = Shard(job)
    capture = EventCapture(job, shard, folder / "events")
    shard.run(lambda _: None, lambda: False, lambda: capture.flush(shard), capture.observe)
    return min((folder / "events").iterdir())


def test_base_pose_is_recorded(fallen):
    replay = Replay(fallen)
    rows = replay.recorded
    height, lean = rows["base_true"][:, 2], rows["base_true"][:, 3:]
    assert (np.diff(rows["tick"]) == 1).all()
    assert 0.1 < height[0] < 1.0
    assert np.ptp(height) > 0.02
    np.testing.assert_allclose(np.linalg.norm(lean, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(rows["orientation"], lean, atol=0.2)  # as believed
    with (fallen / "window.mcap").open("rb") as file:
        transforms = [m for _, channel, m in make_reader(file).iter_messages() if channel.topic == "/tf"]
    assert len(transforms) == len(rows)


def test_camera_follows_a_walking_robot(fallen, tmp_path):
    assert_moving(frames_of(fallen, tmp_path / "a.gif", (0, -1))[0])


FAR = """
from eval.replay import cli as replay
from eval.replay import event_video as film
class Far(film.EventVideo):
    shown = 0
    def render_row(self, row):
        self.shown += 1
        if self.shown > 4:  # those that are looked at, and the one that comes before them
            return self.last
        row = row.copy()
        row["base_true"][0] += 500.0
        self.last = super().render_row(row)
        return self.last
replay.EventVideo = Far
replay.cli()
"""


def test_first_frame_far_from_the_origin_is_as_bright_as_the_others(fallen, tmp_path):
    bright = [frame[:300].mean() for frame in frames_of(fallen, tmp_path / "a.gif", range(3), FAR)[0]]
    assert bright == pytest.approx([bright[-1]] * 3, rel=0.1)
