"""Section "trend": soaks in the order of time, and the pooled results of those with the same identity."""

from collections.abc import Mapping

import numpy as np

from eval.history.history import pool
from eval.history.soak_record import SoakRecord
from eval.report.schema.trend_rows import Estimate, RunGroup, RunRow, Trend
from eval.report.sections.verdict import dispersion_sentence, event_statement
from eval.statistics.dispersion import dispersion_p, draw_rate_interval, draw_rate_upper
from eval.statistics.evidence import rate_upper, share_upper
from eval.statistics.numbers import number
from eval.statistics.per_draw_counts import PerDrawCounts, Ratio, stop_ticks
from robots.errors import printable

THIS_RUN = "this soak"
Identity = dict[str, str]
UNKNOWN = Estimate(value=None, low=None, high=None)


def trend(records: Mapping[str, SoakRecord]) -> Trend:
    """Return the trend of soaks with the same task, given by name in the order of time."""
    groups: dict[frozenset[tuple[str, str]], dict[str, SoakRecord]] = {}
    for name, record in records.items():
        groups.setdefault(frozenset(record.settings.identity.items()), {})[name] = record
    pooled = [_distinct(group) for group in groups.values()]
    draws = sum(record.per_draw_counts.draws for record in records.values())
    identities = [next(iter(group.values())).settings.identity for group in pooled]
    before = [None, *identities]
    number_of = {name: number for number, group in enumerate(groups.values()) for name in group}
    return Trend(
        groups=tuple(_group(each, before[k], identities[k], draws) for k, each in enumerate(pooled)),
        runs=tuple(
            _row(name, record, k := number_of[name], repeated=name not in pooled[k])
            for name, record in records.items()
        ),
    )


def _distinct(records: Mapping[str, SoakRecord]) -> dict[str, SoakRecord]:
    """One record of each seed, the first with the most draws: the draws of the others are among its draws."""
    name_of_seed: dict[int, str] = {}
    for name, record in sorted(records.items(), key=lambda item: -item[1].per_draw_counts.draws):
        name_of_seed.setdefault(record.settings.seed, name)
    kept = set(name_of_seed.values())
    return {name: record for name, record in records.items() if name in kept}


def _row(name: str, record: SoakRecord, group: int, *, repeated: bool) -> RunRow:
    counts = record.per_draw_counts
    events, hours = counts.hard_events
    return RunRow(
        name=printable(name),
        started=record.run.started,
        passed=record.verdict == "passed",
        group=group,
        repeated=repeated,
        seed=record.settings.seed,
        draws=counts.draws,
        running_hours=float(hours.sum()),
        hard_events=int(events.sum()),
        bad_draws=counts.bad_draws,
        rate=_estimate(counts.hard_events, 1.0),
        goals=_share_estimate(counts.goals, 1.0),
        availability=_share_estimate(counts.availability, stop_ticks(counts)),
        hottest_c=_hottest(counts),
    )


def _estimate(ratio: Ratio, lump: float) -> Estimate:
    """Estimate of a rate of amounts that come in lumps, over draws that may differ."""
    amounts, exposure = ratio
    if not exposure.sum() > 0:
        return UNKNOWN
    low, high = draw_rate_interval(amounts / lump, exposure)
    return Estimate(
        value=float(amounts.sum() / exposure.sum()),
        low=number(float(lump * low)),
        high=number(float(lump * high)),
    )


def _share_estimate(ratio: Ratio, lump: float | None) -> Estimate:
    """Estimate of a share from its complement; without an interval if the size of the lumps is unknown."""
    part, whole = ratio
    missing = _estimate((whole - part, whole), lump or 1.0)
    if missing.value is None or missing.low is None or missing.high is None:
        return UNKNOWN
    if lump is None:
        return Estimate(value=1 - missing.value, low=None, high=None)
    return Estimate(value=1 - missing.value, low=max(0.0, 1 - missing.high), high=1 - missing.low)


def _hottest(counts: PerDrawCounts) -> Estimate:
    known = [c for c in counts.hottest_c if c is not None]
    return Estimate(value=max(known), low=float(np.median(known)), high=None) if known else UNKNOWN


def _group(
    records: Mapping[str, SoakRecord], before: Identity | None, identity: Identity, draws: int
) -> RunGroup:
    """Return the pooled figures of a group; `draws` are those of all groups."""
    counts, settings = pool(records), next(iter(records.values())).settings
    events, hours = counts.hard_events
    total, running = int(events.sum()), float(hours.sum())
    p, bad = dispersion_p(events, hours, draws), counts.bad_draws
    rate, draw_rate = number(rate_upper(total, running)), number(draw_rate_upper(events, hours))
    bad_draw_upper = float(share_upper(bad, counts.draws))
    return RunGroup(
        policy=settings.policy,
        policy_digest=settings.policy_digest,
        code_digest=settings.code_digest,
        changed=() if before is None else _changed(before, identity),
        runs=len(records),
        draws=counts.draws,
        running_hours=running,
        hard_events=total,
        rate_upper=rate,
        draw_rate_upper=draw_rate,
        bad_draws=bad,
        bad_draw_upper=bad_draw_upper,
        dispersion_p=p,
        statement=event_statement(
            total,
            running,
            f"{counts.draws:,} draws of {len(records)} soak{'s' if len(records) != 1 else ''}",
            (rate, draw_rate, bad_draw_upper),
            (_quotient(counts.availability), _quotient(counts.goals)),
        ),
        dispersion=dispersion_sentence(p, total, counts.draws),
    )


def _changed(before: Identity, identity: Identity) -> tuple[str, ...]:
    keys = (*identity, *(key for key in before if key not in identity))
    return tuple(key.removesuffix("_digest") for key in keys if before.get(key) != identity.get(key))


def _quotient(ratio: Ratio) -> float:
    amounts, exposure = ratio
    return float(amounts.sum() / max(1.0, exposure.sum()))
