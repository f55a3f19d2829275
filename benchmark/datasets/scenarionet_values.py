"""Values of ScenarioNet files as what they should be; a stranger's may be of any type."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.untrusted.files import one_line

FARTHEST_M: Final = 1e8
"""More than any projected map coordinate."""
_LONGEST_NAME: Final = 256


def real_numbers(value: Any) -> Floats:
    """Numbers, in an array or a list of any shape, as an array in double precision.

    Raises:
        ValueError: If it is no rectangular array of real numbers.
    """
    try:
        found = np.asarray(value)
        if found.dtype.kind not in "biufO":
            raise ValueError(f"{found.dtype} is no type of numbers")
        return np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(one_line(error, 80)) from error


def name_of(value: Any, what: str, path: Path) -> str:
    """A name or whole number of a file as text; ``what`` and ``path`` are for the message.

    Raises:
        InputError: If it is neither text nor a whole number, longer than any name, or cannot be printed.
    """
    text = str(value) if isinstance(value, str | int | np.integer) else ""
    if len(text) > _LONGEST_NAME or not text.isprintable() or (not text and not isinstance(value, str)):
        raise InputError(f"{path}: {what} must be a name, it is {one_line(repr(value), 60)}; fetch the file again")
    return text
