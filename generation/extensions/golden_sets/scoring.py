"""`challenger-bench verify scoring`: the paper's score, and the reference code's, against golden numbers."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.geometry import Bools, box_corners
from benchmark.report.words import pluralise
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder, GoldenSet
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.reference_scores import (
    QUANTITIES,
    RANK_TIE,
    ScoredFrame,
    compare_except_ties,
    compare_reference,
    find_out_of_order,
    has_reference_scores,
    is_on_raster_tie,
    is_touching_tie,
    read_scored_frame,
)
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.scoring import ScoreTerms, compute_final_scores, compute_score_terms, normalise_challenge


def _compare_files(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the score of candidates in all three collision readings, and the reference code's."""
    excused: dict[str, int] = {}
    single: dict[str, int] = {}
    with_reference, paths = 0, folder.named("*.npz")
    # Overflows become infinite, and then fail the comparison.
    with np.errstate(over="ignore", invalid="ignore"):
        for path in paths:
            stored, at = folder.arrays(path.name), comparison.at(path.name)
            _compare_file(at, stored, excused)
            if has_reference_scores(stored):
                compare_reference(at.at(path.name, "reference: "), stored, single)
                with_reference += 1
    for quantity, count in excused.items():
        if count:
            comparison.note(quantity, f"{count} within 1e-9 of a tie are left out")
    for quantity, count in single.items():
        remark = f"{count} differ and hang on single precision, in {pluralise(with_reference, 'file')}"
        comparison.note(f"reference: {quantity}", remark)
    comparison.note("centre off the road", f"{pluralise(len(paths), 'file')}{_format_absent_files(folder, paths)}")


def _compare_file(comparison: Comparison, stored: GoldenArrays, excused: dict[str, int]) -> None:
    frame, paper = read_scored_frame(stored), HyperParameters.paper()
    sure: Bools | None = None
    for reading in CollisionReading:
        # The appendix has neither a margin around bodies nor anything after its horizon.
        hyper = replace(paper, collision_reading=reading, clearance_m=0.0, lookahead_frames=0)
        terms = compute_score_terms(frame.center, frame.size, frame.around, hyper)
        if sure is None:
            sure = _compare_road(comparison, stored, frame, terms, excused)
            count, steps = frame.boxes.shape[:2]
            numbers = {
                "distance to the ego (m)": (terms.distance, stored.floats("paper_dist", count, steps)),
                "challenge before normalisation": (terms.challenge, stored.floats("paper_ac_raw", count)),
                "challenge": (normalise_challenge(terms.challenge, terms.finite), stored.floats("paper_ac", count)),
            }
            for quantity, (ours, golden) in numbers.items():
                comparison.numbers(quantity, ours, golden)
        _compare_reading(comparison, stored, frame, terms, hyper, sure, excused)


def _compare_road(
    comparison: Comparison, stored: GoldenArrays, frame: ScoredFrame, terms: ScoreTerms, excused: dict[str, int]
) -> Bools:
    """Verdicts of leaving the road; gives back which candidates have none that a tie excuses."""
    shape, sure = frame.boxes.shape[:2], np.ones(len(frame.boxes), np.bool_)
    for quantity, ours, name, points in (
        ("centre off the road", terms.center_off_road, "paper_center_violation", frame.boxes[..., None, :2]),
        ("any corner off the road", terms.corner_off_road, "paper_corner_violation", box_corners(frame.boxes)),
    ):
        differs = np.asarray(ours != stored.verdicts(name, *shape))
        tie = differs.copy()
        tie[differs] = is_on_raster_tie(points[differs], frame.affine).any(axis=-1)
        compare_except_ties(comparison, quantity, differs, tie, excused)
        sure &= ~tie.any(axis=1)
    comparison.numbers("drivable area term", terms.dac[sure], stored.floats("paper_dac", len(sure))[sure])
    return sure


def _compare_reading(
    comparison: Comparison,
    stored: GoldenArrays,
    frame: ScoredFrame,
    terms: ScoreTerms,
    hyper: HyperParameters,
    road_sure: Bools,
    excused: dict[str, int],
) -> None:
    """Collisions, their term, final scores and ranking in one reading."""
    reading, count = hyper.collision_reading, len(frame.boxes)
    differs = terms.collision != stored.verdicts(f"paper_collision_{reading}", *frame.boxes.shape[:2])
    tie = differs.copy()
    for candidate, step in np.argwhere(differs):
        box, present = frame.boxes[candidate, step], frame.around.present[step]
        tie[candidate, step] = is_touching_tie(box, frame.around.boxes[step][present], reading)
    compare_except_ties(comparison, f"collision, {reading}", differs, tie, excused)
    sure = ~tie.any(axis=1)
    comparison.numbers(f"collision term, {reading}", terms.cr[sure], stored.floats(f"paper_cr_{reading}", count)[sure])
    sure &= road_sure
    wanted, drawn = (
        stored.floats(f"paper_final_{reading}", count),
        stored.floats("paper_init_score_uniform_0_1e-3", count),
    )
    for start, quantity in ((np.zeros(count), "final score"), (drawn, "final score with its random start")):
        ours = compute_final_scores(terms, start, hyper)
        comparison.numbers(f"{quantity}, {reading}", ours[sure], (wanted + start)[sure])
    ranked = compute_final_scores(terms, np.zeros(count), hyper)[sure]
    comparison.verdicts(f"ranking, {reading}", find_out_of_order(ranked, wanted[sure], RANK_TIE))


def _format_absent_files(folder: GoldenFolder, paths: list[Path]) -> str:
    """Files that the index of the set names and the folder lacks, in words."""
    listed = folder.facts("index.json") if folder.has("index.json") else []
    missing = {Path(str(name)).name for name in listed} - {path.name for path in paths}
    verb = "is" if len(missing) == 1 else "are"
    return f"; {len(missing)} more in index.json {verb} missing" if missing else ""


GOLDEN: Final = GoldenSet(
    name="scoring",
    files=("*.npz",),
    compare=(_compare_files,),
    quantities={**QUANTITIES, "*": 1e-9},
    built_in=BUILT_IN / "scoring",
)
