import numpy as np
import pytest

from support.eval.shards import M, N, lived
from support.eval.soaks import soak_config

pytest.importorskip("mujoco")

from dataclasses import replace

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from eval.judge.monitors import NAMES
from eval.soak.tensorboard import POINTS, TENSORBOARD, event_file, intervals

STARTED, BEGUN = "2026-01-01T01:00:00+01:00", 1767225600.0


@pytest.fixture
def soak(arm_policy):
    return soak_config(arm_policy, hours=8.0, robots=10)


def read(data, folder):
    """By TensorBoard's own reader: values by tag, each with its wall time and step."""
    folder.mkdir(exist_ok=True)
    (folder / TENSORBOARD.split("/")[-1]).write_bytes(data)
    accumulator = EventAccumulator(str(folder), size_guidance={"scalars": 0})
    accumulator.Reload()
    return {tag: accumulator.Scalars(tag) for tag in accumulator.Tags()["scalars"]}


def steady(samples, robots, hard, soft):
    """A shard that does the same between any two samples, and is one degree warmer after each."""
    at = np.arange(samples)[:, None] * np.ones((1, robots), dtype=np.int64)
    events = np.zeros((samples, robots, M), dtype=np.int64)
    events[..., NAMES.index("jerk")] = hard * at
    events[..., NAMES.index("tracking")] = soft * at
    return replace(
        lived(samples, robots),
        attempted=4 * at,
        reached=3 * at,
        running=6000 * at,
        stops=2 * at,
        events=events,
        winding_c=20.0 + at[..., None] * np.ones(N),
        folded_back=np.full((samples, robots, N), 0.25),
    )


def test_rates_and_shares_are_those_of_each_stretch(soak, tmp_path):
    """8 h: 480 samples of 12000 ticks, half of them under way; the second shard ends in the midst."""
    shards = [steady(481, 8, hard=1, soft=3), steady(241, 2, hard=5, soft=0)]
    shards[0].winding_c[100, 3, 2], shards[1].folded_back[:, 0, 1], shards[0].winding_c[200:, 0] = (
        150.0,
        0.75,
        np.nan,
    )
    found = read(event_file(soak, shards, STARTED), tmp_path)
    hottest = found["heat/hottest_winding_c"]
    assert [point.step for point in hottest] == [480 * k for k in range(1, 61)]
    np.testing.assert_allclose([point.wall_time - BEGUN for point in hottest], [p.step for p in hottest])
    expected = [150.0 if k == 13 else 20.0 + 8 * k for k in range(1, 61)]
    assert [point.value for point in hottest] == pytest.approx(expected)
    both, alone = slice(0, 30), slice(30, 60)

    def values(tag, part):
        return np.array([point.value for point in found[tag]])[part]

    half_hour = 1 / 120  # h under way of a robot between two samples
    for tag, first, then in (
        ("violations_per_hour_hard/jerk", (8 + 10) / 10, 1.0),
        ("violations_per_hour_hard/all", (8 + 10) / 10, 1.0),
        ("violations_per_hour_hard/velocity", 0.0, 0.0),
        ("violations_per_hour_soft/tracking", 24 / 10, 3.0),
        ("violations_per_hour_soft/all", 24 / 10, 3.0),
        ("work/stops_per_hour", 2.0, 2.0),
    ):
        np.testing.assert_allclose(values(tag, both), first / half_hour, rtol=1e-6)
        np.testing.assert_allclose(values(tag, alone), then / half_hour, rtol=1e-6)
    for tag, expected in (("work/availability", 0.5), ("work/goals_reached_share", 0.75)):
        np.testing.assert_allclose(values(tag, slice(None)), expected)
    np.testing.assert_allclose(values("heat/folded_back_most", both), 0.75)
    np.testing.assert_allclose(values("heat/folded_back_most", alone), 0.25)
    np.testing.assert_allclose(values("heat/folded_back_mean", both), 0.25 + 0.5 / (10 * N), rtol=1e-6)


def test_nan_is_omitted(soak, tmp_path):
    shard = steady(3, 2, hard=1, soft=1)
    shard.running[:], shard.attempted[:] = 0, 0
    shard.winding_c[:], shard.folded_back[:] = np.nan, np.nan
    found = read(event_file(replace(soak, robots=2), [shard], STARTED), tmp_path)
    assert {tag: [p.value for p in points] for tag, points in found.items()} == {
        "work/availability": [0.0, 0.0]
    }


def test_empty_soak_gives_a_file_without_points(soak, tmp_path):
    assert read(event_file(soak, [steady(1, 8, 1, 1)], STARTED), tmp_path) == {}


@pytest.mark.parametrize("samples", [1, 5, 63, 64, 65, 480, 1440])
@pytest.mark.parametrize("sample_s", [0.005, 0.3, 1.0, 60.0])
def test_stretches_are_few_and_no_two_end_in_the_same_second(samples, sample_s):
    edges = intervals(samples, sample_s)
    assert (edges[0], edges[-1]) == (0, samples)
    assert len(edges) - 1 <= POINTS
    seconds = [int(edge * sample_s + 1e-9) for edge in edges[1:]]
    assert len(set(seconds)) == len(seconds)


def test_later_soak_replaces_an_earlier_one(soak, tmp_path):
    for hard in (1, 2):
        found = read(event_file(soak, [steady(481, 8, hard, 0)], STARTED), tmp_path)
    assert len(found["violations_per_hour_hard/jerk"]) == 60
    assert found["violations_per_hour_hard/jerk"][0].value == pytest.approx(2 * 120)
    assert len(list(tmp_path.iterdir())) == 1
