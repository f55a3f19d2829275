"""UniAD's motion anchors: typical forecasts, published as a pickle beside the checkpoint and not in it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from adapters.models import MOTION_ANCHORS
from benchmark.constants import FARTHEST_WAYPOINT_M
from benchmark.errors import InputError
from benchmark.untrusted.pickles import read_pickle

FILE: Final = "motion_anchor_infos_mode6.pkl"
"""Its published name."""
_LIST: Final = "anchors_all"
_SHAPE: Final = (4, 6, 12, 2)
_NETWORK: Final = MOTION_ANCHORS.partition(".")[0] + "."


def read_motion_anchors(path: Path) -> Tensor:
    """Read the anchors without trusting the file: arrays and plain containers, no code.

    (4 groups of kinds of agents, 6 modes, 12 steps, 2) float32 metres in the frames of agents.
    """
    held = read_pickle(path)
    groups = held.get(_LIST) if isinstance(held, dict) else None
    if not isinstance(groups, list | tuple | np.ndarray):
        raise InputError(f"{path} has no list {_LIST!r}, so it holds no motion anchors; get {FILE} (weights list)")
    shapes = {_shape(group) for group in groups}
    if len(groups) != _SHAPE[0] or shapes != {_SHAPE[1:]}:
        found = f"{len(groups)} of {', '.join(map(str, sorted(shapes, key=str))) or 'nothing'}"
        raise InputError(
            f"the motion anchors in {path} are {found}, and UniAD needs {_SHAPE[0]} arrays of {_SHAPE[1:]}; get {FILE} "
            "(weights list)"
        )
    anchors = np.stack([np.asarray(group, np.float64) for group in groups])
    if not np.isfinite(anchors).all() or np.abs(anchors).max() > FARTHEST_WAYPOINT_M:
        raise InputError(f"the motion anchors in {path} hold numbers that are no metres; get {FILE} (weights list)")
    return torch.from_numpy(anchors).float()


def anchors_beside(path: Path, tensors: Mapping[str, Tensor]) -> Path | None:
    """File of the anchors that lie beside a checkpoint of UniAD which has none, under their published name."""
    if MOTION_ANCHORS in tensors or not _is_uniad(tensors):
        return None
    return published_beside(path)


def published_beside(path: Path) -> Path | None:
    """The file of the published name in the folder of another, if there is one."""
    beside = path.with_name(FILE)
    return beside if beside.is_file() else None


def with_motion_anchors(path: Path, tensors: Mapping[str, Tensor], anchors: Path) -> dict[str, Tensor]:
    """Tensors of UniAD and its anchors; those of another model, or with other anchors, are refused."""
    if not _is_uniad(tensors):
        raise InputError(
            f"{anchors} is no .safetensors file, so would be anchors of UniAD, and {path} is no checkpoint of UniAD; "
            "give what weights anchors has written, or leave --anchors out"
        )
    read = read_motion_anchors(anchors)
    own = tensors.get(MOTION_ANCHORS)
    if own is not None and not (own.shape == read.shape and bool(torch.equal(own.float(), read))):
        raise InputError(f"{path} has motion anchors of its own, which are not those of {anchors}; leave --anchors out")
    return {**tensors, MOTION_ANCHORS: read}


def _is_uniad(tensors: Mapping[str, Tensor]) -> bool:
    return any(name.startswith(_NETWORK) for name in tensors)


def _shape(group: Any) -> tuple[int, ...] | str:
    """Shape of an array of numbers, or what there is instead."""
    if isinstance(group, np.ndarray) and group.dtype.kind in "fiu":
        return group.shape
    return type(group).__name__
