"""The numbers printed in the paper, kept apart from ours.

Each model's row was computed with the protocol of the model's own repository, so rows of different models are not
comparable, and none of them is comparable with the ``exact`` protocol.
"""

from dataclasses import dataclass
from typing import Final

SOURCE: Final = "Challenger: Affordable Adversarial Driving Video Generation, Table 1"


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
