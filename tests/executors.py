"""Executors that stand in for others in tests."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from benchmark.machine.progress import CountedUnits

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Forbidden:
    """An executor that must not be given anything."""

    def map(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: CountedUnits | None = None,
    ) -> Iterator[Result]:
        assert total == 0, f"{label}: {total} again"
        assert list(items) == []
        return iter(())
