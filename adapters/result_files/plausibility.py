"""Whether plans can be in the frame, unit and origin that their format has.

Each test compares plans with what was recorded, says what would fit where it refuses, and says "not testable" where
too few samples could show anything: a planner that stands still or only drives straight passes all of them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from adapters.result_files.contract import Rows, refuse
from adapters.result_files.samples import RecordedSamples
from adapters.result_files.turning import turned
from benchmark.constants import FARTHEST_WAYPOINT_M, PLAN_STEPS
from benchmark.foreign.refusals import Category
from benchmark.geometry import Bools, Floats

FEWEST: Final = 10
FEWEST_STANDING: Final = 5
MOVED_M: Final = 3.0
BEGUN_M: Final = 0.5
ASIDE_M: Final = 2.0
STANDING_M: Final = 0.2
_UNIT: Final = 10.0
_SUMMED: Final = 0.35
_DROVE_M: Final = 1e-3
"""Of a recorded car that did not move at all nothing can be said to grow."""
_SECOND_STEP: Final = 0.6
"""Offsets of a car that drives on have a second step like the first; a car that brakes still gets ahead in it."""
_TURNED: Final = 0.8
_MIRRORED: Final = 0.5
_ORIGIN_M: Final = 0.5
_TURNS: Final = {"x and y look exchanged": np.pi / 2, "x and y look exchanged and turned": -np.pi / 2,
                 "x and y look turned about": np.pi}  # fmt: skip
_ADVICE: Final = "such plans are not judged: check which script wrote the file"


@dataclass(frozen=True, slots=True)
class Plausibility:
    """What the tests found.

    Attributes:
        said: By the name of the test: what was measured on how many samples, or that it is not testable.
    """

    said: dict[str, str]


def require_plausible(path: Path, plans: Floats, rows: Rows, samples: RecordedSamples) -> Plausibility:
    """Refuse plans that fit far better in another unit, frame or origin.

    Args:
        path: The file, for messages.
        plans: (N, K, 2) positions of the lidar, x right, y forward, as the format says.
        rows: (N,) their samples.
        samples: What was recorded.

    Returns:
        What was measured.

    Raises:
        RefusedFile: With the category of the first test that fails, and what would fit.
    """
    # Plans may be as large as numbers get: squares of those are infinite, and every test below refuses them.
    with np.errstate(over="ignore", invalid="ignore"):
        return _tested(path, plans, rows, samples)


def _tested(path: Path, plans: Floats, rows: Rows, samples: RecordedSamples) -> Plausibility:
    complete = samples.complete[rows]
    plan, recorded = plans[complete, :PLAN_STEPS], samples.future[rows][complete]
    size, gone = np.linalg.norm(plan, axis=2), np.linalg.norm(recorded, axis=2)
    moved = gone[:, -1] > MOVED_M
    said: dict[str, str] = {}
    _unit(path, said, size, gone, moved)
    _offsets(path, said, size, gone)
    _axes(path, said, plan, recorded, moved)
    _mirror(path, said, plan, recorded)
    _origin(path, said, plan, gone)
    far = np.abs(plans).max(axis=(1, 2), initial=0.0)
    if far.max(initial=0.0) > FARTHEST_WAYPOINT_M:
        token = samples.tokens[int(rows[far.argmax()])]
        what = f"the plan of sample {token} reaches {far.max():.3g} m, which is a mistake of units or frame"
        refuse(path, "unit", what, _ADVICE)
    return Plausibility(said)


def _testable(said: dict[str, str], name: str, chosen: Bools, fewest: int) -> bool:
    count = int(chosen.sum())
    if count < fewest:
        said[name] = f"not testable ({count} of {fewest} samples)"
    return count >= fewest


def _refuse(path: Path, category: Category, what: str) -> None:
    refuse(path, category, what, _ADVICE)


def _unit(path: Path, said: dict[str, str], size: Floats, gone: Floats, moved: Bools) -> None:
    if not _testable(said, "unit", moved, FEWEST):
        return
    ratio = float(np.median(size[moved, -1] / gone[moved, -1]))
    if ratio > _UNIT:
        fits = (
            "centimetres would fit" if 50 < ratio < 200 else "millimetres would fit" if ratio >= 500 else "not metres"
        )
        _refuse(path, "unit", f"its plans go {ratio:.3g} times as far in 3 s as the recorded car: {fits}")
    said["unit"] = f"plans go {ratio:.2f} times as far as recorded ({int(moved.sum())} samples)"


def _offsets(path: Path, said: dict[str, str], size: Floats, gone: Floats) -> None:
    begun = size[:, 0] > BEGUN_M
    if not _testable(said, "offsets", begun, FEWEST):
        return
    drove = begun & (gone[:, 0] > _DROVE_M)
    if not _testable(said, "offsets", drove, 1):
        return
    last, second = (
        float(np.median(size[begun, step] / size[begun, 0]) / np.median(gone[drove, step] / gone[drove, 0]))
        for step in (-1, 1)
    )
    if last < _SUMMED and second < _SECOND_STEP:
        what = f"its plans grow {last:.2f} times as much from 0.5 s to 3 s as the recorded ways"
        _refuse(path, "offsets", f"{what}: offsets that were not summed would fit (1/6)")
    said["offsets"] = f"plans grow {last:.2f} times as much as recorded ({int(begun.sum())} samples)"


def _axes(path: Path, said: dict[str, str], plan: Floats, recorded: Floats, moved: Bools) -> None:
    if not _testable(said, "axes", moved, FEWEST):
        return
    first, way = plan[moved, 0], recorded[moved, 0]
    scale = np.maximum(np.linalg.norm(way, axis=1), 0.5)

    def error(angle: float) -> float:
        return float(np.median(np.linalg.norm(turned(first, angle) - way, axis=1) / scale))

    as_read = error(0.0)
    name, best = min(((name, error(angle)) for name, angle in _TURNS.items()), key=lambda each: each[1])
    if best < _TURNED * as_read:
        _refuse(path, "frame", f"{name}: as read {as_read:.2f}, turned {best:.2f} (error of the first step)")
    said["axes"] = f"as read {as_read:.2f}, best turned {best:.2f} ({int(moved.sum())} samples)"


def _mirror(path: Path, said: dict[str, str], plan: Floats, recorded: Floats) -> None:
    aside = np.abs(recorded[:, -1, 0]) >= ASIDE_M
    if not _testable(said, "mirror", aside, FEWEST):
        return
    ours, way = plan[aside, -1, 0], recorded[aside, -1, 0]
    as_read, mirrored = float(np.median(np.abs(ours - way))), float(np.median(np.abs(-ours - way)))
    if mirrored < _MIRRORED * as_read:
        _refuse(path, "frame", f"left and right look exchanged: as read {as_read:.2f} m, mirrored {mirrored:.2f} m")
    said["mirror"] = f"as read {as_read:.2f} m, mirrored {mirrored:.2f} m ({int(aside.sum())} samples)"


def _origin(path: Path, said: dict[str, str], plan: Floats, gone: Floats) -> None:
    standing = gone.max(axis=1, initial=0.0) < STANDING_M
    standing &= np.linalg.norm(plan[:, -1] - plan[:, 0], axis=1) < BEGUN_M
    if not _testable(said, "origin", standing, FEWEST_STANDING):
        return
    away_m = float(np.median(np.linalg.norm(plan[standing, 0], axis=1)))
    if away_m > _ORIGIN_M:
        what = f"plans of a car that stands begin {away_m:.2f} m away"
        _refuse(
            path,
            "origin",
            f"{what}: positions measured from another point of the car would fit (lidar and rear "
            "axle are 0.94 m apart)",
        )
    said["origin"] = f"plans of a car that stands begin {away_m:.2f} m away ({int(standing.sum())} samples)"
