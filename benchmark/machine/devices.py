"""Where networks run, and in which precision."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal, get_args

import torch

from benchmark.errors import InputError

Precision = Literal["float32", "bfloat16"]
PRECISIONS: Final = get_args(Precision)


def select_device(name: str) -> torch.device:
    """Device by name: ``cpu``, ``cuda``, ``cuda:1``; ``auto`` is the first GPU where there is one."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(f"unknown device {name!r}; use cpu, cuda or auto") from error
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise InputError(f"no GPU found for device {name!r}; use cpu or auto")
    return device


def select_worker_device(name: str, number: int) -> torch.device:
    """The device of a worker, numbered from 0: with ``cuda``, which has no number, one GPU after the other."""
    device = select_device(name)
    if device.type != "cuda" or device.index is not None:
        return device
    return torch.device("cuda", number % torch.cuda.device_count())


def require_precision(name: str) -> None:
    """Refuse precisions, other than `PRECISIONS`, that networks do not have here."""
    if name not in PRECISIONS:
        raise InputError(f"unknown precision {name!r}; use {' or '.join(PRECISIONS)}")


@contextmanager
def single_precision() -> Iterator[None]:
    """No shortcuts of graphics cards in products and convolutions: PyTorch lets them round to 10 bits by default."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            yield
    finally:
        torch.set_float32_matmul_precision(before)
