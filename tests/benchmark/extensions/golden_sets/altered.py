"""Golden sets altered in one place."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Change = Callable[[Any], object]
"""Changes the arrays of an npz file, by name, or the content of a JSON file."""


def load(path: Path) -> dict[str, NDArray[Any]]:
    with np.load(path) as stored:
        return {name: np.array(stored[name], order="C") for name in stored.files}


def altered(whole: Path, to: Path, changes: Sequence[tuple[str, Change]]) -> Path:
    """A copy of a set with some of its files changed."""
    shutil.copytree(whole, to)
    for file, change in changes:
        path = to / file
        content: Any = load(path) if path.suffix == ".npz" else json.loads(path.read_text())
        change(content)
        if path.suffix == ".npz":
            np.savez(path, **content)
        else:
            path.write_text(json.dumps(content))
    return to


def shifted(name: str, by: float = 1, at: int = 0) -> Change:
    """Adds to one number of an array; a verdict is turned round."""

    def change(arrays: dict[str, NDArray[Any]]) -> None:
        flat = arrays[name].reshape(-1)
        flat[at] = ~flat[at] if flat.dtype == np.bool_ else flat[at] + by

    return change


def turned(name: str, row: int = 0, column: int = 0) -> Change:
    """Turns a verdict round, whether it is stored as a truth, a number or a bit."""

    def change(arrays: dict[str, NDArray[Any]]) -> None:
        flat = arrays[name].reshape(len(arrays[name]), -1)[row]
        kind = flat.dtype.kind
        flat[column] = ~flat[column] if kind == "b" else flat[column] ^ 1 if kind == "u" else 1 - flat[column]

    return change


def put(**values: Any) -> Change:
    """Replaces arrays or members; ``None`` leaves one out."""

    def change(content: dict[str, Any]) -> None:
        content |= values
        for name in [name for name, value in values.items() if value is None]:
            del content[name]

    return change


def filled(name: str, value: float) -> Change:
    """Fills an array."""
    return lambda arrays: arrays[name].fill(value)
