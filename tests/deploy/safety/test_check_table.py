"""Comparison of values with their bounds against numpy."""

import numpy as np
import pytest

from deploy.safety.check import Limits
from deploy.safety.check_table import CheckTable, _compare, find_reasons
from deploy.safety.checks import MOTION
from support.arm6 import SPEC

LOW, HIGH = np.array([-1.0, -np.inf, 0.0]), np.array([1.0, 0.5, np.inf])
REASON, NOT_FINITE = np.array([1, 2, 4]), np.array([8, 16, 32])
VALUES = np.array([-np.inf, -1.0 - 1e-15, -1.0, -0.0, 0.5, 0.5 + 1e-15, 1.0, 1.0 + 1e-15, np.inf, np.nan])


@pytest.mark.parametrize("compare", [_compare, find_reasons])
def test_every_value_outside_of_its_bounds_adds_its_reason(compare):
    values = np.array(np.meshgrid(VALUES, VALUES, VALUES)).reshape(3, -1).T
    inside, found = (values >= LOW) & (values <= HIGH), np.empty(len(values), dtype=np.int64)
    given = np.where(inside, 0, np.where(np.isfinite(values), REASON, NOT_FINITE))
    assert compare(values, LOW, HIGH, REASON, NOT_FINITE, found)
    np.testing.assert_array_equal(found, np.bitwise_or.reduce(given, axis=1))
    within = inside.all(axis=1)
    assert 0 < within.sum() < len(values)
    assert not compare(values[within], LOW, HIGH, REASON, NOT_FINITE, found[: within.sum()])
    assert not found[: within.sum()].any()


def test_values_are_as_many_as_bounds():
    table = CheckTable(1, Limits(SPEC, np.ones(SPEC.n)), MOTION)
    most = len(MOTION) * SPEC.n
    with pytest.raises(
        ValueError, match=rf"^safety checks: found values of shape \(1, 7\), expected {most} in a row$"
    ):
        table.reasons(np.zeros((1, 7)))
