"""Nights put together: more draws of the same thing, and only of the same thing."""

from collections.abc import Mapping

from eval.history.night_record import Night
from eval.statistics.per_draw_counts import Tally, together
from robots.errors import ConfigError


def pool(nights: Mapping[str, Night]) -> Tally:
    """The draws of all nights.

    Args:
        nights: one or more, by the name that errors call them, such as their file.

    Raises:
        ConfigError: the nights are not of the same thing, or two of them are of the same draws.
    """
    (first, one), *_ = nights.items()
    of_seed: dict[int, str] = {}
    for name, night in nights.items():
        same_identity(one.settings.identity, night.settings.identity, names=(first, name))
        seed = night.settings.seed
        if seed in of_seed:
            raise ConfigError(
                f"{name}: seed: found {seed}, which is that of {of_seed[seed]}:"
                " the same draws again are no new evidence"
            )
        of_seed[seed] = name
    return together([night.tally for night in nights.values()])


def same_draws(a: Night, b: Night, *, names: tuple[str, str]) -> None:
    """Refuse `b` beside `a`, called `names`, if anything but the policy differs.

    Raises:
        ConfigError: the first key, by name, whose values differ.
    """
    fixed = [{**night.settings.identity, **_drawn(night), "policy_digest": "any"} for night in (a, b)]
    same_identity(*fixed, names=names)


def _drawn(night: Night) -> dict[str, str]:
    return {"seed": str(night.settings.seed), "robots": str(night.settings.robots)}


def same_identity(a: Mapping[str, str], b: Mapping[str, str], *, names: tuple[str, str]) -> None:
    """Refuse `b` beside `a`, called `names`, unless each value is the same.

    Raises:
        ConfigError: the first key, by name, whose values differ, or that only one of them has.
    """
    for key in sorted(a.keys() | b.keys()):
        if a.get(key) != b.get(key):
            found, expected = b.get(key, "nothing"), a.get(key, "nothing")
            raise ConfigError(f"{names[1]}: {key}: found {found}, but {names[0]} has {expected}")
