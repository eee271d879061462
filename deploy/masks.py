"""`any` and `all` for the tick: of few flags, bytes tell in a tenth of the time that an array's own methods take.

For truth values, and `some` for whole numbers: of any other type the answers are wrong.
"""

import numpy as np
from numpy.typing import NDArray


def some(flags: NDArray[np.bool_] | NDArray[np.integer]) -> bool:
    """Whether any flag is set, or any number not 0."""
    return flags.tobytes() != bytes(flags.nbytes)


def every(flags: NDArray[np.bool_]) -> bool:
    """Whether all flags are set."""
    return 0 not in flags.tobytes()
