"""Array types by element: the shape of each array is in the docstring of what holds it."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
