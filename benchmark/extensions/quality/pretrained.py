"""Networks of the transformers library that video quality is measured with."""

from pathlib import Path
from typing import Any, Final

import torch

from benchmark.weights.pretrained import Library

_TRANSFORMERS: Final = Library("transformers", extra="quality", needed_by="video quality")


def load_pretrained(name: str, folder: Path, device: torch.device, **settings: Any) -> Any:
    """A network or a processor with what a folder holds.

    Args:
        name: Class of transformers.
        folder: Its files.
        device: Where a network runs.
        settings: Further arguments of ``from_pretrained``.

    Returns:
        The network in evaluation mode and single precision, or the processor.

    Raises:
        InputError: If transformers is not installed, or the folder does not hold what the class needs.
    """
    found = _TRANSFORMERS.load(name, folder, **settings)
    return found.to(device) if isinstance(found, torch.nn.Module) else found


def transformers_version() -> str:
    """Version of transformers; raises `InputError` where it is not installed."""
    return _TRANSFORMERS.version()
