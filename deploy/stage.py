"""The shape that every stage of the tick shares."""

from collections.abc import Mapping
from operator import attrgetter
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]


class Stage:
    """A frozen config plus arrays (B, ...): the arrays can be saved, restored and reset by robot.

    A subclass names the arrays that carry over from tick to tick in `carried`; they are allocated once,
    always have the robots first, and are written in place. A name may lead into a stage inside: "heat.winding".
    """

    carried: ClassVar[tuple[str, ...]] = ()

    def save(self) -> Arrays:
        """Copies of every carried array."""
        return {name: attrgetter(name)(self).copy() for name in self.carried}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        for name in self.carried:
            attrgetter(name)(self)[...] = arrays[name]
