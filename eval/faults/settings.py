"""Settings of scheduled faults, from a profile's table [faults]."""

from typing import Annotated

from pydantic import Field

from robots.strict import Strict

HOURS_MAX = 10_000.0
"""Upper bound of the simulated hours of a robot."""
LEAST_CYCLE_S = 18.0
"""s that the longest fault, the operator's delay and a restart take at least."""


class FaultSettings(Strict):
    """Timing of fault injection: each robot gets one fault of every class in turn, in an order of its own.

    Attributes:
        coverage: required share of handled injections in each class, to be shown with 95 % confidence.
        cycle_s: s from one fault of a robot to its next.
        operator_s: s until a robot without power is armed again; shorter than without faults.
    """

    coverage: Annotated[float, Field(gt=0, lt=1)]
    cycle_s: Annotated[float, Field(ge=LEAST_CYCLE_S)]
    operator_s: Annotated[float, Field(ge=0, le=LEAST_CYCLE_S)]
