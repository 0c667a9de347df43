"""Types of arrays, in one place."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Numbers in double precision. What a docstring says of it begins with its shape."""
AnyArray = NDArray[Any]
"""float64, or complex128 while a derivative is taken by a complex step; numbers of columns too."""
