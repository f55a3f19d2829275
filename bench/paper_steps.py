"""What happens in a planning step of the preset ``paper``: ``python -m bench.paper_steps --data ROOT [--rows ...]``.

Medians over planning frames of the first vehicles of each scene, under readings of `bench.paper_pattern`: how far apart
candidates are, how many are safe, how peaked the resampling is, what five rounds add, and how many samples of the
trajectory model reach the ego's way at all; then how far noise of some levels moves a trajectory.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from bench.paper_pattern import read_hyper_parameters
from benchmark.datasets.roots import open_data
from benchmark.dynamics.bicycle import VehicleState
from benchmark.geometry import Floats, to_global
from benchmark.machine.workers import LocalProcesses
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.search.planning import AdversaryPlanning
from generation.search.presets import build_trajectory_model
from generation.search.proposals import SearchSteps
from generation.search.refinement import Refinement, compare_scores
from generation.search.scoring import compute_final_scores

LEVELS: Final = (5, 20, 50)
WAY_M: Final = 2.0
"""Half of both widths: nearer to the ego's path than this a body is in the ego's way."""


def describe(planning: AdversaryPlanning, frame: int, state: VehicleState, found: Refinement) -> dict[str, float]:
    """Figures of one planning frame."""
    hyper, first, last = planning.hyper, found.batches[0], found.batches[-1]
    scores = compute_final_scores(first.evaluated.terms, first.start, hyper)
    chance = np.exp(-hyper.temperature * (scores - scores.min()))
    chance /= chance.sum()
    terms, end = first.evaluated.terms, hyper.horizon - 1
    end = min(end, terms.distance.shape[1] - 1)
    best = compare_scores(found.batches, hyper).min(axis=1)
    spread = np.quantile(terms.distance[:, end], [0.0, 0.5, 1.0])
    unsafe = (terms.cr > 0) | terms.center_off_road.any(axis=1)
    path = planning.scene.ego.boxes[frame:, :2]
    points = np.stack([to_global(waypoints[:, :2], state.pose) for waypoints in first.waypoints])
    away = np.sqrt(((points[:, :, None] - path[None, None]) ** 2).sum(-1))
    at = np.minimum(6 * np.arange(1, points.shape[1] + 1), len(path) - 1)
    together = np.hypot(*(points - path[at]).transpose(2, 0, 1)).min(axis=1)
    finite = np.isfinite(scores)
    return {
        "distance, nearest, m": spread[0],
        "distance, median, m": spread[1],
        "distance, farthest, m": spread[2],
        "collide, %": 100 * float((terms.cr > 0).mean()),
        "off the road, %": 100 * float(terms.center_off_road.any(axis=1).mean()),
        "drawn effectively, of 256": float(np.exp(-(chance * np.log(chance + 1e-300)).sum())),
        "chance of unsafe ones, %": 100 * float(chance[unsafe & finite].sum()),
        "last round beats the first, %": 100.0 * float(best[-1] < best[0] - 1e-3),
        "best in round": float(np.argmin(best)),
        "nearest safe, first round, m": _nearest(first.evaluated.terms, end),
        "nearest safe, last round, m": _nearest(last.evaluated.terms, end),
        "reach the ego's path, %": 100 * float((away.min(axis=(1, 2)) <= WAY_M).mean()),
        "within 5 m of the ego then, %": 100 * float((together <= 5.0).mean()),
    }


def _nearest(terms: Any, end: int) -> float:
    safe = ~(terms.collision.any(axis=1) | terms.center_off_road.any(axis=1))
    return float(terms.distance[safe, end].min()) if safe.any() else np.nan


@contextmanager
def collect_planning_frames(kept: list[dict[str, float]], batches: list[tuple[Floats, Floats]]) -> Iterator[None]:
    """While it is open every planning frame leaves its figures, and its first batch with the pose before."""
    plan = AdversaryPlanning.plan

    def watched(planning: AdversaryPlanning, frame: int, state: VehicleState, track: Floats) -> SearchSteps[Refinement]:
        found = yield from plan(planning, frame, state, track)
        kept.append(describe(planning, frame, state, found))
        if len(batches) < 40:
            batches.append((found.batches[0].waypoints, planning._find_previous_pose(frame, state, track)))
        return found

    AdversaryPlanning.plan = watched  # type: ignore[method-assign, assignment]
    try:
        yield
    finally:
        AdversaryPlanning.plan = plan  # type: ignore[method-assign]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--rows", default="paper,second,second+geometry+chase+air+moving")
    parser.add_argument("--vehicles", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    columns: dict[str, dict[str, float]] = {}
    batches: list[tuple[Floats, Floats]] = []
    model = build_trajectory_model("paper", samples="stored")
    for row in given.rows.split(","):
        kept: list[dict[str, float]] = []
        with TemporaryDirectory() as out, collect_planning_frames(kept, batches):
            settings = BuildSettings(
                out=Path(out),
                hyper=replace(read_hyper_parameters(row), candidate_limit=given.vehicles),
                prior=model,
                seed=given.seed,
                executor=LocalProcesses(1),
            )
            try:
                build_split(open_data(given.data, name=given.data.name), "adv", settings)
            except NothingSurvivedError as nothing:
                print(nothing)
        columns[row] = {"planning frames": float(len(kept))}
        for name in kept[0]:
            values = np.array([figures[name] for figures in kept])
            middle = (
                np.nanmean if name in ("last round beats the first, %", "reach the ego's path, %") else np.nanmedian
            )
            columns[row][name] = float(middle(values))
    for name in columns[given.rows.split(",")[0]]:
        print(f"| {name} | {' | '.join(f'{column[name]:.4g}' for column in columns.values())} |")
    prior, rng = model(), np.random.default_rng(0)
    for level in LEVELS:
        moved = [
            np.hypot(*(prior.mutate(waypoints, level, previous, rng) - waypoints)[..., :2].transpose(2, 0, 1))  # type: ignore[attr-defined]
            for waypoints, previous in batches
        ]
        print(level, [round(float(np.median(np.concatenate(moved)[:, at])), 2) for at in (1, 5, 15)])


if __name__ == "__main__":
    main()
