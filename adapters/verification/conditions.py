"""What every comparison of a network needs: the folders of its sets, and arithmetic without shortcuts."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch


@contextmanager
def single_precision() -> Iterator[None]:
    """No shortcuts of graphics cards in products and convolutions."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            yield
    finally:
        torch.set_float32_matmul_precision(before)


def set_folders(golden: Path) -> list[Path]:
    """Where the sets are that a golden directory holds.

    Args:
        golden: A set's folder, or a model's folder with sets in it.

    Returns:
        The folder itself, or those in it that hold a set; itself too where there is none, so that its reader says what
        is missing.
    """
    if (golden / "manifest.json").exists() or not golden.is_dir():
        return [golden]
    return sorted(path.parent for path in golden.glob("*/manifest.json")) or [golden]
