"""Splits that a command takes: those of ``--split``, or what the data set has of the default, said in one line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from benchmark import api
from benchmark.cli.settings import is_given
from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.api import DataSource, SourcePreview

FALLBACK: Final = "val"
"""Taken of a data set that has nothing of the default."""


@dataclass(frozen=True, slots=True)
class ChosenSplits:
    """Splits with what is known of each before it is opened, and the sentence on them, empty if they were named."""

    ahead: "Mapping[str, SourcePreview]"
    sentence: str = ""

    def say(self) -> None:
        """Print the sentence on stderr."""
        if self.sentence:
            api.notify(self.sentence)


def choose_splits(
    data: "DataSource", wanted: Sequence[str], scenes: Sequence[str] | None = None, limit: int | None = None
) -> ChosenSplits:
    """The splits that a command takes of a data set; ``wanted`` is the value of ``--split``.

    What the user named is required. Of a default the splits are taken that the data set has, with all of ``scenes``.

    Raises:
        InputError: As of `api.DataSource.require_split`; if there is no split to take.
    """
    if is_given("split"):
        return ChosenSplits({split: data.require_split(split, scenes, limit) for split in wanted})
    from benchmark.api.sources import NoSuchSceneError
    from benchmark.datasets.split_names import NoSuchSplitError

    ahead: dict[str, SourcePreview] = {}
    lacking: dict[str, InputError] = {}
    for split in dict.fromkeys((*wanted, FALLBACK)):
        if split in wanted or not ahead:
            try:
                ahead[split] = data.require_split(split, scenes, limit)
            except (NoSuchSplitError, NoSuchSceneError) as error:
                lacking[split] = error
    if not ahead:
        raise _make_error(data, lacking)
    reasons = [
        f"{data.name} has no {split}" if isinstance(error, NoSuchSplitError) else f"{split} lacks scenes of --scenes"
        for split, error in lacking.items()
    ]
    return ChosenSplits(ahead, describe_default(tuple(ahead), wanted, " and ".join(reasons)))


def say_default_split(split: str) -> None:
    """Print which split is taken, of a command that needs no data set to know it, unless the user named it."""
    if not is_given("split"):
        api.notify(describe_default([split], [split]))


def describe_default(taken: Sequence[str], default: Sequence[str], but: str = "") -> str:
    """Sentence on splits that were taken without ``--split``."""
    splits = f"{'split' if len(taken) == 1 else 'splits'} {' and '.join(taken)}"
    if not but:
        return f"{splits}, the default; --split chooses {'another' if len(taken) == 1 else 'others'}"
    return f"{splits}; the default is {' and '.join(default)}, but {but}"


def _make_error(data: "DataSource", lacking: Mapping[str, InputError]) -> InputError:
    from benchmark.datasets.split_names import NoSuchSplitError

    first = next(iter(lacking.values()))
    available = first.available if isinstance(first, NoSuchSplitError) else ()
    if not available:
        return first
    return InputError(
        f"{data.name} has neither {' nor '.join(lacking)}, which are taken without --split; it has "
        f"{', '.join(available)}: name one with --split"
    )
