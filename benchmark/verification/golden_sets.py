"""Golden sets: the one form in which a family of golden numbers is declared, and the one reader of their files."""

import gzip
import json
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.untrusted.arrays import read_npz
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.text_files import read_json
from benchmark.verification.checks import Check, Comparison

_DAMAGED: Final = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, RuntimeError, MemoryError)
"""Exceptions that reading a damaged set, or one of another kind, can raise."""
_MOST_UNPACKED: Final = 64 << 20


class GoldenArrays:
    """The arrays of one npz file, each of the kind and the shape that is asked for, or an `InputError`."""

    def __init__(self, path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
        self.path, self._arrays = path, arrays
        self.names = frozenset(arrays)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file; an `InputError` if it is absent, truncated, no npz file, or holds pickled objects."""
        try:
            arrays = read_npz(path)
        except (OSError, ValueError) as error:
            raise build_damage_error(
                path, f"{to_one_line(error)}; it must be a complete npz file without pickled objects"
            ) from error
        if not arrays:
            raise build_damage_error(path, "it holds no arrays")
        return cls(path, arrays)

    def floats(self, name: str, *shape: int | None, gaps: bool = False) -> Floats:
        """Numbers in double precision, of which verdicts are 0 and 1.

        ``None`` in ``shape`` is any length; with ``gaps``, NaN and infinity may be among them.
        """
        array = np.asarray(self._taken(name, "fiub", shape), np.float64)
        if not gaps and not np.isfinite(array).all():
            raise build_damage_error(self.path, f"array {name} has NaN or infinity in it")
        return array

    def integers(self, name: str, *shape: int | None) -> NDArray[np.int64]:
        """Whole numbers."""
        return np.asarray(self._taken(name, "iu", shape), np.int64)

    def verdicts(self, name: str, *shape: int | None) -> Bools:
        """Booleans."""
        return np.asarray(self._taken(name, "b", shape), np.bool_)

    def texts(self, name: str, length: int | None = None) -> list[str]:
        """Names."""
        return [str(text) for text in self._taken(name, "U", (length,))]

    def columns(self, name: str, *wanted: str) -> list[int]:
        """Where named columns are in an array of names."""
        labels = self.texts(name)
        return [labels.index(label) for label in wanted]

    def _taken(self, name: str, kinds: str, shape: tuple[int | None, ...]) -> NDArray[Any]:
        array = self._arrays.get(name)
        if array is None:
            raise build_damage_error(self.path, f"no array {name}")
        fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
        if array.dtype.kind not in kinds or not fits:
            raise build_damage_error(
                self.path, f"array {name} of {array.dtype} has the wrong type or shape {array.shape}"
            )
        return array


@dataclass(frozen=True, slots=True)
class GoldenFolder:
    """The files of a set."""

    path: Path

    def arrays(self, name: str) -> GoldenArrays:
        """The arrays of a file."""
        return GoldenArrays.read(self.path / name)

    def facts(self, name: str, *, gaps: bool = False) -> Any:
        """Value of a JSON file; ``gaps`` as of `GoldenArrays.floats`."""
        value = read_json(self.path / name)
        if not value:
            raise build_damage_error(self.path / name, "it is empty")
        if not gaps:
            # Python's reader accepts NaN and infinity, which JSON does not have.
            json.dumps(value, allow_nan=False)
        return value

    def read_json_nearby(self, name: str, *, gaps: bool = False) -> Any:
        """As `facts`, of a file in the folder or else in the one above."""
        folder = self if self.has(name) else GoldenFolder(self.path.parent)
        return folder.facts(name, gaps=gaps)

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        return (self.path / name).is_file()

    def named(self, pattern: str) -> list[Path]:
        """Files of a pattern, in order of their names."""
        return sorted(self.path.glob(pattern))


@dataclass(frozen=True, slots=True)
class GoldenSet:
    """One family of golden numbers, as `challenger-bench verify` runs it.

    Attributes:
        name: What it is about, as `verify` is told.
        files: What a set holds; a name may be a pattern.
        compare: Each reads of the folder, works our values out, and compares them; in this order.
        quantities: Largest error by quantity, whose name may be a pattern; verdicts must be equal and have none.
        built_in: The set in the package.
        made_here: Stands for the set in the package where there is none.
        usual: Usual name of a folder that holds such a set, if not the name.
        holds: What a set is, where there is neither, for the message.
    """

    name: str
    files: tuple[str, ...]
    compare: tuple[Callable[[Comparison, GoldenFolder], None], ...]
    quantities: Mapping[str, float] = field(default_factory=dict)
    built_in: Path | None = None
    made_here: Callable[[Comparison], None] | None = None
    usual: str = ""
    holds: str = "golden numbers"

    def verify(self, golden: Path | None = None) -> list[Check]:
        """Compare our values with a set in a folder or in the package: one check for each quantity, over all files."""
        comparison, folder = Comparison(self.quantities), golden or self.built_in
        if folder is None and self.made_here is not None:
            self.made_here(comparison)
        elif folder is None:
            raise InputError(f"verify {self.name} needs --golden, a directory of {self.holds}; none are built in")
        else:
            find_golden_directory(folder, self.usual or self.name, *self.files)
            with raise_input_error(folder, self.name):
                for compare in self.compare:
                    compare(comparison, GoldenFolder(folder))
        return comparison.checks()


def unpack_gzip(path: Path) -> bytes:
    """Content of a compressed file of a set, at most 64 MB; an `InputError` if it is damaged or larger."""
    try:
        with gzip.open(path) as file:
            data = file.read(_MOST_UNPACKED + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise build_damage_error(path, to_one_line(error)) from error
    if len(data) > _MOST_UNPACKED:
        raise build_damage_error(path, f"it holds over {_MOST_UNPACKED >> 20} MB")
    return data


def build_damage_error(path: Path, what: str) -> InputError:
    """The one sentence on a file or folder that is not what it should be."""
    return InputError(f"{path} is not a golden set of this kind or is damaged ({what}); get it again")


@contextmanager
def raise_input_error(path: Path, kind: str) -> Iterator[None]:
    """Context in which any failure of a damaged set, or one of another kind, ends as one sentence."""
    try:
        yield
    except _DAMAGED as error:
        reason = f"{type(error).__name__}: {to_one_line(' '.join(str(error).split()))}"
        raise InputError(f"{path} is not a golden set of {kind} or is damaged ({reason}); get it again") from error


def find_golden_directory(golden: Path, kind: str, *names: str) -> Path:
    """Directory that holds all files of these names or patterns; ``kind`` is also its usual name."""
    if not golden.is_dir():
        raise InputError(f"no golden set at {golden}: it is not a directory; give one that holds {', '.join(names)}")
    for name in names:
        if not any(golden.glob(name)):
            below = any((golden / kind).glob(name))
            advice = f"did you mean {golden / kind}?" if below else f"a set of this kind holds {', '.join(names)}"
            raise InputError(f"the golden set {golden} has no {name}; {advice}")
    return golden
