"""How many robots share one call of a library, and who is next."""

BLOCK = 16
"""Robots in one call: enough to share its cost, few enough that what it works with stays in the cache."""


def turns(robots: int) -> list[slice]:
    """Rows of each turn, all of one width.

    The last may repeat robots of the one before: a robot's result depends on nobody, so it is the same again.
    """
    width = -(-robots // -(-robots // BLOCK))
    return [slice(start, start + width) for start in (*range(0, robots - width, width), robots - width)]
