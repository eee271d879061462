import json
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from arro3.io import read_parquet

from support.arm6 import SPEC
from support.eval.shards import N, job, lived
from support.eval.soaks import soak_config

pytest.importorskip("mujoco")

from eval.judge.monitors import NAMES
from eval.shard.job import code_digest
from eval.shard.judging import COUNTED
from eval.shard.shard import Shard
from eval.soak.assembly import running_total
from eval.soak.configuration import SAMPLES_MAX
from eval.soak.series import METADATA, WORN, series
from robots.distributions import load_distributions


@pytest.fixture
def soak(arm_policy):
    return soak_config(arm_policy, hours=8.0, robots=10)


def read(data):
    """Columns by name, and what the file says of itself."""
    table = read_parquet(BytesIO(data)).read_all()
    found = {name: table.column(name).to_numpy() for name in table.column_names}
    return found, json.loads(table.schema.metadata[METADATA.encode()])


def test_every_value_of_every_robot_round_trips(soak):
    shards = [lived(5, 8), lived(3, 2, seed=1)]  # the second one was cut short
    found, about = read(series(soak, shards))
    assert {len(column) for column in found.values()} == {5 * 8 + 3 * 2}
    assert about["columns"].keys() == found.keys()
    assert (np.lexsort((found["time_h"], found["robot"])) == np.arange(46)).all()
    first = 0
    for shard in shards:
        samples, robots = shard.running.shape
        for row in range(robots):
            at = found["robot"] == first + row
            assert at.sum() == samples
            table = {name: column[at] for name, column in found.items()}
            np.testing.assert_array_equal(table.pop("robot"), first + row)
            np.testing.assert_allclose(table.pop("time_h"), np.arange(samples) / 60)
            np.testing.assert_allclose(table.pop("running_h") * 3600 / SPEC.dt, shard.running[:, row])
            for name, own in (("goals_attempted", "attempted"), ("goals_reached", "reached")):
                np.testing.assert_array_equal(table.pop(name), getattr(shard, own)[:, row])
            for name in ("stops", "latches"):
                np.testing.assert_array_equal(table.pop(name), getattr(shard, name)[:, row])
            for k, name in enumerate(NAMES):
                np.testing.assert_array_equal(table.pop(f"events_{name}"), shard.events[:, row, k])
            for j, joint in enumerate(SPEC.joint_names):
                np.testing.assert_array_equal(table.pop(f"winding_{joint}_c"), shard.winding_c[:, row, j])
                np.testing.assert_array_equal(table.pop(f"folded_back_{joint}"), shard.folded_back[:, row, j])
                for k, (title, _, _) in enumerate(WORN):
                    np.testing.assert_array_equal(table.pop(title.format(joint)), shard.worn[:, k, row, j])
            assert not table
        first += robots


def test_file_metadata_identify_the_soak(soak):
    _, about = read(series(soak, [lived(2, 8)]))
    columns = about.pop("columns")
    assert about == {
        "format": 1,
        "seed": 3,
        "robots": 10,
        "hours": 8.0,
        "sample_s": 60.0,
        "robot_digest": SPEC.digest,
        "draws_digest": load_distributions(SPEC).digest,
        "policy_digest": soak.policy.digest,
        "code_digest": code_digest(),
    }
    assert columns["winding_elbow_c"] == {
        "unit": "°C",
        "meaning": "true winding temperature; NaN once the simulation diverged",
    }
    assert columns["events_torque"]["meaning"].startswith("hard events so far, all joints together: ")
    assert columns["events_power"]["meaning"].startswith("soft events")


def test_the_same_shards_give_the_same_bytes(soak):
    shards = [lived(5, 8), lived(5, 2, seed=1)]
    assert len({series(soak, shards) for _ in range(8)}) == 1


@pytest.mark.slow
def test_last_sample_equals_the_judge_counts(arm_policy):
    shard = Shard(job(arm_policy, ticks=600, sample_ticks=200, robots=5))
    shard.runtime.estimator.windings.foldback.current_share[3, 2] = 0.75
    shard.robot.plant.valid[4] = False
    at_tick = {}

    def look(shard):
        if shard.runtime.ticks == 400:
            at_tick[2] = shard.judge.counts()
            shard.robot.plant.housing[2, 1] = 95.0  # latches

    result = shard.run(lambda _: None, lambda: False, observe=look)
    at_tick[3] = result.counts
    for sample, counts in at_tick.items():
        for name in COUNTED:
            np.testing.assert_array_equal(getattr(result, name)[sample], getattr(counts, name))
        np.testing.assert_array_equal(result.events[sample], counts.by_monitor())
        assert result.events[sample].sum(axis=0).tolist() == [counts.total(name) for name in NAMES]
    assert result.latches[3].tolist() == [0, 0, 1, 0, 0]
    assert result.running.shape == (4, 5)
    assert (result.running[0] == 0).all()
    folded = np.zeros((5, N))
    folded[3, 2], folded[4] = 0.25, np.nan
    np.testing.assert_array_equal(result.folded_back[0], folded)


def test_number_of_samples_is_bounded_for_any_duration(soak):
    for hours, every_s in (
        (0.0001, SPEC.dt),
        (0.5, 28.125),
        (2.0, 60.0),
        (8.0, 60.0),
        (24.0, 60.0),
        (48.0, 120.0),
    ):
        found = replace(soak, hours=hours)
        assert found.sample_ticks * SPEC.dt == pytest.approx(every_s, abs=SPEC.dt)
    for hours in (24.0, 25.0, 100.0, 10_000.0):
        found = replace(soak, hours=hours)
        assert SAMPLES_MAX / 2 < found.ticks // found.sample_ticks <= SAMPLES_MAX


def test_totals_of_shards_add_up_and_a_shorter_one_stays_constant():
    long, short = np.arange(8).reshape(4, 2), np.array([[1], [10]])
    assert running_total([long, short]).tolist() == [1 + 1, 5 + 10, 9 + 10, 13 + 10]
    events = np.stack([long, 2 * long], axis=2)
    assert running_total([events]).tolist() == [[1, 2], [5, 10], [9, 18], [13, 26]]
