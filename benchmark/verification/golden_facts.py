"""Reading JSON of golden sets: a stranger's numbers and words, each checked when it is taken."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.untrusted.json_text import read_json


class GoldenFacts:
    """One object of a JSON file.

    Attributes:
        path: The file.
        where: Which object, for messages.
    """

    def __init__(self, path: Path, value: Any, where: str) -> None:
        if not isinstance(value, dict):
            raise self._wrong(path, where, "is no object with names")
        self.path, self.where, self._value = path, where, value

    @classmethod
    def read(cls, path: Path) -> Self:
        """The object that a file is.

        Raises:
            InputError: If it cannot be read or holds something else.
        """
        return cls(path, read_json(path), "it")

    @classmethod
    def read_list(cls, path: Path) -> list[Self]:
        """The objects of a file that is a list.

        Raises:
            InputError: If it cannot be read, holds something else, or is empty.
        """
        return cls._listed(path, read_json(path), "it")

    def __contains__(self, name: str) -> bool:
        return name in self._value

    def __iter__(self) -> Iterator[str]:
        return iter(self._value)

    def inner(self, name: str) -> Self:
        """An object inside.

        Raises:
            InputError: If it is absent or something else; so do all below.
        """
        return type(self)(self.path, self._taken(name), f"{self.where} / {name}")

    def objects(self, name: str) -> list[Self]:
        """A list of objects inside, not empty."""
        return self._listed(self.path, self._taken(name), f"{self.where} / {name}")

    def text(self, name: str) -> str:
        """A word."""
        value = self._taken(name)
        if not isinstance(value, str):
            raise self._wrong(self.path, f"{self.where} / {name}", "is no text")
        return value

    def flag(self, name: str) -> bool:
        """A truth value."""
        value = self._taken(name)
        if not isinstance(value, bool):
            raise self._wrong(self.path, f"{self.where} / {name}", "is neither true nor false")
        return value

    def number(self, name: str) -> float:
        """A finite number."""
        return float(self.numbers(name))

    def whole(self, name: str) -> int:
        """A whole number."""
        value = self.number(name)
        if value != int(value):
            raise self._wrong(self.path, f"{self.where} / {name}", "is no whole number")
        return int(value)

    def known(self, name: str) -> bool:
        """Whether a value is there and not ``null``; it must be there."""
        return self._taken(name) is not None

    def numbers(self, name: str, *shape: int | None) -> Floats:
        """Finite numbers.

        Args:
            name: Their name.
            shape: Length of each axis, ``None`` for any.
        """
        where = f"{self.where} / {name}"
        try:
            array = np.asarray(self._taken(name))
        except ValueError:
            raise self._wrong(self.path, where, "is ragged") from None
        if array.dtype.kind not in "iuf" and array.size:
            raise self._wrong(self.path, where, "holds something else than numbers")
        array = array.astype(np.float64)
        fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
        if not fits:
            raise self._wrong(self.path, where, f"has shape {array.shape}")
        if not np.isfinite(array).all():
            raise self._wrong(self.path, where, "has NaN or infinity in it")
        return array

    def flags(self, name: str) -> list[bool]:
        """A list of truth values."""
        return self._all(name, bool, "truth values")

    def texts(self, name: str) -> list[str]:
        """A list of words."""
        return self._all(name, str, "words")

    def fragile(self, *names: str) -> bool:
        """Whether a value is marked as one that changes when its inputs move a little, and so is to be left out.

        Args:
            names: Of the value; none for all of the object.

        Returns:
            Whether ``fragile`` is true, or a list that has one of the names in it, alone or at the end of a path.
        """
        if "fragile" not in self or isinstance(self._value["fragile"], bool):
            return bool(self._value.get("fragile", False))
        marked = {re.split(r"[/.: ]", entry)[-1] for entry in self.texts("fragile")}
        return not marked.isdisjoint(names)

    def _all(self, name: str, kind: type, meaning: str) -> list[Any]:
        value = self._taken(name)
        if not isinstance(value, list) or not all(isinstance(each, kind) for each in value):
            raise self._wrong(self.path, f"{self.where} / {name}", f"is no list of {meaning}")
        return value

    @classmethod
    def _listed(cls, path: Path, value: Any, where: str) -> list[Self]:
        if not isinstance(value, list) or not value:
            raise cls._wrong(path, where, "is no list, or an empty one")
        return [cls(path, each, f"{where} / {number}") for number, each in enumerate(value)]

    def _taken(self, name: str) -> Any:
        if name not in self._value:
            raise self._wrong(self.path, self.where, f"has no {name}")
        return self._value[name]

    @staticmethod
    def _wrong(path: Path, where: str, what: str) -> InputError:
        return InputError(f"{path}: {where} {what}; it is not a golden file of this kind, or damaged: get it again")
