"""Observation source: a signal that a term of an observation may read, declared once with its reader.

A source belongs to every robot, to a capability, or to a task; a contract may name those that its robot and task have.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from deploy.sources.maximum import Maximum
from robots.arrays import Floats
from robots.capabilities import Capability
from robots.sensors import Kind
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime

Frame = Literal["joint", "world", "base", "sensor", "clock"]
"""joint: about a joint's axis, or of its link relative to the link before. sensor: axes of the sensor's site."""
Sensing = Literal["proprioceptive", "exteroceptive", "none"]
"""proprioceptive: of the robot's own body. exteroceptive: of the world around it. none: task, clock or memory."""
Each = Literal["robot", "joint", "foot"]
GaitLayout = Literal["sin_cos", "cos_sin", "by_leg"]
"""sin_cos: sines of all legs, then their cosines. cos_sin: cosines, then sines. by_leg: sine and cosine of each leg."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationSource:
    """Declaration of one source.

    Attributes:
        frame, unit: of its numbers.
        size: numbers for each robot, joint or foot, as `each` says; those of one joint or foot stand together.
        sensing: proprioceptive, exteroceptive, or none.
        maximum: physical maximum of its numbers, by which a recipe divides them.
        read: (B, count) numbers from the runtime, after this tick's estimate.
        constants: numbers of the nominal robot, computed once, that `read` takes as its second argument; None: it
            takes the runtime alone.
        meaning: what is read, and from which sensors and estimators, in words.
        sensors: kinds of sensors that it needs.
        needs: capabilities that it needs.
        doubt: why a policy had better do without it, in words; empty for most.
    """

    frame: Frame
    unit: str
    size: int = 1
    each: Each = "robot"
    sensing: Sensing
    maximum: Maximum
    read: Callable[..., Floats]
    constants: Callable[[RobotSpec], Any] | None = None
    meaning: str
    sensors: tuple[Kind, ...] = ("encoder",)
    needs: frozenset[Capability] = frozenset()
    doubt: str = ""

    def count(self, spec: RobotSpec) -> int:
        """Return the numbers in one reading of a robot."""
        feet = len(spec.base.feet) if spec.base else 0
        return self.size * {"robot": 1, "joint": spec.n, "foot": feet}[self.each]

    def missing(self, spec: RobotSpec) -> str:
        """Return the capabilities or sensors that a robot lacks for it, in words; empty if it lacks none."""
        if needs := self.needs - spec.capabilities:
            return f"{', '.join(sorted(needs))}; {spec.name} has {_listed(sorted(spec.capabilities))}"
        if kinds := [kind for kind in self.sensors if kind not in spec.sensors]:
            return f"a sensor of kind {' and '.join(kinds)}; {spec.name} has {_listed(spec.sensors)}"
        return ""

    def reader(self, runtime: "Runtime") -> Callable[[], Floats]:
        """Return a function that reads (B, count) numbers of a runtime."""
        if self.constants is None:
            return partial(self.read, runtime)
        return partial(self.read, runtime, self.constants(runtime.spec))


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none of the optional capabilities"
