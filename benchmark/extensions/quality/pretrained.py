"""Networks of the transformers library that video quality is measured with."""

from pathlib import Path
from typing import Any, Final

import torch

from benchmark.weights.pretrained import Library

_TRANSFORMERS: Final = Library("transformers", extra="quality", needed_by="video quality")


def load_pretrained(name: str, folder: Path, device: torch.device, **settings: Any) -> Any:
    """A network of transformers, in evaluation mode and single precision, or a processor, with the files of a folder.

    Args:
        name: Class of transformers.
        settings: Further arguments of ``from_pretrained``.
    """
    found = _TRANSFORMERS.load(name, folder, **settings)
    return found.to(device) if isinstance(found, torch.nn.Module) else found


def transformers_version() -> str:
    """Version of transformers; raises `InputError` where it is not installed."""
    return _TRANSFORMERS.version()
