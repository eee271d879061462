"""How many robots share one call of a library, who is next, and how to read what it holds of all of them."""

import numpy as np
from numpy.typing import NDArray

BLOCK = 16
"""Robots in one call: enough to share its cost, few enough that what it works with stays in the cache."""


def turns(robots: int) -> list[slice]:
    """Rows of each turn, all of one width.

    The last may repeat robots of the one before: a robot's result depends on nobody, so it is the same again.
    """
    width = -(-robots // -(-robots // BLOCK))
    return [slice(start, start + width) for start in (*range(0, robots - width, width), robots - width)]


def lined_up(views: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """One live view (V, ...) of V ≥ 1 views (...) that lie at equal distances, read in a seventh of their time.

    Raises:
        RuntimeError: they do not.
    """
    first, address = views[0], [view.ctypes.data for view in views]
    stride = address[1] - address[0] if len(views) > 1 else 0
    if address != [address[0] + stride * place for place in range(len(views))]:
        raise RuntimeError("a library does not keep its records side by side any more")
    return np.lib.stride_tricks.as_strided(first, (len(views), *first.shape), (stride, *first.strides))
