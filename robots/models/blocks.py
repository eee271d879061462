"""Blocks: the number of robots that share one call of a library, the rows of each, and one view of their records."""

import numpy as np

from robots.arrays import Floats

BLOCK = 16
"""Robots in one call: enough to share its cost, few enough that its working memory stays in the cache."""
BLOCK_JOINTS = 192
"""Joints in one call, of all of its robots: Pinocchio's memory grows with their cube, here to 0.5 GB."""


def block_rows(robots: int, n: int) -> list[slice]:
    """Return the rows of each block, all of one width, of robots with n joints each.

    The last may repeat robots of the one before: a robot's result depends on no neighbour, so it is the same again.
    """
    most = min(BLOCK, max(1, BLOCK_JOINTS // n))
    width = -(-robots // -(-robots // most))
    return [slice(start, start + width) for start in (*range(0, robots - width, width), robots - width)]


def strided_view(views: list[Floats]) -> Floats:
    """Return one live view (V, ...) of V ≥ 1 views (...) at equal distances in memory: 7 times as fast to read.

    Raises:
        RuntimeError: the distances differ.
    """
    first, address = views[0], [view.ctypes.data for view in views]
    stride = address[1] - address[0] if len(views) > 1 else 0
    if address != [address[0] + stride * place for place in range(len(views))]:
        raise RuntimeError("records of a library are no longer side by side in memory")
    return np.lib.stride_tricks.as_strided(first, (len(views), *first.shape), (stride, *first.strides))
