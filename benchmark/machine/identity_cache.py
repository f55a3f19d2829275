"""Cache of results for the last few objects by identity: scenes are large, and many episodes share one."""

from collections.abc import Callable
from typing import Generic, TypeVar

Source = TypeVar("Source")
Made = TypeVar("Made")


class IdentityCache(Generic[Source, Made]):
    """Makes something of an object and of plain values, and remembers the last ``kept`` results.

    Two objects are the same if they are one, even if others are equal. Neither they nor what was made may change.
    """

    def __init__(self, make: Callable[..., Made], kept: int = 1) -> None:
        self._make, self._kept = make, kept
        self._last: list[tuple[Source, tuple[object, ...], Made]] = []

    def __call__(self, source: Source, *values: object) -> Made:
        """The cached result, or a new one."""
        for known, others, result in self._last:
            if known is source and others == values:
                return result
        result = self._make(source, *values)
        self._last = [(source, values, result), *self._last][: self._kept]
        return result
