"""Values of settings, from text."""

from enum import StrEnum
from typing import Any

import numpy as np

from benchmark.errors import InputError


def parsed(name: str, text: str, kind: type) -> Any:
    """A value of the type that a hyper-parameter has: a switch, a finite number or a `StrEnum`."""
    if kind is bool:
        if text not in ("true", "false"):
            raise InputError(f"hyper-parameter {name} is a switch, true or false, not {text!r}")
        return text == "true"
    try:
        value = kind(text)
    except ValueError as error:
        choices = f"one of {', '.join(kind)}" if issubclass(kind, StrEnum) else f"a number ({kind.__name__})"
        raise InputError(f"hyper-parameter {name} must be {choices}, not {text!r}") from error
    if isinstance(value, float) and not np.isfinite(value):
        raise InputError(f"hyper-parameter {name} must be finite, not {text!r}")
    return value
