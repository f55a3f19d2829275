"""The numbers printed in the paper, and beside which of ours they may stand.

Each model's row was computed with the protocol of the model's own repository, so rows of different models are not
comparable, and none of them is comparable with the ``exact`` protocol.
"""

from dataclasses import dataclass
from typing import Final

from benchmark.published import PAPER
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, UNDEFINED, Origin, Shown

SOURCE: Final = f"{PAPER}, Table 1"


@dataclass(frozen=True, slots=True)
class PublishedRate:
    """One row of the paper's Table 1.

    Attributes:
        model: Model name.
        protocol: Protocol of the model's own repository, which the row quotes.
        data_set: Name in the paper.
        percent: Collision rate at 1 s, 2 s, 3 s and their average, per cent, as printed.
    """

    model: str
    protocol: str
    data_set: str
    percent: tuple[str, str, str, str]


TABLE_1: Final = (
    PublishedRate("UniAD", "uniad", "nuScenes-val", ("0.10", "0.15", "0.61", "0.29")),
    PublishedRate("UniAD", "uniad", "nuScenes-val-R", ("0.07", "0.24", "0.64", "0.32")),
    PublishedRate("UniAD", "uniad", "Adv-nuSc", ("0.80", "4.10", "6.96", "3.95")),
    PublishedRate("VAD", "vad", "nuScenes-val", ("0.11", "0.24", "0.42", "0.26")),
    PublishedRate("VAD", "vad", "nuScenes-val-R", ("0.19", "0.32", "0.59", "0.37")),
    PublishedRate("VAD", "vad", "Adv-nuSc", ("4.46", "7.59", "9.08", "7.05")),
    PublishedRate("SparseDrive", "sparsedrive", "nuScenes-val", ("0.020", "0.063", "0.238", "0.107")),
    PublishedRate("SparseDrive", "sparsedrive", "nuScenes-val-R", ("0.010", "0.090", "0.370", "0.156")),
    PublishedRate("SparseDrive", "sparsedrive", "Adv-nuSc", ("0.029", "0.618", "2.430", "1.026")),
    PublishedRate("DiffusionDrive", "diffusiondrive", "nuScenes-val", ("0.059", "0.068", "0.169", "0.099")),
    PublishedRate("DiffusionDrive", "diffusiondrive", "nuScenes-val-R", ("0.030", "0.055", "0.403", "0.163")),
    PublishedRate("DiffusionDrive", "diffusiondrive", "Adv-nuSc", ("0.068", "1.299", "3.646", "1.671")),
)
"""Collision rates over 3 seconds on the paper's three data sets."""

INCREASE: Final = {"UniAD": "12.6", "VAD": "26.1", "SparseDrive": "8.6", "DiffusionDrive": "15.9"}
"""The paper's "× increase": (adv - val) / val of the averages, so an increase *by* that many times the baseline."""

QUALITY_SOURCE: Final = f"{PAPER}, Table 3"
TABLE_3: Final = {
    "nuScenes-val": ("0.8349", "0.3801"),
    "nuScenes-val-R": ("0.8173", "0.3471"),
    "Adv-nuSc": ("0.8093", "0.3469"),
}
"""Subject consistency and imaging quality of each data set, as printed."""

DATA_SET_OF_SPLIT: Final = {"val": "nuScenes-val", "val-r": "nuScenes-val-R", "adv": "Adv-nuSc"}
"""The paper's name of each split."""
_MODEL_OF_PLANNER: Final = {
    "uniad": "UniAD",
    "vad": "VAD",
    "vad-base": "VAD",
    "sparsedrive": "SparseDrive",
    "diffusiondrive": "DiffusionDrive",
}
"""Whom the paper ran, by the names of planners; it does not say which VAD, whose larger one is the usual one."""


def published_rate(record: RunRecord, judge: str) -> PublishedRate | None:
    """The paper's row that may stand beside a run.

    Args:
        record: The run.
        judge: Protocol of the numbers beside which it would stand.

    Returns:
        The row of the model of that name on the split of that name, if the paper quotes the same protocol.
    """
    model = _MODEL_OF_PLANNER.get(record.run.planner.name.lower())
    data_set = DATA_SET_OF_SPLIT.get(record.run.split)
    return next(
        (row for row in TABLE_1 if (row.model, row.data_set, row.protocol) == (model, data_set, judge)),
        None,
    )


def is_variant(record: RunRecord, judge: str) -> bool:
    """Whether a planner is named after a model of the paper that was judged likewise, and is not that model."""
    name = record.run.planner.name.lower()
    stems = {model.lower() for model in INCREASE if any((row.model, row.protocol) == (model, judge) for row in TABLE_1)}
    return name not in _MODEL_OF_PLANNER and any(name.startswith(f"{stem}-") for stem in stems)


def published_cells(row: PublishedRate | None) -> tuple[Shown, ...]:
    """The paper's rates at 1, 2, 3 s, their average and its increase, as printed; dashes without a row."""
    if row is None:
        return (Shown(UNDEFINED),) * 5
    origin = Origin(protocol=row.protocol, source=SOURCE)
    increase = INCREASE[row.model] if row.data_set == "Adv-nuSc" else None
    shown = [quoted(text, PERCENT, origin) for text in row.percent]
    return (*shown, Shown(UNDEFINED) if increase is None else quoted(increase, "×", origin, after="×"))


def quoted(text: str, unit: str, origin: Origin, *, after: str = "") -> Shown:
    """A number as printed.

    Args:
        text: As printed, possibly with commas between thousands.
        unit: Its unit.
        origin: Where it is from.
        after: Text behind it.

    Returns:
        The text and the number.
    """
    return Shown(f"{text}{after}", origin.cell(float(text.replace(",", "")), unit, None))
