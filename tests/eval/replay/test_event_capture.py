"""Bundles of a shard that is resumed."""

import os
import shutil
from contextlib import nullcontext
from dataclasses import replace

import pytest

pytest.importorskip("mujoco")

from eval.judge.limits import load_limits
from eval.replay import bundle
from eval.replay.bundle_files import state_digest
from eval.replay.event_capture import EventCapture
from eval.shard.shard import Shard
from robots.distributions import load_distributions
from robots.errors import ConfigError, FirstshiftError
from robots.spec import load_robot
from support.arm6 import SPEC
from support.eval.shards import job


def live(shard, witness, *, until=10**9):
    def keep():
        witness.flush(shard)
        kept.append(shard.save())

    kept, seen = [], []
    shard.run(seen.append, lambda: seen[-1] >= until, keep, witness.observe)
    return kept


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_resumed_shard_writes_identical_bundles(pushed, tmp_path):
    """Kept after 1 s of 2.05; and nobody who looks on changes anything."""
    job = replace(pushed.jobs()[0], first=6, robots=1, ticks=410)
    whole, cut, rest, alone = (Shard(job) for _ in range(4))
    whole.checkpoint_ticks = rest.checkpoint_ticks = 200
    live(whole, EventCapture(job, whole, tmp_path / "whole"))
    rest.restore(live(cut, EventCapture(job, cut, tmp_path / "parts"), until=200)[-1])
    live(rest, EventCapture(job, rest, tmp_path / "parts"))
    alone.run(lambda _: None, lambda: False)
    assert len({state_digest(shard.save()) for shard in (whole, rest, alone)}) == 1
    assert files(tmp_path / "whole") == files(tmp_path / "parts")
    starts = [bundle.open_bundle(path).event.start for path in (tmp_path / "whole").iterdir()]
    assert min(starts) < 200 <= max(starts)


@pytest.mark.slow
def test_irreproducible_shard_writes_no_bundle(pushed, tmp_path):
    job = replace(pushed.jobs()[0], ticks=240)
    shard = Shard(job)
    witness = EventCapture(job, shard, tmp_path / "events")

    def meddle(shard):
        shard.runtime.task.number += shard.runtime.ticks == 100
        witness.observe(shard)

    with pytest.raises(RuntimeError, match="ticks 0 to 240 differ when"):
        shard.run(lambda _: None, lambda: False, lambda: witness.flush(shard), meddle)
    assert not (tmp_path / "events").exists()


@pytest.mark.parametrize("replace_policy", [lambda path: path.write_bytes(b"other"), os.mkfifo])
def test_bundles_contain_the_policy_that_the_shard_has_loaded(arm_policy, tmp_path, replace_policy):
    """Even if its file is another one by then, or none that ends."""
    policy = tmp_path / "policy.onnx"
    shutil.copy(arm_policy, policy)
    asked = job(policy)
    shard = Shard(asked)
    policy.unlink()
    replace_policy(policy)
    capture = EventCapture(asked, shard, tmp_path / "events")
    (tmp_path / "bundle").mkdir()
    capture._write_inputs(tmp_path / "bundle")
    assert (tmp_path / "bundle" / "policy.onnx").read_bytes() == arm_policy.read_bytes()


@pytest.fixture
def copied_robot(arm_policy, tmp_path):
    """Job of a robot whose files can be changed, and its shard."""
    shutil.copytree(SPEC.folder, tmp_path / "arm6")
    spec = load_robot(tmp_path / "arm6")
    asked = replace(
        job(arm_policy),
        robot=spec.folder,
        draws_digest=load_distributions(spec).digest,
        limits_digest=load_limits(spec).digest,
    )
    return asked, Shard(asked)


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("robot.toml", "name = ", "# other\nname = ", None),
        ("model.xml", 'mass="', 'mass="1', r"arm6: changed during the soak"),
        ("draws.toml", "low = 0.8", "low = 0.81", r"draws\.toml: changed during the soak"),
    ],
)
def test_a_robot_that_changed_since_the_shard_has_loaded_it_is_refused(
    copied_robot, tmp_path, name, old, new, said
):
    asked, shard = copied_robot
    path = tmp_path / "arm6" / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=said) if said else nullcontext():
        EventCapture(asked, shard, tmp_path / "events")


@pytest.mark.parametrize("name", ["robot.toml", "model.xml", "draws.toml", "limits.toml"])
def test_a_pipe_in_the_place_of_a_robots_file_is_refused(copied_robot, tmp_path, name):
    """It would never end."""
    path = tmp_path / "arm6" / name
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(FirstshiftError, match="found a named pipe, expected a regular file"):
        EventCapture(*copied_robot, tmp_path / "events")
