"""The shape that every stage of the tick shares."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]


class Stage:
    """A frozen config plus arrays (B, ...): the arrays can be saved, restored and reset by robot.

    A subclass names the arrays that carry over from tick to tick in `carried`; they are allocated once,
    always have the robots first, and are written in place. Stages inside are named in `parts`.
    """

    carried: ClassVar[tuple[str, ...]] = ()
    parts: ClassVar[tuple[str, ...]] = ()

    def save(self) -> Arrays:
        """Copies of every carried array; those of a part are named "part.array"."""
        own: Arrays = {name: getattr(self, name).copy() for name in self.carried}
        for part in self.parts:
            own |= {f"{part}.{name}": array for name, array in getattr(self, part).save().items()}
        return own

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        for name in self.carried:
            getattr(self, name)[...] = arrays[name]
        for part in self.parts:
            getattr(self, part).restore(inside(arrays, part))


def inside(arrays: Mapping[str, NDArray[np.generic]], part: str) -> Arrays:
    """The arrays of one part among those that were saved, as it names them itself."""
    return {n.removeprefix(f"{part}."): array for n, array in arrays.items() if n.startswith(f"{part}.")}
