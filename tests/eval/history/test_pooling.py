"""Nights are put together only if they are of the same thing, and each draw counts once."""

import pytest
from pydantic import ValidationError

from eval.history.history import check_same_draws, check_same_identity, pool
from eval.statistics.dispersion import draw_rate_upper
from eval.statistics.per_draw_counts import PerDrawCounts, concatenate, stop_ticks
from robots.errors import ConfigError
from support.eval.nights import HOUR, OTHER, SETTINGS, named, night, tallied

IDENTITY = SETTINGS.identity
COLUMNS = ("ticks", "invalid", "running", "stops", "due", "reached")


def test_a_pool_holds_every_draw_of_every_night_once():
    nights = [night(seed, draws=16 * seed) for seed in (1, 2, 3)]
    found = pool(named(*nights))
    assert found.draws == 96
    for name, column in found.model_dump().items():
        if name not in {"dt", "hard"}:
            assert column == sum((getattr(each.per_draw_counts, name) for each in nights), ())
    events, hours = found.hard_events
    assert hours.sum() == pytest.approx(sum(found.running) / HOUR)
    assert events.tolist() == [sum(row) for row in zip(*found.hard.values(), strict=True)]
    assert events.sum() == sum(each.per_draw_counts.hard_events[0].sum() for each in nights) > 20


def test_bad_draws_are_those_with_events_and_those_that_diverged():
    quiet = tallied(1, rate=0.0)
    assert quiet.bad_draws == 0
    events = quiet.hard | {"jerk": (0, 3, *(0,) * 14), "torque": (0, 1, 1, *(0,) * 13)}
    odd = quiet.model_copy(update={"hard": events, "invalid": (0,) * 14 + (5, 0)})
    assert odd.bad_draws == 3
    assert concatenate([odd, quiet, odd]).bad_draws == 6


def test_a_stop_weighs_twice_its_mean_length():
    one, two = tallied(1), tallied(2)
    assert stop_ticks(one) == stop_ticks(one, two) == 24_000
    still = one.model_copy(update={"stops": (0,) * 16, "running": one.ticks})
    assert stop_ticks(still) is None


def test_more_nights_narrow_the_bounds():
    nights = named(*(night(seed) for seed in range(8)))
    few, many = (pool(dict(list(nights.items())[:k])).hard_events for k in (2, 8))
    assert (
        draw_rate_upper(*many) - many[0].sum() / many[1].sum()
        < draw_rate_upper(*few) - few[0].sum() / few[1].sum()
    )


@pytest.mark.parametrize("key", IDENTITY)
def test_another_identity_is_refused_by_its_key_and_both_values(key):
    odd = night(3, **OTHER[key])
    found = odd.settings.identity[key]
    with pytest.raises(ConfigError) as caught:
        pool(named(night(1), night(2), odd))
    assert str(caught.value) == f"night-2.json: {key}: found {found}, but night-0.json has {IDENTITY[key]}"


def test_key_missing_on_one_side_is_refused():
    more = IDENTITY | {"mujoco": "4.0"}
    with pytest.raises(ConfigError, match=r"^b: mujoco: found 4\.0, but a has nothing$"):
        check_same_identity(IDENTITY, more, names=("a", "b"))
    with pytest.raises(ConfigError, match=r"^b: mujoco: found nothing, but a has 4\.0$"):
        check_same_identity(more, IDENTITY, names=("a", "b"))


def test_equal_draws_count_once():
    with pytest.raises(ConfigError, match=r"^night-2\.json: seed: found 1, also the seed of night-0\.json"):
        pool(named(night(1), night(2), night(1)))


def test_different_policy_or_budget_has_the_same_draws():
    check_same_draws(
        night(1), night(1, policy_digest="z9", policy="b.onnx", budget="b", workers=7), names=("a", "b")
    )


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        *((key, OTHER[key]) for key in IDENTITY if key != "policy_digest"),
        ("seed", {"seed": 2}),
        ("robots", {"draws": 32}),
    ],
)
def test_any_other_difference_has_other_draws(key, changes):
    with pytest.raises(ConfigError, match=rf"^b: {key}: found .*, but a has "):
        check_same_draws(night(), night(**changes), names=("a", "b"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"due": (1,) * 15}, "due: found 15 numbers, expected 16"),
        ({"hottest_c": ()}, "hottest_c: found 0 numbers, expected 16"),
        ({"hard": {}}, "hard: found no monitor"),
        ({"hard": {"torque": (0,)}}, "hard.torque: found 1 numbers, expected 16"),
        ({"dt": 1e300}, "less than or equal to 1"),
        (
            dict.fromkeys((*COLUMNS, "hottest_c"), ()) | {"hard": {"torque": ()}},
            "ticks: found 0 numbers, expected 1",
        ),
    ],
)
def test_counts_that_no_soak_has_are_refused(changes, said):
    with pytest.raises(ValidationError, match=said):
        PerDrawCounts(**{**tallied(1).model_dump(), **changes})


def test_soaks_with_other_monitors_are_not_pooled():
    first, second = night(1), night(2)
    fewer = {"torque": second.per_draw_counts.hard["torque"]}
    counts = second.per_draw_counts.model_copy(update={"hard": fewer})
    with pytest.raises(ConfigError, match=r"b\.json: hard: found torque, but a\.json has "):
        pool({"a.json": first, "b.json": second.model_copy(update={"per_draw_counts": counts})})
