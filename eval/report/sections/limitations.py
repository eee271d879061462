"""Section "limitations": limitations of the results that follow from the counts."""

from collections.abc import Iterator

import numpy as np

from eval.judge.counts import Counts
from eval.report.schema.rows import Evidence

LOAD_USED = 0.5
"""Monitors whose limit no robot used to this share are listed."""


def limitations(counts: Counts, evidence: Evidence) -> Iterator[str]:
    """Yield sentences on what the counts cannot show."""
    yield (
        f"Other robots: with {evidence.bad_draws} of {counts.robots} draws bad, up to"
        f" {100 * evidence.bad_draw_upper:.0f} % of all possible draws may be bad. More draws lower this bound, more"
        " hours do not."
    )
    yield f"Changes between two control ticks: the judge samples every {1e3 * counts.dt:g} ms."
    unjudged = [m.name for m in counts.monitors if np.isinf(counts.limits[counts.columns(m.name)]).any()]
    if unjudged:
        yield (
            f"Monitors without a known limit: {', '.join(unjudged)}. The policy file does not contain the statistics"
            " of its training data."
        )
    unused = [name for name in _unused_monitors(counts) if name not in unjudged]
    if unused:
        yield (f"Behaviour near limits that no robot used to {100 * LOAD_USED:.0f} %: {', '.join(unused)}.")
    if counts.invalid.any():
        yield (
            f"{counts.invalid.sum()} ticks of the {np.count_nonzero(counts.invalid)} robots whose simulation"
            " diverged: they were not judged."
        )


def _unused_monitors(counts: Counts) -> Iterator[str]:
    for monitor in counts.monitors:
        if monitor.unit and counts.worst[:, counts.columns(monitor.name)].max(initial=0.0) < LOAD_USED:
            yield monitor.name
