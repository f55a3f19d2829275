"""Anchors of a data set on disk: what ``challenger-bench weights anchors`` writes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from torch import Tensor

from adapters.checkpoints.sightings import sightings_of
from adapters.models import published_models
from adapters.networks.sparse.anchors import BOXES, FORECASTS, LINES, PLANS, anchors_of
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
from benchmark.weights.tensors import read_tensors, write_tensors

_ENTRY: Final = "challenger-bench-anchors"
_NAMES: Final = {BOXES, LINES, FORECASTS, PLANS}


@dataclass(frozen=True, slots=True)
class AnchorFile:
    """Anchors that were written.

    `sightings` says how many boxes, map elements, futures and plans the anchors are the centres of; `data` name and
    fingerprint of the data set.
    """

    path: Path
    sha256: str
    model: str
    data: dict[str, str]
    split: str | None
    sightings: dict[str, int]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"path": str(self.path), "sha256": self.sha256, **_facts(self)}


def write_anchors(model: str, data: DataSet, split: str | None, path: Path) -> AnchorFile:
    """Cluster what a data set holds, and keep the centres.

    Args:
        model: ``sparsedrive`` or ``diffusiondrive``.
        data: Any data set.
        split: Of the data set; ``None`` is all of it.
        path: A .safetensors file to write.

    Returns:
        What was written; the same data give the same bytes.

    Raises:
        InputError: If the model has no anchors, the data set is too small, or the file cannot be written.
    """
    known = {name: each for name, each in published_models().items() if each.net.clustered}
    if model not in known:
        raise InputError(f"{model!r} is no model with anchors; those are {', '.join(known)}")
    config = known[model].configuration()
    found = sightings_of(data, split, config)
    counts = {
        "boxes": len(np.asarray(found.box_centres)),
        "map elements": len(np.asarray(found.line_centres)),
        "futures": sum(len(np.asarray(futures)) for futures in found.futures),
        "plans": sum(len(np.asarray(plans)) for plans in found.plans),
    }
    anchors = anchors_of(found, config)
    source = {"name": data.name, "fingerprint": data.fingerprint()}
    made = AnchorFile(path, "", model, source, split, counts)
    write_tensors(path, anchors, _facts(made), entry=_ENTRY)
    return AnchorFile(path, file_sha256(path), model, source, split, counts)


def read_anchors(path: Path) -> dict[str, Tensor]:
    """Anchors from a file of `write_anchors`."""
    anchors, facts = read_tensors(path, entry=_ENTRY, what="anchors from ", instead="make them again")
    if not facts or set(anchors) != _NAMES:
        raise InputError(f"{path} holds no anchors; make them with: challenger-bench weights anchors --out {path.name}")
    return anchors


def _facts(made: AnchorFile) -> dict[str, Any]:
    return {"model": made.model, "data": made.data, "split": made.split, "sightings": made.sightings}
