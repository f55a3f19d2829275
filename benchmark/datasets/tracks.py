"""Recorded vehicle tracks in one neutral npz format: what the models of this project are trained on.

A file holds ``x, y, heading`` (M,), ``ptr`` (N + 1,) so that track i is ``ptr[i]:ptr[i + 1]``, ``length`` (N,), ``cls``
(N,), optionally ``is_ego`` (N,), and the scalars ``hz, source, licence``.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.untrusted.arrays import read_npz
from benchmark.untrusted.files import to_one_line

REQUIRED: Final = ("ptr", "x", "y", "heading", "length", "cls", "hz", "source", "licence")


@dataclass(frozen=True, slots=True)
class RecordedTracks:
    """One track file as it is, N tracks of M samples together, the recorded point in metres and radians.

    Track i is samples ``pointers[i]:pointers[i + 1]``, ``pointers`` being (N + 1,). ``heading`` is wrapped or not,
    ``length`` is in metres and not finite where unknown, ``is_ego`` marks the recording car.
    """

    source: str
    licence: str
    hz: float
    pointers: NDArray[np.int64]
    x: Floats
    y: Floats
    heading: Floats
    length: Floats
    kinds: tuple[str, ...]
    is_ego: Bools


def read_recorded_tracks(path: Path) -> RecordedTracks:
    """Read all tracks of an npz file in the neutral format; nothing in it is unpickled."""
    try:
        arrays = read_npz(path)
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot read the tracks in {path} ({to_one_line(error)}); fetch or make the file again"
        ) from error
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        raise InputError(f"{path} lacks the arrays {', '.join(missing)}; it is not a track file")
    arrays = {"is_ego": np.zeros(len(np.atleast_1d(arrays["cls"])), np.bool_), **arrays}
    _check_arrays(path, arrays)
    return RecordedTracks(
        source=str(arrays["source"]),
        licence=str(arrays["licence"]),
        hz=float(arrays["hz"]),
        pointers=arrays["ptr"].astype(np.int64),
        x=arrays["x"],
        y=arrays["y"],
        heading=arrays["heading"],
        length=arrays["length"],
        kinds=tuple(str(kind) for kind in arrays["cls"]),
        is_ego=arrays["is_ego"].astype(np.bool_),
    )


def _check_arrays(path: Path, arrays: dict[str, Any]) -> None:
    """Refuse arrays whose shapes or values contradict each other."""
    kinds = {"ptr": "iu", "cls": "U", "source": "U", "licence": "U", "is_ego": "biuf"}
    for name in (*REQUIRED, "is_ego"):
        if arrays[name].size and arrays[name].dtype.kind not in kinds.get(name, "fiu"):
            raise InputError(f"{path}: {name} has the wrong type {arrays[name].dtype}; make the file again")
    if any(arrays[name].size != 1 for name in ("hz", "source", "licence")):
        raise InputError(f"{path}: hz, source and licence must be one value each; make the file again")
    ptr, samples, count = arrays["ptr"], len(np.atleast_1d(arrays["x"])), len(np.atleast_1d(arrays["cls"]))
    if ptr.ndim != 1 or len(ptr) != count + 1 or ptr[0] != 0 or ptr[-1] != samples or (np.diff(ptr) < 0).any():
        raise InputError(f"{path}: ptr must rise from 0 to the number of samples, one entry more than tracks")
    by_sample, by_track = ("x", "y", "heading"), ("length", "is_ego")
    if any(arrays[name].shape != (samples,) for name in by_sample) or any(
        arrays[name].shape != (count,) for name in by_track
    ):
        raise InputError(f"{path}: x, y and heading need one value per sample and length one per track")
    if not all(np.isfinite(arrays[name]).all() for name in by_sample):
        raise InputError(f"{path} has NaN or infinite positions or headings; leave those tracks out")
    if not (np.isfinite(arrays["hz"]) and 2 <= float(arrays["hz"]) <= 1000):
        raise InputError(f"{path} has {arrays['hz']} samples per second; 2 to 1000 are supported")
