"""Reading golden sets: directories of numbers that a stranger made, so everything about them is checked."""

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.untrusted.arrays import read_npz
from benchmark.untrusted.files import one_line
from benchmark.untrusted.json_text import read_json


def golden_directory(golden: Path, kind: str, *names: str) -> Path:
    """A directory that holds certain files.

    Args:
        golden: The directory.
        kind: What the set is about, which is also the usual name of its directory.
        names: Files that must be in it; a name may be a pattern.

    Returns:
        The directory.

    Raises:
        InputError: If it is absent or lacks a file.
    """
    if not golden.is_dir():
        raise InputError(f"no golden set at {golden}: it is not a directory; pass one that holds {', '.join(names)}")
    for name in names:
        if not any(golden.glob(name)):
            below = any((golden / kind).glob(name))
            advice = f"did you mean {golden / kind}?" if below else f"a set of this kind holds {', '.join(names)}"
            raise InputError(f"the golden set {golden} has no {name}; {advice}")
    return golden


def readable_set(golden: Path, kind: str, *names: str) -> Path:
    """A directory of npz and JSON files that can all be read, so that nothing is computed for a damaged set.

    Args:
        golden: The directory.
        kind: As in `golden_directory`.
        names: Files that must be in it; a name may be a pattern.

    Returns:
        The directory.

    Raises:
        InputError: If it is absent, lacks a file, or a file cannot be read.
    """
    golden_directory(golden, kind, *names)
    for path in sorted({path for name in names for path in golden.glob(name)}):
        if path.suffix == ".json":
            read_json(path)
        else:
            GoldenArrays.read(path)
    return golden


class GoldenArrays:
    """The arrays of one npz file, each checked when it is taken.

    Attributes:
        path: The file.
        names: All arrays in it.
    """

    def __init__(self, path: Path, arrays: dict[str, NDArray[Any]]) -> None:
        self.path, self._arrays = path, arrays
        self.names = frozenset(arrays)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file.

        Args:
            path: An npz file.

        Returns:
            Its arrays.

        Raises:
            InputError: If it is absent, truncated, not an npz file, or holds pickled objects.
        """
        try:
            arrays = read_npz(path)
        except (OSError, ValueError) as error:
            if _is_single_array(path):
                raise InputError(f"{path} holds a single array and is not an npz file; numpy.savez makes one") from None
            raise InputError(
                f"cannot read golden numbers from {path} ({one_line(error)}); it must be a whole npz file without "
                "pickled objects, fetch or make it again"
            ) from error
        return cls(path, arrays)

    def floats(self, name: str, *shape: int | None) -> Floats:
        """An array of finite numbers in double precision.

        Args:
            name: Its name.
            shape: Length of each axis, ``None`` for any.

        Returns:
            The array.

        Raises:
            InputError: If it is absent, not numeric, of another shape, or has NaN or infinity in it.
        """
        array = self._taken(name, "fiu", "numbers", shape)
        if not np.isfinite(array).all():
            raise InputError(f"array {name} in {self.path} has NaN or infinity in it; fetch or make the file again")
        return np.asarray(array, np.float64)

    def integers(self, name: str, *shape: int | None) -> NDArray[np.int64]:
        """An array of whole numbers; arguments and errors as in `floats`."""
        return np.asarray(self._taken(name, "iu", "whole numbers", shape), np.int64)

    def verdicts(self, name: str, *shape: int | None) -> Bools:
        """An array of booleans; arguments and errors as in `floats`."""
        return np.asarray(self._taken(name, "b", "booleans", shape), np.bool_)

    def texts(self, name: str, length: int | None = None) -> list[str]:
        """Names; arguments and errors as in `floats`."""
        return [str(text) for text in self._taken(name, "U", "names", (length,))]

    def columns(self, name: str, *wanted: str) -> list[int]:
        """Where named columns are.

        Args:
            name: Array of column names.
            wanted: Names that must be in it.

        Returns:
            Their indices.

        Raises:
            InputError: If the array or a column is absent.
        """
        labels = self._taken(name, "U", "names", (None,)).tolist()
        for label in wanted:
            if label not in labels:
                raise InputError(f"array {name} in {self.path} names no column {label}; make the file again with it")
        return [labels.index(label) for label in wanted]

    def _taken(self, name: str, kinds: str, meaning: str, shape: tuple[int | None, ...]) -> NDArray[Any]:
        if name not in self._arrays:
            raise InputError(f"{self.path} has no array {name}; it is not a golden file of this kind, or not all of it")
        array = self._arrays[name]
        if array.dtype.kind not in kinds:
            raise InputError(f"array {name} in {self.path} holds {array.dtype}, not {meaning}; make the file again")
        fits = array.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("any" if length is None else str(length) for length in shape) or "one number"
            raise InputError(f"array {name} in {self.path} has shape {array.shape}, not {wanted}; make the file again")
        return array


def _is_single_array(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(6) == b"\x93NUMPY"
    except OSError:
        return False
