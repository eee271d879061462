"""Findings of the check: what was measured of each joint, its bounds, and the probable mistakes."""

from dataclasses import dataclass, field
from typing import NamedTuple

from deploy.commissioning.bounds import Measured


class Quantity(NamedTuple):
    """Measured quantity: its name, the unit that it is shown in, its size in SI units, and what it says if wrong."""

    name: str
    unit: str
    size: float
    wrong: str


QUANTITIES = (
    Quantity("scale", "1", 1.0, "moves {value:.3f} times as far: scale of commands or encoder"),
    Quantity("delay", "ms", 1e-3, "follows its setpoint {value:.1f} ms late, expected at most {high:.1f}"),
    Quantity("age", "ms", 1e-3, "packets are {value:.1f} ms old on arrival, expected at most {high:.1f}"),
    Quantity("friction", "N·m", 1.0, "friction {value:.2f} N·m, expected {low:.2f} to {high:.2f}"),
    Quantity(
        "gravity", "N·m", 1.0, "torque against gravity {value:.2f} N·m, expected {low:.2f} to {high:.2f}"
    ),
    Quantity("tracking", "mrad", 1e-3, "{value:.1f} mrad off its setpoint, expected at most {high:.1f}"),
)
"""Measured in the passes of a joint, in the order of the report."""


@dataclass(slots=True)
class JointFindings:
    """Findings of one joint.

    Attributes:
        order: name of the joint whose encoder answered the nudge; None if none did. sign: of the answer.
        measured: quantities by name, in SI units; empty if the joint made no passes.
        mistakes: in words; empty if the joint passed.
    """

    name: str
    order: str | None = None
    sign: int | None = None
    measured: dict[str, Measured] = field(default_factory=dict)
    mistakes: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """True if all of it was measured and nothing is wrong."""
        return bool(self.measured) and not self.mistakes


@dataclass(slots=True)
class Findings:
    """Findings of the whole check.

    Attributes:
        stopped: reason for which the robot did not arm, stopped before the first joint was to move, or did not come to
            the end of the check; empty if there is none.
        unverified: mistakes that the torques of gravity cannot exclude.
    """

    joints: list[JointFindings]
    stopped: str = ""
    unverified: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """True if every joint passed, and the robot came to the end of the check."""
        return not self.stopped and all(joint.passed for joint in self.joints)
