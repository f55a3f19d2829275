"""`challenger-bench verify scoring`: the paper's score, and the reference code's, against golden numbers."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, box_corners
from benchmark.machine.storage import read_json
from benchmark.report.words import counted
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import GoldenArrays, golden_directory
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.reference_scores import compare_reference, has_reference_scores
from generation.extensions.golden_sets.scored_frame import ScoredFrame, read_scored_frame
from generation.extensions.golden_sets.ties import RANK_TIE, on_raster_tie, out_of_order, touching_tie
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.scoring import Terms, final_scores, normalised, score_terms

TOLERANCE: Final = 1e-9
"""Of distances in metres, of terms and of final scores."""


@dataclass(frozen=True, slots=True)
class _Golden:
    """What a file says about its candidates beside the inputs; B candidates, S frames."""

    center_off: Bools
    corner_off: Bools
    distance: Floats
    dac: Floats
    challenge: Floats
    normalised_challenge: Floats
    start: Floats


def verify_scoring(golden: Path | None = None) -> list[Check]:
    """Compare the score of candidates with a golden set, in all three collision readings, and the reference code's.

    Args:
        golden: Directory with one npz file for each planning frame; the built-in set by default.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    folder = golden_directory(golden or BUILT_IN / "scoring", "scoring", "*.npz")
    comparison = Comparison()
    excused: dict[str, int] = {}
    single: dict[str, int] = {}
    with_reference = 0
    paths = sorted(folder.glob("*.npz"))
    # What overflows is not finite, and then fails by itself.
    with np.errstate(over="ignore", invalid="ignore"):
        for path in paths:
            stored = GoldenArrays.read(path)
            _compare_file(comparison, stored, excused)
            if has_reference_scores(stored):
                compare_reference(comparison, stored, single)
                with_reference += 1
    for quantity, count in excused.items():
        comparison.note(quantity, f"{count} within 1e-9 of a tie are left out")
    for quantity, count in single.items():
        comparison.note(quantity, f"{count} differ and hang on single precision, in {counted(with_reference, 'file')}")
    comparison.note("centre off the road", f"{counted(len(paths), 'file')}{_absent(folder, paths)}")
    return comparison.checks()


def _compare_file(comparison: Comparison, stored: GoldenArrays, excused: dict[str, int]) -> None:
    frame = read_scored_frame(stored)
    golden, where = _read_golden(stored, *frame.boxes.shape[:2]), stored.path.name
    paper = HyperParameters.paper()
    for number, reading in enumerate(CollisionReading):
        hyper = replace(paper, collision_reading=reading)
        terms = score_terms(frame.center, frame.size, frame.around, hyper)
        if number == 0:
            sure = _compare_road(comparison, frame, golden, terms, excused, where)
            _compare_challenge(comparison, golden, terms, where)
        _compare_reading(comparison, stored, frame, golden, (terms, hyper, sure), excused)


def _read_golden(stored: GoldenArrays, count: int, steps: int) -> _Golden:
    return _Golden(
        center_off=stored.verdicts("paper_center_violation", count, steps),
        corner_off=stored.verdicts("paper_corner_violation", count, steps),
        distance=stored.floats("paper_dist", count, steps),
        dac=stored.floats("paper_dac", count),
        challenge=stored.floats("paper_ac_raw", count),
        normalised_challenge=stored.floats("paper_ac", count),
        start=stored.floats("paper_init_score_uniform_0_1e-3", count),
    )


def _compare_road(
    comparison: Comparison, frame: ScoredFrame, golden: _Golden, terms: Terms, excused: dict[str, int], where: str
) -> Bools:
    """Verdicts of leaving the road; gives back which candidates have none that a tie excuses."""
    corners = box_corners(frame.boxes)
    sure = np.ones(len(frame.boxes), np.bool_)
    for quantity, ours, wanted, points in (
        ("centre off the road", terms.center_off_road, golden.center_off, frame.boxes[..., None, :2]),
        ("any corner off the road", terms.corner_off_road, golden.corner_off, corners),
    ):
        differs = np.asarray(ours != wanted)
        tie = differs.copy()
        tie[differs] = on_raster_tie(points[differs], frame.affine).any(axis=-1)
        _verdicts(comparison, quantity, differs, tie, excused, where)
        sure &= ~tie.any(axis=1)
    comparison.numbers("drivable area term", terms.dac[sure], golden.dac[sure], TOLERANCE, where=where)
    return sure


def _compare_challenge(comparison: Comparison, golden: _Golden, terms: Terms, where: str) -> None:
    """Distances to the ego and what is made of them."""
    comparison.numbers("distance to the ego (m)", terms.distance, golden.distance, TOLERANCE, where=where)
    comparison.numbers("challenge before normalisation", terms.challenge, golden.challenge, TOLERANCE, where=where)
    ours = normalised(terms.challenge, terms.finite)
    comparison.numbers("challenge", ours, golden.normalised_challenge, TOLERANCE, where=where)


def _compare_reading(
    comparison: Comparison,
    stored: GoldenArrays,
    frame: ScoredFrame,
    golden: _Golden,
    scored: tuple[Terms, HyperParameters, Bools],
    excused: dict[str, int],
) -> None:
    """Collisions, their term, final scores and ranking in one reading."""
    terms, hyper, road_sure = scored
    reading, where, count = hyper.collision_reading, stored.path.name, len(frame.boxes)
    differs = terms.collision != stored.verdicts(f"paper_collision_{reading}", *frame.boxes.shape[:2])
    tie = differs.copy()
    for candidate, step in np.argwhere(differs):
        box, present = frame.boxes[candidate, step], frame.around.present[step]
        tie[candidate, step] = touching_tie(box, frame.around.boxes[step][present], reading)
    _verdicts(comparison, f"collision, {reading}", differs, tie, excused, where)
    sure = ~tie.any(axis=1)
    term = stored.floats(f"paper_cr_{reading}", count)
    comparison.numbers(f"collision term, {reading}", terms.cr[sure], term[sure], TOLERANCE, where=where)
    sure &= road_sure
    wanted = stored.floats(f"paper_final_{reading}", count)
    for start, quantity in ((np.zeros(count), "final score"), (golden.start, "final score with its random start")):
        ours, added = final_scores(terms, start, hyper)[sure], (wanted + start)[sure]
        comparison.numbers(f"{quantity}, {reading}", ours, added, TOLERANCE, where=where)
    ranked = final_scores(terms, np.zeros(count), hyper)[sure]
    comparison.verdicts(f"ranking, {reading}", out_of_order(ranked, wanted[sure], RANK_TIE), where=where)


def _verdicts(
    comparison: Comparison,
    quantity: str,
    differs: NDArray[np.bool_],
    tie: NDArray[np.bool_],
    excused: dict[str, int],
    where: str,
) -> None:
    """Count the verdicts that differ and have no tie to excuse it."""
    comparison.verdicts(quantity, (differs & ~tie)[~tie], where=where)
    if tie.any():
        excused[quantity] = excused.get(quantity, 0) + int(np.count_nonzero(tie))


def _absent(folder: Path, paths: list[Path]) -> str:
    """What the index of the set names and the folder lacks, in words."""
    index = folder / "index.json"
    if not index.is_file():
        return ""
    listed = read_json(index)
    names = {Path(str(name)).name for name in listed} if isinstance(listed, dict) else set()
    missing = names - {path.name for path in paths}
    return f"; {len(missing)} more in index.json are not there" if missing else ""
