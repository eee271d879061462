"""First sentence of the report, and the sentence on differences between draws."""

from eval.report.schema.numbers import Number, figure
from eval.statistics.evidence import CONFIDENCE


def event_statement(
    events: int,
    hours: float,
    draws: str,
    bounds: tuple[Number, Number, float],
    shares: tuple[float, float],
) -> str:
    """Return the sentence that the counts support: events, bounds of their rate, availability and goals.

    Args:
        events: hard ones. hours: operating time. draws: number of draws in words.
        bounds: of the rate if draws are alike, of the rate if they differ, and of the probability of a bad draw.
        shares: availability, and goals reached ÷ goals due.
    """
    alike, differ, bad_draw = bounds
    bound = "no bound on the rate" if alike is None else f"rate ≤ {figure(alike, 2)} per hour"
    if differ is not None:
        bound += f" (≤ {figure(differ, 2)} where draws differ)"
    availability, goals = (100 * share for share in shares)
    return (
        f"{events:,} hard event{'s' if events != 1 else ''} in {figure(hours)} hours of operating time over {draws}:"
        f" {bound}, P(bad draw) ≤ {bad_draw:.2g} (each with {100 * CONFIDENCE:.0f} % confidence),"
        f" availability {availability:.2f} %, goals reached {goals:.2f} %."
    )


def dispersion_sentence(p: float, events: int, draws: int) -> str:
    """Return what the p-value `p` of equal rates says about differences between draws."""
    if events < 2:
        return "Fewer than two hard events cannot show whether draws differ."
    chance = (
        f"chance alone spreads {events:,} hard events over {draws:,} draws this unevenly"
        f" in {100 * p:.2g} % of cases"
    )
    if p <= 1 - CONFIDENCE:
        return f"Draws differ: {chance}. Only the bound for differing draws is valid."
    return f"Draws were not shown to differ: {chance}. Few events cannot show it, so both bounds are given."
