"""Where the sets are that networks are compared with."""

from pathlib import Path


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
