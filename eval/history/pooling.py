"""Pooling of soaks: more draws of the same policy, robot, code and settings."""

from collections.abc import Mapping

from eval.history.soak_record import SoakRecord
from eval.statistics.per_draw_counts import PerDrawCounts, concatenate
from robots.errors import ConfigError


def pool(records: Mapping[str, SoakRecord]) -> PerDrawCounts:
    """Return the draws of all soaks.

    Args:
        records: one or more, by the name used in errors, such as their file.

    Raises:
        ConfigError: two soaks have different identities, or the same seed and therefore the same draws.
    """
    (first, reference), *_ = records.items()
    name_of_seed: dict[int, str] = {}
    for name, record in records.items():
        same_identity(reference.settings.identity, record.settings.identity, names=(first, name))
        seed = record.settings.seed
        if seed in name_of_seed:
            raise ConfigError(
                f"{name}: seed: found {seed}, also the seed of {name_of_seed[seed]}:"
                " the same draws are no new evidence"
            )
        name_of_seed[seed] = name
    return concatenate([record.per_draw_counts for record in records.values()])


def same_draws(a: SoakRecord, b: SoakRecord, *, names: tuple[str, str]) -> None:
    """Check that `b` differs from `a` in nothing but the policy; `names` are used in errors.

    Raises:
        ConfigError: the first key, by name, whose values differ.
    """
    a_fixed, b_fixed = (
        {**record.settings.identity, **record.settings.draws, "policy_digest": "any"} for record in (a, b)
    )
    same_identity(a_fixed, b_fixed, names=names)


def same_identity(a: Mapping[str, str], b: Mapping[str, str], *, names: tuple[str, str]) -> None:
    """Check that `a` and `b` have the same keys and values; `names` are used in errors.

    Raises:
        ConfigError: the first key, by name, whose values differ, or that only one of them has.
    """
    for key in sorted(a.keys() | b.keys()):
        if a.get(key) != b.get(key):
            found, expected = b.get(key, "nothing"), a.get(key, "nothing")
            raise ConfigError(f"{names[1]}: {key}: found {found}, but {names[0]} has {expected}")
