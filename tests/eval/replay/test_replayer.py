import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from mcap.reader import make_reader
from onnx import helper
from PIL import Image
from rich.console import Console

from support.faulty_policies import written
from support.policies import policy_model, saved
from support.walking import PLACES, QUADRUPED, walking_contract

pytest.importorskip("mujoco")

from deploy.policy.policy import Policy
from deploy.tasks import reach
from eval.replay import bundle
from eval.replay import cli as command
from eval.replay.capture_window import columns
from eval.replay.event_capture import Witness
from eval.replay.event_video import _context
from eval.replay.replayer import Replay, difference, why_not
from eval.soak.configuration import Soak
from eval.soak.profile import Faults
from eval.soak.shard import Shard
from eval.soak.workers import run_soak
from eval.statistics.budget import BUDGET
from robots.errors import ConfigError, RobotError
from robots.spec import ROBOTS, load_robot

PUSHES = {"force_n": (2000.0, 3000.0), "lasts_s": (0.1, 0.2), "every_s": (1.5, 2.0)}
"""What no robot withstands."""
TICKS, ROBOTS_COUNTED = 650, 3


@pytest.fixture(scope="session")
def pushed(tmp_path_factory):
    """A soak of 3.25 s of three arms that are thrown about, by their policy and by somebody else."""
    folder = tmp_path_factory.mktemp("pushed")
    robot = shutil.copytree(ROBOTS / "arm6", folder / "arm6")
    draws = (robot / "draws.toml").read_text()
    for name, (low, high) in PUSHES.items():
        draws = re.sub(rf"(?m)^{name} = .*$", f"{name} = {{ low = {low}, high = {high} }}", draws)
    (robot / "draws.toml").write_text(draws)
    spec, path = load_robot(robot), saved(policy_model(), folder)
    policy = Policy.load(path, spec)
    how = {
        "budget": BUDGET,
        "hours": TICKS * spec.dt / 3600,
        "robots": ROBOTS_COUNTED,
        "seed": 3,
        "workers": 1,
    }
    return Soak(spec=spec, policy=policy, policy_path=path, **how)


@pytest.fixture(scope="session")
def events(pushed, tmp_path_factory):
    """Bundles that its workers wrote."""
    folder = tmp_path_factory.mktemp("soak")
    run_soak(pushed, folder, Console(quiet=True))
    return folder / "events"


@pytest.fixture(scope="session")
def lived(events, _goals):
    """The bundle of a monitor and its window, lived again once for all who only look at it."""

    @cache
    def lived(monitor):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(reach, "goal_pool", lambda spec, config: _goals)
            replay = Replay(first(events, monitor))
            return replay, replay.live()

    return lived


@pytest.fixture
def one(events, tmp_path, quick_goals):
    """A copy of the bundle of an excess of a joint's speed."""
    return shutil.copytree(first(events, "velocity"), tmp_path / "one")


def first(events, monitor):
    return min(events.glob(f"*-{monitor}"))


def resealed(folder, **changes):
    """As somebody writes it who means to mislead."""
    about = bundle.About.model_validate_json((folder / "bundle.json").read_text())
    bundle.seal(folder, about.model_copy(update=changes))


def replayed(*arguments):
    script = "from eval.replay.cli import cli; cli()"
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=False
    )


def test_an_event_is_reproduced_bit_for_bit_in_a_fresh_process(events, tmp_path):
    done = replayed(first(events, "velocity"), "--mcap", tmp_path / "again.mcap")
    assert (done.returncode, done.stderr) == (0, "")
    about = bundle.open_bundle(first(events, "velocity"))
    said = done.stdout
    ticks = about.end - about.begin
    assert f"reproduced: commands and every other signal of {ticks} ticks" in said
    assert "differs" not in said
    assert f"robot {about.event.robot} of seed 3: velocity of {about.event.joint}" in said
    rows = [line for line in said.splitlines() if re.match(r"[ !] *[+-]\d+ ", line)]
    assert [row[0] for row in rows if "-1 " in row[:6]] == [" "]
    assert [row[0] for row in rows if "+0 " in row[:6]] == ["!"]
    when, what = re.search(r"(?m)^stopped in tick ([+-]\d+): (.+)$", said).groups()
    assert abs(int(when)) < ticks
    assert what
    # Written by another process, from ticks that were lived again: the same file.
    assert (tmp_path / "again.mcap").read_bytes() == (first(events, "velocity") / "window.mcap").read_bytes()


def test_every_monitor_that_found_something_left_bundles(events):
    names = {path.name.split("-")[2] for path in events.iterdir()}
    assert {"velocity", "torque", "tool_speed", "tracking"} <= names
    assert {int(path.name[:4]) for path in events.iterdir()} <= set(range(ROBOTS_COUNTED))
    for path in events.iterdir():
        event = bundle.open_bundle(path).event
        assert path.name == bundle.bundle_name(event.robot, event.start, event.monitor)
        assert sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) < 1 << 20


@pytest.mark.parametrize("monitor", ["tool_speed", "velocity"])
def test_the_load_is_that_of_the_ticks(lived, monitor):
    """Above the limit from the event's first tick on, as high as the judge said, and what the signals say."""
    replay, again = lived(monitor)
    event, spec = replay.about.event, replay.spec
    assert why_not(replay, again) == ""
    start = event.start - replay.about.begin
    assert again.load[start] > 1
    assert (again.load[max(0, start - 100) : start] <= 1).all()
    assert again.load[start : start + event.ticks].max() == event.worst
    if monitor == "tool_speed":
        load = np.linalg.norm(again.rows["tool_velocity_true"], axis=1) / spec.workspace.tool_speed_max
    else:
        joint = spec.joint_names.index(event.joint)
        load = np.abs(again.rows["qd_true"][:, joint]) / spec.joints[joint].qd_max
    np.testing.assert_allclose(again.load, load, rtol=1e-12)


def test_the_window_holds_what_led_there_and_what_followed(events):
    abouts = [bundle.open_bundle(path) for path in events.iterdir()]
    for about in abouts:
        assert about.event.start - about.begin >= 200 or about.begin == 0
        assert about.end - about.event.start > 200 or about.end == TICKS
        assert about.end - about.begin <= 800
    assert {0} < {about.begin for about in abouts}
    assert len({about.end for about in abouts}) > 1


def topics(path):
    with path.open("rb") as file:
        found = {}
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append(message.log_time)
    return found


def test_the_recording_holds_every_tick_of_every_signal(one):
    about = bundle.open_bundle(one)
    ticks = [round(tick * 5e6) for tick in range(about.begin, about.end)]
    found = topics(one / "window.mcap")
    for topic in ("/measured", "/setpoint", "/state", "/true", "/true_state"):
        assert found[topic] == ticks


def test_a_difference_names_the_first_signal_and_tick(one):
    replay = Replay(one)
    rows = replay.recorded.copy()
    assert difference(rows, replay.recorded) is None
    rows["q_sent"][70, 2] = np.nextafter(rows["q_sent"][70, 2], 9)
    rows["q"][71:] += 1.0
    apart = difference(rows, replay.recorded)
    assert (apart.tick, apart.signal) == (replay.about.begin + 70, "q_sent")
    rows["reached"][3] += 1
    assert difference(rows, replay.recorded)[:2] == (replay.about.begin + 3, "reached")


def changed(folder, name, change):
    """One array of state.npz as somebody likes it."""
    with np.load(folder / "state.npz") as file:
        arrays = dict(file)
    change(arrays)
    bundle.write_arrays(folder / name, arrays)
    resealed(folder)


@pytest.fixture
def run(monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["soak-replay", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            command.cli()
        said = capsys.readouterr()
        return caught.value.code, said.out, said.err

    return run


def test_another_state_is_not_reproduced(one, run):
    def nudge(arrays):
        arrays["robot.plant.rows"][Replay(one).row, 3] += 1e-9

    changed(one, "state.npz", nudge)
    code, said, complaint = run(one)
    assert (code, complaint) == (1, "")
    assert re.search(r"not reproduced: at tick [+-]\d+ of the event, \w+: found .*, recorded", said)


def test_another_state_at_the_end_is_said(one, lived):
    resealed(one, end_digest="0" * 64)
    assert why_not(Replay(one), lived("velocity")[1]) == "all signals agree, the state at the end does not"


def test_another_event_is_said(one, lived):
    about, (_, again) = bundle.open_bundle(one), lived("velocity")
    assert why_not(Replay(one), again) == ""
    resealed(one, event=about.event.model_copy(update={"ticks": about.event.ticks + 1}))
    assert why_not(Replay(one), again).startswith("the judge found robot=")


def test_what_it_is_lived_with_may_differ(one):
    resealed(one, identity={"mujoco": "3.9"})
    assert Replay(one).differs["mujoco"] == ("4.0.0", "3.9")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda a: a.pop("runtime.asked"), "runtime.asked: missing"),
        (lambda a: a.update(x=np.zeros(2)), "x: unknown"),
        (lambda a: a.update({"judge.worst": np.zeros(3)}), r"judge.worst: found float64 \(3,\), expected"),
        (lambda a: a.update({"runtime.ticks": np.array(5)}), r"runtime.ticks: found 5, expected"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_by_name(one, run, change, complaint):
    changed(one, "state.npz", change)
    code, _, said = run(one)
    assert code == 2
    assert re.fullmatch(rf"error: .*/one/state\.npz: {complaint}.*\n", said)


def test_a_state_that_other_code_kept_is_said_to_be_that(one, run):
    changed(one, "state.npz", lambda arrays: arrays.pop("runtime.asked"))
    resealed(one, identity={"code_digest": "ab" * 32})
    code, _, said = run(one)
    assert code == 2
    assert re.search(
        r"runtime\.asked: missing; code_digest: found \w{12} here, abababababab in the bundle: replay", said
    )


def test_another_policy_is_refused_by_name(one, run):
    model = policy_model()
    model.doc_string = "another one"
    (one / "policy.onnx").write_bytes(model.SerializeToString())
    code, said, complaint = run(one)
    assert (code, said) == (2, "")
    assert re.fullmatch(r"error: .*/one/policy\.onnx: SHA-256: found .*: damaged\n", complaint)
    resealed(one)  # by somebody who says that it belongs there: it is the same, but for its digest
    code, said, _ = run(one)
    assert code == 0
    assert re.search(r"differs: policy_digest: \w{40} here, \w{40} in the bundle", said)


@pytest.mark.parametrize(
    ("event", "complaint"),
    [({"robot": 3}, "event.robot: found 3, expected one of"), ({"joint": None}, "event.joint: found None")],
)
def test_an_event_that_cannot_be_is_refused(one, event, complaint):
    about = bundle.open_bundle(one)
    resealed(one, event=about.event.model_copy(update=event))
    with pytest.raises(ConfigError, match=rf"bundle\.json: {complaint}"):
        Replay(one)


FAULTS = Faults(coverage=0.95, cycle_s=18.0, operator_s=5.0)


@pytest.mark.parametrize(
    ("job", "end", "complaint"),
    [
        ({"ticks": 1 << 53}, None, r"job\.ticks: found 9007199254740992, expected at most 7200000000"),
        (
            {"ticks": 1 << 40, "faults": FAULTS},
            None,
            r"job\.ticks: found 1099511627776, expected at most 36000600",
        ),
        ({"robots": 17}, None, r"job\.robots: found 17, expected at most 16"),
        ({"ticks": 1 << 32}, 1 << 31, r"end: found 2147483648, expected at most \d{3,4}"),
    ],
)
def test_what_would_take_for_ever_is_refused(one, job, end, complaint):
    about = bundle.open_bundle(one)
    resealed(one, job=about.job.model_copy(update=job), end=end or about.end)
    with pytest.raises(ConfigError, match=rf"bundle\.json: {complaint}$"):
        Replay(one)


def test_another_draw_is_refused(one):
    draws = json.loads((one / "draws.json").read_text())
    (one / "draws.json").write_text(json.dumps(draws | {"seed": 4}))
    resealed(one)
    with pytest.raises(ConfigError, match=r"draws\.json: seed: found 4, expected 3"):
        Replay(one)


def test_no_bundle_is_bad_input(tmp_path, run):
    code, said, complaint = run(tmp_path / "none")
    assert (code, said) == (2, "")
    assert re.search(r"none/bundle\.json: cannot be read: No such file", complaint)
    assert run(tmp_path, "--video", tmp_path / "a.mp4")[2].endswith("found .mp4, expected .gif\n")


def test_no_display_is_bad_input(one, run, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, complaint = run(one, "--view")
    assert code == 2
    assert "--view: found neither DISPLAY" in complaint


def test_an_event_becomes_a_moving_picture(events, tmp_path):
    """In a process of its own: Mesa's LLVM and the one that comes with torch do not bear each other."""
    done = replayed(first(events, "velocity"), "--video", tmp_path / "a.gif")
    if "needs OpenGL" in done.stderr:
        pytest.skip("there is no OpenGL")
    assert (done.returncode, done.stderr) == (0, "")
    about = bundle.open_bundle(first(events, "velocity"))
    with Image.open(tmp_path / "a.gif") as picture:
        assert picture.n_frames == pytest.approx((about.end - about.begin) / 8, abs=2)
        assert picture.info["duration"] == 40
        frames = []
        for place in (0, picture.n_frames - 1):
            picture.seek(place)
            frames.append(np.asarray(picture.convert("RGB"), dtype=float))
    assert frames[0].std() > 10
    assert np.abs(frames[1] - frames[0])[:300].max() > 50


@pytest.fixture(scope="module")
def fallen(tmp_path_factory):
    """The bundle of a quadruped whose policy folds it up, in a soak of a few seconds."""
    folder, contract = tmp_path_factory.mktemp("fallen"), walking_contract()
    w = np.zeros((contract.observation_size, contract.action_size), np.float32)
    w[PLACES["projected_gravity"].stop - 1] = -2.0
    node = helper.make_node("MatMul", ["observation", "w"], ["action"])
    path = written(folder, [node], {"w": w}, contract)
    how = {"budget": BUDGET, "hours": 4 / 3600, "robots": 1, "seed": 3, "workers": 1}
    policy = Policy.load(path, QUADRUPED)
    run_soak(Soak(spec=QUADRUPED, policy=policy, policy_path=path, **how), folder, Console(quiet=True))
    return min((folder / "events").iterdir())


def test_where_a_base_was_is_kept(fallen):
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


def test_a_robot_that_walks_is_filmed_where_it_goes(fallen, tmp_path):
    done = replayed(fallen, "--video", tmp_path / "a.gif")
    if "needs OpenGL" in done.stderr:
        pytest.skip("there is no OpenGL")
    assert (done.returncode, done.stderr) == (0, "")
    with Image.open(tmp_path / "a.gif") as picture:
        frames = []
        for place in (0, picture.n_frames - 1):
            picture.seek(place)
            frames.append(np.asarray(picture.convert("RGB"), dtype=float))
    assert frames[0].std() > 10
    assert np.abs(frames[1] - frames[0])[:300].max() > 50


FAR = """
from eval.replay import cli as replay
from eval.replay import event_video as film
class Far(film.Film):
    def _picture(self, row):
        row = row.copy()
        row["base_true"][0] += 500.0
        return super()._picture(row)
replay.Film = Far
replay.cli()
"""


def test_the_first_picture_of_one_that_has_walked_far_is_as_bright_as_the_others(fallen, tmp_path):
    code = [sys.executable, "-c", FAR, str(fallen), "--video", str(tmp_path / "a.gif")]
    done = subprocess.run(code, capture_output=True, text=True, check=False)
    if "needs OpenGL" in done.stderr:
        pytest.skip("there is no OpenGL")
    assert (done.returncode, done.stderr) == (0, "")
    with Image.open(tmp_path / "a.gif") as picture:
        bright = []
        for place in range(3):
            picture.seek(place)
            bright.append(np.asarray(picture.convert("L"), dtype=float)[:300].mean())
    assert bright == pytest.approx([bright[-1]] * 3, rel=0.1)


def test_a_bundle_of_a_model_that_does_not_compile_within_bounds_is_not_opened(one, monkeypatch):
    def refused(model, folder):
        raise RobotError(f"{model}: too dear")

    monkeypatch.setattr("eval.replay.replayer.check_compiles", refused)
    with pytest.raises(RobotError, match=r"model\.xml: too dear"):
        Replay(one)


def test_no_opengl_is_bad_input(monkeypatch):
    monkeypatch.setattr("eval.replay.event_video.CONTEXTS", ("none", "either"))
    with pytest.raises(
        ConfigError, match="--video: needs OpenGL, found none of none, either: No module named"
    ):
        _context()


def live(shard, witness, *, until=10**9):
    def keep():
        witness.begin(shard)
        kept.append(shard.save())

    kept, seen = [], []
    shard.run(seen.append, lambda: seen[-1] >= until, keep, witness.watch)
    return kept


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_shard_that_was_taken_up_leaves_the_same_bundles(pushed, tmp_path, quick_goals):
    """Kept after 1 s of 2.2; and nobody who looks on changes anything."""
    job = replace(pushed.jobs()[0], ticks=440)
    whole, cut, rest, alone = (Shard(job) for _ in range(4))
    whole._keep = rest._keep = 200
    live(whole, Witness(job, whole, tmp_path / "whole"))
    rest.restore(live(cut, Witness(job, cut, tmp_path / "parts"), until=200)[-1])
    live(rest, Witness(job, rest, tmp_path / "parts"))
    alone.run(lambda _: None, lambda: False)
    assert len({bundle.state_digest(shard.save()) for shard in (whole, rest, alone)}) == 1
    assert files(tmp_path / "whole") == files(tmp_path / "parts")
    starts = [bundle.open_bundle(path).event.start for path in (tmp_path / "whole").iterdir()]
    assert min(starts) < 200 <= max(starts)


def test_a_shard_that_does_not_come_to_the_same_again_leaves_no_bundle(pushed, tmp_path, quick_goals):
    job = replace(pushed.jobs()[0], ticks=240)
    shard = Shard(job)
    witness = Witness(job, shard, tmp_path / "events")

    def meddle(shard):
        shard.runtime.task.number += shard.runtime.ticks == 100
        witness.watch(shard)

    with pytest.raises(RuntimeError, match="ticks 0 to 240 were not the same"):
        shard.run(lambda _: None, lambda: False, lambda: witness.begin(shard), meddle)
    assert not (tmp_path / "events").exists()


def test_signals_are_taken_apart_and_put_together(one):
    rows = Replay(one).recorded
    arrays = columns(rows)
    assert all(array.flags.c_contiguous for array in arrays.values())
    np.testing.assert_array_equal(arrays["tick"], rows["tick"])
