"""From nights to how they follow each other, and what those of one identity say together."""

from collections.abc import Mapping

import numpy as np

from eval.history.night_record import Night
from eval.report.schema.numbers import figure, number
from eval.report.schema.trend_rows import Group, NightRow, Span, Trend
from eval.statistics.dispersion import dispersion_p, draw_rate_interval, draw_rate_upper
from eval.statistics.evidence import CONFIDENCE, rate_upper, share_upper
from eval.statistics.per_draw_counts import Ratio, Tally, stop_ticks
from eval.statistics.pooling import pool

TONIGHT = "this night"
Identity = dict[str, str]
UNKNOWN = Span(value=None, low=None, high=None)


def trend(nights: Mapping[str, Night]) -> Trend:
    """Of nights of one task, by name, in the order of time."""
    identities: list[Identity] = []
    for night in nights.values():
        if night.settings.identity not in identities:
            identities.append(night.settings.identity)
    alike = [{n: night for n, night in nights.items() if night.settings.identity == i} for i in identities]
    counted = [_distinct(each) for each in alike]
    before = [None, *identities]
    return Trend(
        groups=tuple(_group(each, before[k], identities[k]) for k, each in enumerate(counted)),
        nights=tuple(
            _row(name, night, k := identities.index(night.settings.identity), again=name not in counted[k])
            for name, night in nights.items()
        ),
    )


def _distinct(nights: Mapping[str, Night]) -> dict[str, Night]:
    """Without those whose draws are among those of another: of one seed only the first with the most."""
    of_seed: dict[int, str] = {}
    for name, night in sorted(nights.items(), key=lambda each: -each[1].tally.draws):
        of_seed.setdefault(night.settings.seed, name)
    return {name: night for name, night in nights.items() if name in of_seed.values()}


def _row(name: str, night: Night, group: int, *, again: bool) -> NightRow:
    tally = night.tally
    events, hours = tally.hard_events
    return NightRow(
        name=name,
        started=night.run.started,
        passed=night.verdict == "passed",
        group=group,
        again=again,
        seed=night.settings.seed,
        draws=tally.draws,
        running_hours=float(hours.sum()),
        hard_events=int(events.sum()),
        bad_draws=tally.bad_draws,
        rate=_span(tally.hard_events, 1.0),
        goals=_share(tally.goals, 1.0),
        availability=_share(tally.under_way, stop_ticks(tally)),
        hottest_c=_hottest(tally),
    )


def _span(ratio: Ratio, lump: float) -> Span:
    """Of amounts that come in lumps, over draws that may differ."""
    amounts, exposure = ratio
    if not exposure.sum() > 0:
        return UNKNOWN
    low, high = draw_rate_interval(amounts / lump, exposure)
    return Span(
        value=float(amounts.sum() / exposure.sum()),
        low=number(float(lump * low)),
        high=number(float(lump * high)),
    )


def _share(ratio: Ratio, lump: float | None) -> Span:
    """What is missing from all is bounded; not if nothing says in which lumps it comes."""
    there, whole = ratio
    missing = _span((whole - there, whole), lump or 1.0)
    if missing.value is None or missing.low is None or missing.high is None:
        return UNKNOWN
    if lump is None:
        return Span(value=1 - missing.value, low=None, high=None)
    return Span(value=1 - missing.value, low=max(0.0, 1 - missing.high), high=1 - missing.low)


def _hottest(tally: Tally) -> Span:
    known = [c for c in tally.hottest_c if c is not None]
    return Span(value=max(known), low=float(np.median(known)), high=None) if known else UNKNOWN


def _group(nights: Mapping[str, Night], before: Identity | None, identity: Identity) -> Group:
    tally, settings = pool(nights), next(iter(nights.values())).settings
    events, hours = tally.hard_events
    total, running = int(events.sum()), float(hours.sum())
    p, bad = dispersion_p(events, hours), tally.bad_draws
    group = Group(
        policy=settings.policy,
        policy_digest=settings.policy_digest,
        code_digest=settings.code_digest,
        changed=() if before is None else _changed(before, identity),
        nights=len(nights),
        draws=tally.draws,
        running_hours=running,
        hard_events=total,
        rate_upper=number(float(rate_upper(total, running))),
        draw_rate_upper=number(float(draw_rate_upper(events, hours))),
        bad_draws=bad,
        bad_draw_upper=float(share_upper(bad, tally.draws)),
        dispersion_p=p,
        statement="",
        differ=_differ(total, p),
    )
    return group.model_copy(update={"statement": _statement(group, tally)})


def _changed(before: Identity, identity: Identity) -> tuple[str, ...]:
    keys = (*identity, *(key for key in before if key not in identity))
    return tuple(key.removesuffix("_digest") for key in keys if before.get(key) != identity.get(key))


def _statement(group: Group, tally: Tally) -> str:
    """The sentence that the nights of a group support together."""
    many, alike, differ = group.hard_events, group.rate_upper, group.draw_rate_upper
    bound = "no bound on the rate" if alike is None else f"rate ≤ {figure(alike, 2)} per hour"
    if differ is not None:
        bound += f" (≤ {figure(differ, 2)} where draws differ)"
    return (
        f"{many:,} hard event{'s' if many != 1 else ''} in {figure(group.running_hours)} hours under way over"
        f" {group.draws:,} draws of {group.nights} night{'s' if group.nights != 1 else ''}: {bound}, P(bad draw) ≤"
        f" {group.bad_draw_upper:.2g} (each with {100 * CONFIDENCE:.0f} %), availability {_of_all(tally.under_way)},"
        f" goals reached {_of_all(tally.goals)}."
    )


def _of_all(ratio: Ratio) -> str:
    amounts, exposure = ratio
    return f"{100 * amounts.sum() / max(1.0, exposure.sum()):.2f} %"


def _differ(events: int, p: float) -> str:
    if events < 2:
        return "Whether draws differ cannot be told from fewer than two hard events."
    chance = f"chance alone spreads as many events over them as unevenly in {100 * p:.2g} % of cases"
    if p <= 1 - CONFIDENCE:
        return f"Draws differ: {chance}. Only the bound for draws that differ holds."
    return f"Draws were not shown to differ: {chance}. Few events cannot show it, so both bounds are given."
