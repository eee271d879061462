"""Bundles of a shard that is resumed."""

from dataclasses import replace

import pytest

pytest.importorskip("mujoco")

from eval.replay import bundle
from eval.replay.bundle_files import state_digest
from eval.replay.event_capture import EventCapture
from eval.shard.shard import Shard

pytestmark = pytest.mark.slow


def live(shard, witness, *, until=10**9):
    def keep():
        witness.flush(shard)
        kept.append(shard.save())

    kept, seen = [], []
    shard.run(seen.append, lambda: seen[-1] >= until, keep, witness.observe)
    return kept


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


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
