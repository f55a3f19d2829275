"""Where networks run, and in which precision."""

from typing import Final, Literal, get_args

import torch

from benchmark.errors import InputError

Precision = Literal["float32", "bfloat16"]
PRECISIONS: Final = get_args(Precision)


def device_of(name: str) -> torch.device:
    """A device by name.

    Args:
        name: ``cpu``, ``cuda``, ``cuda:1``; ``auto`` is the first GPU where there is one.

    Returns:
        The device.

    Raises:
        InputError: If there is none of that name.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(f"there is no device {name!r}; use cpu, cuda or auto") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"there is no GPU for device {name!r}; use cpu or auto")
    return device


def require_precision(name: str) -> None:
    """Refuse precisions that networks do not have here.

    Args:
        name: One of `PRECISIONS`.

    Raises:
        InputError: If it is another one.
    """
    if name not in PRECISIONS:
        raise InputError(f"there is no precision {name!r}; use {' or '.join(PRECISIONS)}")
