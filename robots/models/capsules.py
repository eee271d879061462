"""Capsules that are too near to each other, in scalar code; coal is the oracle of the tests.

A capsule is all that is nearer than its radius to a segment. Of two segments c + s u, |s| ≤ a and d + t v, |t| ≤ b,
with unit vectors u and v and r = c − d, the nearest points are at

    s = (u·v v·r − u·r) / (1 − (u·v)²),  then  t = v·r + u·v s,  then  s = u·v t − u·r

each limited to its segment. Parallel ones begin with s = 0.

Source: Ericson, Real-Time Collision Detection (2005), sec. 5.1.9.
"""

from math import isfinite

from robots.arrays import Bools, Floats, Ints
from robots.kernel import BOOL, FLOAT, INT, array, inlined, kernel

PARALLEL = 1e-12
"""Squared sine of the angle below which segments are parallel: their ends are then within 1 µm for each metre."""


@inlined
def _dot(a: Floats, i: int, b: Floats, j: int) -> float:
    return a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]  # type: ignore[no-any-return]


@inlined
def _limited(x: float, most: float) -> float:
    return min(max(x, -most), most)


@inlined
def _distance_squared(
    r: tuple[float, float, float], axis: Floats, half: Floats, i: int, j: int, first: int
) -> float:
    """Return m² between two segments of a robot.

    Args:
        r: m, from the middle of segment j to that of segment i. axis, half: as of `find_near`.
        i, j: shapes. first: row of the robot's first shape.
    """
    u, v = first + i, first + j
    cosine = _dot(axis, u, axis, v)
    u_r = axis[u, 0] * r[0] + axis[u, 1] * r[1] + axis[u, 2] * r[2]
    v_r = axis[v, 0] * r[0] + axis[v, 1] * r[1] + axis[v, 2] * r[2]
    sine_squared = 1.0 - cosine * cosine
    s = _limited((cosine * v_r - u_r) / sine_squared, half[i]) if sine_squared > PARALLEL else 0.0
    t = _limited(v_r + cosine * s, half[j])
    s = _limited(cosine * t - u_r, half[i])
    squared = 0.0
    for k in range(3):
        squared += (r[k] + s * axis[u, k] - t * axis[v, k]) ** 2
    return squared


@kernel(
    *(array(FLOAT, 2), array(FLOAT, 2), array(FLOAT, 1)),
    *(array(INT, 2), array(FLOAT, 1), array(BOOL, 1, written=True)),
)
def find_near(centre: Floats, axis: Floats, half: Floats, pairs: Ints, reach: Floats, near: Bools) -> None:
    """Find robots with a pair of capsules whose segments are not farther from each other than their reach.

    Args:
        centre: (C S, 3) m, middles of the S shapes of C robots. axis: (C S, 3) unit vectors along them.
        half: (S,) m, half of the length of each segment.
        pairs: (P, 2) shapes. reach: (P,) m.
        near: (C,) the result; of a place that is not finite, too.
    """
    for robot in range(len(near)):
        first, near[robot] = robot * len(half), False
        for pair in range(len(pairs)):
            i, j = pairs[pair]
            a, b = first + i, first + j
            r = centre[a, 0] - centre[b, 0], centre[a, 1] - centre[b, 1], centre[a, 2] - centre[b, 2]
            apart = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            if isfinite(apart) and apart > (half[i] + half[j] + reach[pair]) ** 2:
                continue
            if not _distance_squared(r, axis, half, i, j, first) > reach[pair] ** 2:
                near[robot] = True
                break


@kernel(array(FLOAT, 1), array(FLOAT, 1), array(FLOAT, 1), array(FLOAT, 1))
def all_above(height: Floats, steepness: Floats, half: Floats, above: Floats) -> bool:
    """Return True if the lower ends of all segments are above a height.

    Args:
        height: (C S,) m, of middles. steepness: (C S,) vertical parts of the unit vectors along segments.
        half: (S,) m. above: (S,) m; −inf for shapes that may be anywhere.
    """
    for row in range(len(height)):
        shape = row % len(half)
        if not height[row] - abs(steepness[row]) * half[shape] > above[shape]:
            return False
    return True
