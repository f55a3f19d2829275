"""Copies of the built-in golden sets that a test may change."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.verification.checks import Check
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.denoiser import verify_denoiser
from generation.extensions.golden_sets.physics import verify_physics
from generation.extensions.golden_sets.scoring import verify_scoring

VERIFY: dict[str, Callable[[Path | None], list[Check]]] = {
    "physics": verify_physics,
    "scoring": verify_scoring,
    "denoiser": verify_denoiser,
}
Arrays = dict[str, NDArray[Any]]


def copied(kind: str, folder: Path) -> Path:
    return Path(shutil.copytree(BUILT_IN / kind, folder / kind))


def load(path: Path) -> Arrays:
    with np.load(path) as stored:
        return {name: stored[name] for name in stored.files}


def save(path: Path, arrays: Arrays) -> None:
    np.savez_compressed(path, **arrays)


def change(path: Path, **changes: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
    arrays = load(path)
    save(path, arrays | {name: apply(arrays[name].copy()) for name, apply in changes.items()})


def shifted(amount: float, *index: int) -> Callable[[NDArray[Any]], NDArray[Any]]:
    def apply(array: NDArray[Any]) -> NDArray[Any]:
        array[index] += amount
        return array

    return apply


def flipped(*index: int) -> Callable[[NDArray[Any]], NDArray[Any]]:
    def apply(array: NDArray[Any]) -> NDArray[Any]:
        array[index] = ~array[index]
        return array

    return apply


def failures(checks: list[Check]) -> set[str]:
    return {check.quantity for check in checks if not check.ok}
