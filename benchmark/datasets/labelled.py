"""At which key frames of a scene objects were looked for: absence of annotations is not absence of objects.

A scene without a single annotation was never labelled. In one that has some, a stretch of key frames without any is
taken as not labelled if `LEAVE_TOGETHER` objects or more are annotated at the key frame before it or after it: traffic
thins out one by one, while labels that end, or begin, half-way do so for all objects at once.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools

LEAVE_TOGETHER: Final = 3


def labelled_keyframes(boxes: NDArray[np.int64]) -> Bools:
    """Which key frames were labelled, (K,), from the (K,) numbers of annotations of a scene in time order."""
    if not boxes.any():
        return np.zeros(len(boxes), np.bool_)
    there = np.flatnonzero(boxes)
    at = np.arange(len(boxes))
    before = there[np.maximum(np.searchsorted(there, at, side="right") - 1, 0)]
    after = there[np.minimum(np.searchsorted(there, at), len(there) - 1)]
    return np.asarray((boxes > 0) | (np.maximum(boxes[before], boxes[after]) < LEAVE_TOGETHER))
