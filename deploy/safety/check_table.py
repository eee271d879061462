"""Safety checks compared with their bounds for all robots at once."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np

from deploy.reasons import Reason
from deploy.safety.check import Bound, Check, Limits
from robots.arrays import Bools, Floats, Ints
from robots.kernel import FLOAT, INT, array, kernel
from robots.spec import RobotSpec


class CheckTable:
    """Checks of R rows, each with its own columns in arrays (R, C) of values and bounds.

    Attributes:
        checks: those that the robot has.
    """

    def __init__(self, rows: int, limits: Limits, *groups: Sequence[Check[Any]]) -> None:
        """Compute the bounds of those checks whose needs the robot meets.

        Args:
            rows: R.
            limits: data from which bounds are computed.
            groups: checks that read one record each.

        Raises:
            ValueError: two checks of one name, or a bound of the wrong shape.
        """
        self._rows, self._n, self._verified = rows, limits.robot.n, False
        chosen = _chosen(groups, limits.robot)
        self._readers = [(group, check.value) for group, check in chosen]
        self.checks = [check for _, check in chosen]
        self._widths = [self._n if check.per_joint else 1 for check in self.checks]
        self._low, self._high = self._bounds("low", limits), self._bounds("high", limits)
        self._reason, self._reason_not_finite = (
            np.concatenate([np.empty(0, np.int64), *self._columns(field)])
            for field in ("reason", "reason_not_finite")
        )

    def _columns(self, field: str) -> list[Ints]:
        numbers = [int(getattr(check, field)) for check in self.checks]
        return [np.full(width, number) for width, number in zip(self._widths, numbers, strict=True)]

    def _bounds(self, field: str, limits: Limits) -> Floats:
        bounds = []
        for check, width in zip(self.checks, self._widths, strict=True):
            bound: Bound = getattr(check, field)
            value = np.asarray(bound(limits) if callable(bound) else bound, dtype=float)
            if value.shape not in {(), (width,)}:
                raise ValueError(
                    f"safety check {check.name}: {field}: found shape {value.shape}, expected a number or ({width},)"
                )
            bounds.append(np.broadcast_to(value, width))
        return np.concatenate([np.empty(0), *bounds])

    def values(self, *records: Any) -> Floats:
        """Return (R, C) values, one record for each group.

        Raises:
            ValueError: at first use, a check whose value has the wrong shape.
        """
        columns = [read(records[group]) for group, read in self._readers]
        if not self._verified:
            self._verify([column.shape for column in columns])
        return np.concatenate(columns, axis=1)

    def _verify(self, shapes: list[tuple[int, ...]]) -> None:
        for check, width, found in zip(self.checks, self._widths, shapes, strict=True):
            if found != (self._rows, width):
                raise ValueError(
                    f"safety check {check.name}: value: found shape {found}, expected {(self._rows, width)}"
                )
        self._verified = True

    def reasons(self, values: Floats) -> Ints | None:
        """Return (R,) bit sets of `Reason`; None where every value of every row is inside its bounds.

        Raises:
            ValueError: there is not one value for each bound.
        """
        if values.shape[1:] != self._low.shape:
            raise ValueError(
                f"safety checks: found values of shape {values.shape}, expected {len(self._low)} in a row"
            )
        found = np.empty(len(values), dtype=np.int64)
        numbers = self._low, self._high, self._reason, self._reason_not_finite
        return found if _compare(values, *numbers, found) else None

    def failed(self, values: Floats, reason: Reason) -> dict[str, Bools]:
        """Return the checks that give a reason for one row of values (C,): by name, (n,) joints that it is about.

        No joint is meant by a check of the robot as a whole. A joint angle that is not finite leaves no finite torque:
        torques do not count for `Reason.NOT_FINITE`.
        """
        inside = (values >= self._low) & (values <= self._high)
        if reason is Reason.NOT_FINITE:
            inside |= self._reason == Reason.TORQUE
        given = np.where(np.isfinite(values), self._reason, self._reason_not_finite)
        found = ~inside & (given & int(reason) != 0)
        columns = np.split(found, np.cumsum(self._widths, dtype=np.int64))[:-1]
        return {
            check.name: column if check.per_joint else np.zeros(self._n, dtype=bool)
            for check, column in zip(self.checks, columns, strict=True)
            if column.any()
        }


def _chosen(groups: Sequence[Sequence[Check[Any]]], robot: RobotSpec) -> list[tuple[int, Check[Any]]]:
    """Return the checks whose needs the robot meets, each with the number of its group."""
    has = robot.capabilities
    chosen = [(group, check) for group, checks in enumerate(groups) for check in checks if check.needs <= has]
    names = [check.name for _, check in chosen]
    if len(set(names)) < len(names):
        raise ValueError(f"safety checks: found the names {', '.join(names)}, expected each once")
    return chosen


def find_reasons(
    values: Floats, low: Floats, high: Floats, reason: Ints, reason_not_finite: Ints, found: Ints
) -> bool:
    """Find (R,) bit sets of `Reason` against values (R, C) outside of their bounds; return False where none is.

    Args:
        values: (R, C). low, high: (C,) their bounds.
        reason: (C,), of a value outside of its bounds. reason_not_finite: (C,), of one that is not finite.
        found: (R,) the result.
    """
    refused = False
    for row in range(len(values)):
        found[row] = 0
        for column in range(len(low)):
            value = values[row, column]
            if low[column] <= value <= high[column]:
                continue
            found[row] |= reason[column] if isfinite(value) else reason_not_finite[column]
            refused = True
    return refused


# Not a decorator: mutation tests leave decorated functions out.
_compare = kernel(
    *(array(FLOAT, 2), array(FLOAT, 1), array(FLOAT, 1)),
    *(array(INT, 1), array(INT, 1), array(INT, 1, written=True)),
)(find_reasons)
