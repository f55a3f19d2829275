"""Refusals that say of which kind they are, beside the sentence: what a golden set of broken files is compared by."""

from typing import Final, Literal, get_args

from benchmark.errors import InputError

Category = Literal[
    "truncated", "empty", "unknown", "no_plan", "class", "nesting", "size", "trailing", "shape", "not_finite", "token",
    "duplicate", "count", "order", "unit", "offsets", "time", "frame", "origin",
]  # fmt: skip
"""Why a file of results is refused."""
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)


class RefusedFile(InputError):
    """A file of results that is refused.

    Args:
        category: Why, in one word.
        sentence: What is wrong, where, and what to do.
    """

    def __init__(self, category: Category, sentence: str) -> None:
        super().__init__(sentence)
        self.category: Category = category
