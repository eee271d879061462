"""Section "heat": winding temperatures of each joint."""

import numpy as np

from eval.report.schema.report_data import Heat
from eval.report.soak_result import SoakResult
from eval.statistics.numbers import median, number, series
from robots.arrays import Ints


def heat(result: SoakResult, at: Ints) -> tuple[Heat, ...]:
    """Return temperatures at samples `at` (S,); the hottest includes the samples in between."""
    hottest = np.fmax.reduceat(np.fmax.reduce(result.winding_c, axis=1), at, axis=0)
    usual, counts = median(result.winding_c[at]), result.counts
    peak = np.nan_to_num(counts.winding_c(), nan=-np.inf)
    above_h = counts.bad_ticks[:, counts.columns("heat_soft")] * counts.dt / 3600
    soft_c, max_c = (counts.limits[counts.columns(name)] for name in ("heat_soft", "heat_hard"))
    folded = np.ma.masked_invalid(result.folded_back).mean(axis=0).filled(0.0)
    return tuple(
        Heat(
            joint=joint,
            soft_c=float(soft_c[k]),
            max_c=float(max_c[k]),
            median_c=series(usual[:, k], 2),
            hottest_c=series(hottest[:, k], 2),
            peak_c=number(peak[:, k].max(), 2),
            hottest_robot=int(peak[:, k].argmax()),
            above_soft_h=float(above_h[:, k].sum()),
            longest_h=float(above_h[:, k].max()),
            longest_robot=int(above_h[:, k].argmax()),
            folded_back=float(folded[:, k].mean()),
            folded_most=float(folded[:, k].max()),
            folded_robot=int(folded[:, k].argmax()),
        )
        for k, joint in enumerate(counts.joints)
    )
