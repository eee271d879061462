"""Table `[[may_touch]]` of robot.toml: contacts that are no collision."""

from typing import Self

from pydantic import model_validator

from robots.strict import Name, Positive, Strict

GOAL = "goal"
"""Name of the task's goal among the bodies that may touch; in simulation a sphere stands there."""
WORLD = "world"
"""Name of the fixed surroundings among the bodies that may touch: all shapes of model.xml outside of bodies."""


class MayTouch(Strict):
    """Two bodies whose contact is no collision, such as feet that brush at every step, or a tool and its goal or table.

    Attributes:
        bodies: of model.xml, or one of them and "goal" or "world".
        force_n: N, limit of the normal force of their contacts; None: that of all contacts.
    """

    bodies: tuple[Name, Name]
    force_n: Positive | None = None

    @model_validator(mode="after")
    def _two(self) -> Self:
        if self.bodies[0] == self.bodies[1]:
            raise ValueError(f"may_touch: found {self.bodies[0]!r} twice in a pair, expected two bodies")
        if set(self.bodies) == {GOAL, WORLD}:
            raise ValueError(f"may_touch: found {list(self.bodies)}, expected at least one body of the robot")
        return self
