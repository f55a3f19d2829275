"""Every number that the paper prints, and what others print of planners; quoted, never counted or measured here."""

from dataclasses import dataclass
from typing import Final

PAPER: Final = "Challenger: Affordable Adversarial Driving Video Generation"

DATA_SET_SOURCE: Final = f'{PAPER}, appendix "The Adv-nuSc Dataset"'
ADV_NUSC: Final = {
    "instances": 12_858,
    "ego_poses": 254_436,
    "scenes": 156,
    "samples": 6_115,
    "sample_data": 254_436,
    "annotations": 225_085,
}
"""Rows of the tables of Adv-nuSc."""

RUNTIME_SOURCE: Final = f'{PAPER}, appendix "Runtime Analysis"'
RUNTIME_S: Final = {"sampling": 17.36, "physics": 211.36, "scoring": 194.72, "rendering": 395.18}
"""Seconds of each stage for one scene of about 240 frames and six cameras."""
RUNTIME_MACHINE: Final = (
    "two Intel Xeon Platinum 8457C, 512 GB of memory and four NVIDIA L20 of 48 GB, one of which samples trajectories "
    "while all render"
)

HYPER_PARAMETERS_SOURCE: Final = f'{PAPER}, appendix "Hyperparameters"'
HYPER_PARAMETERS: Final = {
    "InitScale": "1e-3",
    "CornerWeight": "0.2",
    "H (planning horizon)": "12 timesteps",
    "DACStepWeight": "Quadratically decreasing from 1.0 to 0.85",
    "ColStepWeight": "Quadratically decreasing from 1.0 to 0.85",
    "ACStepWeight": "Linearly increasing from 0.7 to 1.0",
    "DACWeight": "5",
    "CRWeight": "10",
    "ACWeight": "1",
    "Temperature": "1.0",
    "#Refinement Rounds": "5",
}
"""As printed."""

TABLE_1_SOURCE: Final = f"{PAPER}, Table 1"


@dataclass(frozen=True, slots=True)
class PublishedRate:
    """One row of the paper's Table 1, under the protocol of the model's own repository, which it quotes.

    ``percent`` is the collision rate at 1 s, 2 s, 3 s and their average, as printed.
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


CHECKPOINTS: Final = ("uniad", "vad-tiny", "vad-base", "sparsedrive", "diffusiondrive")
"""Our models that load published checkpoints, of which planning results are printed (`find_published_results`)."""
PLANNING_ALLOWED: Final = {"collision": 0.03, "l2": 0.02}
"""How far ours may be from the nearest published value, per cent and metres. Two evaluations of one checkpoint by
others are 0.03 % apart (DiffusionDrive at 1 s: 0.03 and 0.059), for VAD up to 0.07 %, and their L2 up to 0.03 m."""
VAL_SAMPLES: Final = {"uniad": 6019, "vad": 5119, "sparsedrive": 5119, "diffusiondrive": 5119}
"""Samples of the nuScenes validation split that each protocol counts: all, or those with 3 s to come."""

QUALITY_SOURCE: Final = f"{PAPER}, Table 3"
TABLE_3: Final = {
    "nuScenes-val": ("0.8349", "0.3801"),
    "nuScenes-val-R": ("0.8173", "0.3471"),
    "Adv-nuSc": ("0.8093", "0.3469"),
}
"""Subject consistency and imaging quality of each data set, as printed."""

DATA_SET_OF_SPLIT: Final = {"val": "nuScenes-val", "val-r": "nuScenes-val-R", "adv": "Adv-nuSc"}
"""The paper's name of each split."""
MODEL_OF_PLANNER: Final = {
    "uniad": "UniAD",
    "vad": "VAD",
    "vad-base": "VAD",
    "sparsedrive": "SparseDrive",
    "diffusiondrive": "DiffusionDrive",
}
"""The paper's names of the planners that it ran, for records from before planners said it themselves; it does not say
which VAD, whose larger one is the usual one."""

ABLATION_SOURCE: Final = f'{PAPER}, section "Ablation Study"'
ABLATION: Final = {"full": 0.0617, "no-mtr": 0.0349, "no-ts": 0.0013, "no-mtr-no-ts": 0.0080}
"""Share of samples on which UniAD fails, by variant of the search (`benchmark.records.ablation.VARIANTS`): on 20 scenes
of the nuScenes validation set, rendered by MagicDriveDiT."""

SAMPLES_OF: Final = {"val": 6019, "adv": 6115}
"""Samples of nuScenes-val and of Adv-nuSc: they identify data sets whose splits share a name. The number for
nuScenes-val-R is not published."""


@dataclass(frozen=True, slots=True)
class PublishedResult:
    """A planning result in print, at 1 s, 2 s, 3 s and their average; values are empty where it is not printed.

    ``ours`` names the planner here, empty where it is not known which of them it is. ``protocol`` is the one here that
    it was computed by, or None; ``by`` has it in words. ``column`` is ``collision`` in per cent or ``l2`` in metres.
    """

    planner: str
    ours: tuple[str, ...]
    split: str
    protocol: str | None
    by: str
    column: str
    values: tuple[str, str, str, str]
    source: str


def _read_table_1_row(row: PublishedRate) -> PublishedResult:
    names = {"UniAD": ("uniad",), "VAD": ("vad", "vad-base")}.get(row.model, (row.model.lower(),))
    split = next(split for split, data_set in DATA_SET_OF_SPLIT.items() if data_set == row.data_set)
    return PublishedResult(
        row.model, names, split, row.protocol, row.protocol, "collision", row.percent, TABLE_1_SOURCE
    )


def _build_val_result(
    planner: str, ours: tuple[str, ...], protocol: str | None, column: str, values: str, source: str, by: str = ""
) -> PublishedResult:
    one, two, three, average = (text.replace("-", "") for text in values.split("/"))
    return PublishedResult(
        planner, ours, "val", protocol, by or protocol or "", column, (one, two, three, average), source
    )


_UNIAD_README: Final = "UniAD's repository, README"
_UNIAD_ISSUES: Final = "UniAD's repository, issues 29 and 166, pull request 173"
_VAD_README: Final = "VAD's repository, README"
_SPARSE_PAPER: Final = "Sun et al. 2024 (SparseDrive)"
_SPARSE_README: Final = "SparseDrive's repository, README"
_DIFFUSION_README: Final = "DiffusionDrive's repository, README"
_AVERAGED: Final = "uniad, averaged over the steps as ST-P3 does"
PUBLISHED_RESULTS: Final[tuple[PublishedResult, ...]] = (
    _build_val_result("UniAD", ("uniad",), "uniad", "collision", "0.05/0.17/0.71/0.31", _UNIAD_README),
    _build_val_result("UniAD", ("uniad",), "uniad", "l2", "0.48/0.96/1.65/1.03", _UNIAD_README),
    _build_val_result("UniAD, table of checkpoints", ("uniad",), "uniad", "collision", "-/-/-/0.29", _UNIAD_README),
    _build_val_result("UniAD", ("uniad",), "uniad", "collision", "0.10/0.15/0.61/-", _UNIAD_ISSUES),
    _build_val_result("UniAD", ("uniad",), "uniad", "l2", "0.51/0.98/1.65/-", _UNIAD_ISSUES),
    _build_val_result("UniAD", ("uniad",), None, "collision", "0.07/0.10/0.22/-", _UNIAD_ISSUES, _AVERAGED),
    _build_val_result("UniAD", ("uniad",), None, "l2", "0.42/0.64/0.91/-", _UNIAD_ISSUES, _AVERAGED),
    _build_val_result("UniAD", ("uniad",), "sparsedrive", "collision", "0.62/0.58/0.63/-", _SPARSE_PAPER),
    _build_val_result("VAD-Tiny", ("vad-tiny",), "vad", "collision", "0.21/0.35/0.58/0.38", _VAD_README),
    _build_val_result("VAD-Tiny", ("vad-tiny",), "vad", "l2", "0.46/0.76/1.12/0.78", _VAD_README),
    _build_val_result("VAD-Base", ("vad", "vad-base"), "vad", "collision", "0.07/0.17/0.41/0.22", _VAD_README),
    _build_val_result("VAD-Base", ("vad", "vad-base"), "vad", "l2", "0.41/0.70/1.05/0.72", _VAD_README),
    _build_val_result("VAD", (), "sparsedrive", "collision", "0.03/0.19/0.43/-", _SPARSE_PAPER),
    _build_val_result(
        "SparseDrive-S, released", ("sparsedrive",), "sparsedrive", "collision", "0.01/0.05/0.23/0.10", _SPARSE_README
    ),
    _build_val_result(
        "SparseDrive-S, released", ("sparsedrive",), "sparsedrive", "l2", "0.30/0.58/0.95/0.61", _SPARSE_README
    ),
    _build_val_result("SparseDrive-S, paper", (), "sparsedrive", "collision", "0.01/0.05/0.18/0.08", _SPARSE_README),
    _build_val_result("SparseDrive-S, paper", (), "sparsedrive", "l2", "0.29/0.58/0.96/0.61", _SPARSE_README),
    _build_val_result("SparseDrive-B, paper", (), "sparsedrive", "collision", "-/-/-/0.06", _SPARSE_README),
    _build_val_result("SparseDrive-B, paper", (), "sparsedrive", "l2", "-/-/-/0.58", _SPARSE_README),
    _build_val_result(
        "DiffusionDrive", ("diffusiondrive",), "diffusiondrive", "collision", "0.03/0.05/0.16/0.08", _DIFFUSION_README
    ),
    _build_val_result(
        "DiffusionDrive", ("diffusiondrive",), "diffusiondrive", "l2", "0.27/0.54/0.90/0.57", _DIFFUSION_README
    ),
    *map(_read_table_1_row, TABLE_1),
)
"""Published numbers by source, split and protocol: only those of the specifications and the paper."""


def find_published_results(model: str, protocol: str) -> tuple[PublishedResult, ...]:
    """Printed values of a checkpoint that ``model``, ours, loads, on the nuScenes validation split, under one protocol.

    A number that is printed twice was measured twice.
    """
    return tuple(
        result
        for result in PUBLISHED_RESULTS
        if model in result.ours and (result.split, result.protocol) == ("val", protocol)
    )


@dataclass(frozen=True, slots=True)
class PublishedNeuroncapResult:
    """A result in NeuroNCAP's closed loop; texts are empty where it is not printed.

    ``scores`` are of all, stationary, frontal and side encounters, ``collision`` is the rate of all in per cent. The
    renderer is the NeuRAD that drew the images: it is part of what was measured.
    """

    planner: str
    scores: tuple[str, str, str, str]
    collision: str
    renderer: str
    source: str


_QUOTED: Final = "Impromptu-VLA's repository, README, which quotes the papers"
_FIRST_RENDERER, _LATER_RENDERER = "of the paper", "of the repository, later"
NEURONCAP: Final[tuple[PublishedNeuroncapResult, ...]] = (
    PublishedNeuroncapResult("UniAD", ("0.73", "0.84", "0.10", "1.26"), "88.6", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("VAD", ("0.66", "", "", ""), "92.5", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("SparseDrive", ("0.92", "", "", ""), "93.9", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("BridgeAD-S", ("1.52", "", "", ""), "76.2", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("BridgeAD-B", ("1.60", "", "", ""), "72.6", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("Impromptu-VLA 3B", ("2.15", "", "", ""), "65.5", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("UniAD, post-processed", ("1.84", "", "", ""), "", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("VAD, post-processed", ("2.75", "", "", ""), "", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("BridgeAD-B, post-processed", ("3.06", "", "", ""), "44.3", _FIRST_RENDERER, _QUOTED),
    PublishedNeuroncapResult("ColaVLA", ("3.48", "", "", ""), "36.8", _FIRST_RENDERER, "ColaVLA"),
    PublishedNeuroncapResult(
        "UniAD, post-processed", ("2.111", "3.501", "1.166", "1.667"), "60.4", _LATER_RENDERER, "NeuroNCAP's README"
    ),
)
"""Scores of 0 to 5, higher is better. The last row and the 1.84 above are one planner under two renderers."""
