"""Stage: base class of everything in a tick that carries state."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]


class Stage:
    """Frozen configuration plus arrays (B, ...) that can be saved, restored and reset for a subset of robots.

    A subclass names the arrays that carry over from tick to tick in `carried`: they are allocated once, have the robots
    as leading axis, and are written in place. Attributes that are stages themselves are named in `parts`.
    """

    carried: ClassVar[tuple[str, ...]] = ()
    parts: ClassVar[tuple[str, ...]] = ()

    def stages(self) -> dict[str, "Stage"]:
        """Stages inside, by name."""
        return {part: getattr(self, part) for part in self.parts}

    def save(self) -> Arrays:
        """Copies of every carried array; those of a stage inside are named "stage.array"."""
        own: Arrays = {name: getattr(self, name).copy() for name in self.carried}
        for part, stage in self.stages().items():
            own |= {f"{part}.{name}": array for name, array in stage.save().items()}
        return own

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        for name in self.carried:
            getattr(self, name)[...] = arrays[name]
        for part, stage in self.stages().items():
            stage.restore(inside(arrays, part))


def inside(arrays: Mapping[str, NDArray[np.generic]], part: str) -> Arrays:
    """Return the arrays of one stage inside, under the names that it uses itself."""
    return {n.removeprefix(f"{part}."): array for n, array in arrays.items() if n.startswith(f"{part}.")}
