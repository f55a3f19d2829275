"""What the sheets of a split say in numbers, checked: statistics of the data set and seconds of its generation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from benchmark.errors import InputError
from benchmark.records.scenes import Sheets, SplitSheet
from benchmark.report.cells import Origin, named_record
from leaderboard.tables.rows import SPLIT_ORDER

QUANTILES: Final = ("least", "tenth", "median", "ninetieth", "most")


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Rows(_Stored):
    """Rows of the tables of a data set (`benchmark.datasets.table_rows.TableCounts`)."""

    instances: int
    ego_poses: int
    scenes: int
    samples: int
    sample_data: int
    annotations: int


class Quantiles(_Stored):
    """Of a distribution that has values."""

    least: float
    tenth: float
    median: float
    ninetieth: float
    most: float


class Manoeuvre(_Stored):
    """One kind of manoeuvre (`benchmark.datasets.statistics.ManoeuvreRow`)."""

    manoeuvre: str
    primary: int
    occurred: int
    places: dict[str, int]
    median_gap_m: float | None


class Statistics(_Stored):
    """What tables need of `benchmark.datasets.statistics.Statistics`."""

    counts: Rows
    adversaries_per_scene: dict[int, int]
    labelled: int
    manoeuvres: tuple[Manoeuvre, ...]
    places: dict[str, int]
    gap_m: Quantiles | None
    time_to_collision_s: Quantiles | None
    within_5_s: int

    @field_validator("gap_m", "time_to_collision_s", mode="before")
    @classmethod
    def _of_nothing(cls, quantiles: Any) -> Any:
        """Quantiles of no values are stored as an empty object."""
        return quantiles or None


class Runtime(_Stored):
    """Processor seconds of a build by stage (``generation.build.profile.RuntimeTable``)."""

    attempts: int
    scenes: int
    total_s: dict[str, float]


@dataclass(frozen=True, slots=True)
class SplitFacts:
    """One split in numbers.

    Attributes:
        sheet: Its sheet.
        statistics: Of its data.
        runtime: Of its generation, if it was measured.
    """

    sheet: SplitSheet
    statistics: Statistics
    runtime: Runtime | None

    @property
    def origin(self) -> Origin:
        """Where its numbers come from: the data set's fingerprint stands for a record."""
        return Origin(record=named_record(self.sheet.data.fingerprint[:12], self.sheet.data.name, self.sheet.split))


_Read = TypeVar("_Read", bound=_Stored)


def facts_by_data_set(sheets: Sheets) -> dict[str, list[SplitFacts]]:
    """Splits of each data set, the paper's three first.

    Args:
        sheets: All of them.

    Returns:
        By the data set's name, in the order of the names.

    Raises:
        InputError: If the numbers of a split are not such as are written.
    """
    found: dict[str, list[SplitFacts]] = {}
    for sheet in _in_order(list(sheets.splits.values())):
        runtime = None if sheet.runtime is None else _checked(sheet, "runtime", sheet.runtime, Runtime)
        statistics = _checked(sheet, "statistics", sheet.statistics, Statistics)
        found.setdefault(sheet.data.name, []).append(SplitFacts(sheet, statistics, runtime))
    return found


def _in_order(sheets: Sequence[SplitSheet]) -> list[SplitSheet]:
    rank = {split: place for place, split in enumerate(SPLIT_ORDER)}
    return sorted(sheets, key=lambda sheet: (sheet.data.name, rank.get(sheet.split, len(rank)), sheet.split))


def _checked(sheet: SplitSheet, name: str, value: dict[str, Any], model: type[_Read]) -> _Read:
    try:
        return model.model_validate(value)
    except ValidationError as error:
        where = ".".join([name, *map(str, error.errors()[0]["loc"])])
        raise InputError(
            f"the sheet of split {sheet.split!r} of {sheet.data.name!r} lacks a proper {where}; run challenger-bench "
            "sheets again, or delete or move its split.json"
        ) from error
