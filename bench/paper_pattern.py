"""The paper's pattern under one reading after another: ``python -m bench.paper_pattern --data ROOT --out FOLDER``.

Each row changes some settings of the preset ``paper`` as it was (`BEFORE`). Of each, the four searches of the paper's
ablation are built for every seed, and planners without images plan on what is kept. Shown are how many vehicles are
kept, in how many samples the adversary is within 2 and 5 m of the ego, per cent, the same of the tenth of the tried
vehicles that is nearest over its drive (as many as were published of those that may have been tried), and first
contacts with the adversary, mean of 1, 2 and 3 s, per cent: of the samples of kept scenes, and of those of all tried
vehicles, for ``noisy-log`` and ``constant-velocity``, of the full search, without refinement, without both, without
scoring.

Finished rows stay in FOLDER, one file each, and are not done again; ``--rows`` takes names of `READINGS`, several
joined by ``+``. First batches are picked from the stored samples of the trajectory model, which its 100 steps made.
"""

import argparse
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.registry import build_planner
from benchmark.datasets.roots import DataSet, open_data
from benchmark.fairness.traffic import measure_figures, plan_samples
from benchmark.machine.workers import LocalProcesses
from benchmark.protocols import find_protocol
from benchmark.records.ablation import VARIANTS, AblationVariant
from benchmark.records.attempts import ATTEMPTS_FILE, read_attempts
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.search.hyperparameters import HyperParameters
from generation.search.presets import build_trajectory_model

TOLD: Final = "told"
BEFORE: Final = (
    "timestep_frames=6", "collision_reading=literal", "lookahead_frames=0", "lookahead_challenge_weight=0",
    "clearance_m=0", "headway_s=0", "parked=true",
)  # fmt: skip
"""What the preset ``paper`` was before this study changed it."""
READINGS: Final[Mapping[str, tuple[str, ...]]] = {
    "paper": (),
    # How long 12 timesteps are, and what counts after them.
    "second": ("timestep_frames=1",),
    "quarter": ("timestep_frames=3",),
    "tail": ("lookahead_frames=24",),
    "chase": ("lookahead_frames=24", "lookahead_challenge_weight=0.3"),
    "tail8": ("timestep_frames=1", "lookahead_frames=84", "lookahead_stride=3", "lookahead_challenge_weight=0.03"),
    # What collides.
    "geometry": ("collision_reading=geometry",),
    "half": ("collision_reading=half",),
    "clear": ("clearance_m=0.25",),
    "air": ("clearance_m=0.25", "headway_s=0.15"),
    # Who acts, and from when.
    "near": ("launch=near",),
    "reach": ("launch=reach",),
    "moving": ("parked=false",),
    "stay": ("staying_preference=2",),
    # The search.
    "best": ("best_of_all_rounds=true",),
    "varied": ("varied=true",),
    "hot": ("temperature=10",),
    "cold": ("temperature=0.1",),
    "noise20": ("first_noise_level=20",),
    "noise50": ("first_noise_level=50",),
    "rounds20": ("rounds=20",),
    "tries3": ("tries=3",),
    "weight5": ("ac_weight=5",),
    "code": ("score=reference", "init_least=0.02"),
    # How it moves, what is told to the trajectory model, and what drops a scene.
    "driver": ("motion=driver",),
    "frames": ("motion=reference",),
    TOLD: (),
    "touch": ("discards=reference",),
}
PLANNERS: Final = {"noisy-log": 40, "constant-velocity": 1}
"""With the number of seeds."""
SELECTED: Final = 156 / 1500
"""Published scenes of the vehicles that may have been tried: 10 in each of 150 scenes."""


@dataclass(frozen=True)
class Job:
    """One row with one seed."""

    row: str
    seed: int
    root: Path
    out: Path
    vehicles: int
    variants: tuple[AblationVariant, ...]


def read_hyper_parameters(row: str) -> HyperParameters:
    """Settings of a row."""
    before = HyperParameters.paper().changed(BEFORE)
    return before.changed([change for name in row.split("+") for change in READINGS[name]])


def count_contacts(data: DataSet, name: str) -> dict[str, list[float]]:
    """By planner: plans of all seeds, and how many touch the adversary first within 1, 2 and 3 s."""
    scene, truths, observations = data.scene(name), data.truth(name), list(data.observations(name))
    exact, counts = find_protocol("exact"), {}
    for planner, seeds in PLANNERS.items():
        planned = [
            one for seed in range(seeds) for one in plan_samples(scene, observations, build_planner(planner, seed=seed))
        ]
        told = [truths[index] for index, _ in planned]
        plans = np.array([
            plan.waypoints_in_lidar(truth.lidar_ahead_m) for (_, plan), truth in zip(planned, told, strict=True)
        ])  # fmt: skip
        outcomes = exact.evaluate(told, plans)
        first = zip(outcomes.facts["first_contact_s"], outcomes.facts["hit_adversary"], strict=True)
        when = np.array([second if adversary else np.inf for second, adversary in first])[outcomes.counted]
        counts[planner] = [float(len(when)), *(float((when <= horizon + 1e-9).sum()) for horizon in (1, 2, 3))]
    return counts


def measure_nearness(data: DataSet, name: str) -> list[float]:
    """Samples, those with the adversary within 2 and 5 m, and its mean distance from the ego, centre to centre."""
    scene = data.scene(name)
    figures = measure_figures(scene, data.truth(name))
    two, five = (figures[f"adversary_within_{limit}_m"] for limit in (2, 5))
    agent = scene.agents.ids.index(scene.adversaries[0])
    frames = scene.keyframes[scene.agents.valid[agent, scene.keyframes]]
    away = np.hypot(*(scene.agents.position[agent, frames, :2] - scene.ego.boxes[frames, :2]).T)
    return [float(len(two[1])), float(two[0].sum()), float(five[0].sum()), float(away.mean())]


def search(source: DataSet, settings: BuildSettings) -> dict[str, Any]:
    """Build one search, and measure the scenes that it keeps."""
    begun = time.process_time()
    try:
        report = build_split(source, "adv", settings)
    except NothingSurvivedError as nothing:
        report = nothing.report
    seconds = time.process_time() - begun
    attempts = read_attempts(settings.out / ATTEMPTS_FILE)
    complete = {
        name: sum(truth.by_clock.complete for truth in source.truth(name))
        for name in sorted({attempt.scene for attempt in attempts})
    }
    found: dict[str, Any] = {
        "tried": report.tried,
        "kept": report.survived,
        "discarded": report.discarded,
        "samples": sum(complete[attempt.scene] for attempt in attempts),
        "search_s": seconds,
        "scenes": {},
    }
    if report.survived:
        data = open_data(settings.out, name=source.name)
        for name in data.scene_names("adv"):
            found["scenes"][name] = {"near": measure_nearness(data, name), **count_contacts(data, name)}
    return found


def run(job: Job) -> None:
    """One row with one seed, unless it is there already."""
    target = job.out / f"{job.row}-{job.seed}.json"
    result: dict[str, Any] = json.loads(target.read_text()) if target.is_file() else {}
    missing = [variant for variant in job.variants if variant.name not in result]
    if not missing:
        return
    hyper = replace(read_hyper_parameters(job.row), candidate_limit=job.vehicles)
    told = TOLD in job.row.split("+")
    source = open_data(job.root, name=job.root.name)
    work = job.out / "work" / target.stem
    for variant in missing:
        settings = BuildSettings(
            out=work / variant.name,
            hyper=replace(hyper, multi_round=variant.multi_round, scored=variant.scored),
            prior=build_trajectory_model("near" if told else "paper", samples=None if told else "stored"),
            seed=job.seed,
            executor=LocalProcesses(1),
        )
        shutil.rmtree(settings.out, ignore_errors=True)
        result[variant.name] = search(source, settings)
    shutil.rmtree(work)
    target.write_text(json.dumps(result))


def pool(results: Sequence[Mapping[str, Any]], variant: str, planner: str) -> tuple[float, float]:
    """Contacts with the adversary, mean of the horizons: per cent of kept and of all tried."""
    scenes = [scene[planner] for result in results for scene in result[variant]["scenes"].values()]
    hits, samples = sum(sum(scene[1:]) / 3 for scene in scenes), sum(scene[0] for scene in scenes)
    tried = PLANNERS[planner] * sum(result[variant]["samples"] for result in results)
    return 100 * hits / samples if samples else float("nan"), 100 * hits / tried


def share_near(scenes: Sequence[Mapping[str, Sequence[float]]]) -> tuple[float, float]:
    """Per cent of samples with the adversary within 2 and 5 m."""
    samples = sum(scene["near"][0] for scene in scenes)
    within = [100 * sum(scene["near"][place] for scene in scenes) / samples for place in (1, 2)]
    return within[0], within[1]


def format_table(rows: Sequence[str], seeds: Sequence[int], out: Path) -> str:
    """A line for each row, over all seeds, and what all of them cost."""
    lines = [
        "| reading | kept | 2, 5 m | nearest tenth | noisy-log | constant-velocity | of tried |",
        "|---|--:|--:|--:|--:|--:|---|",
    ]
    seconds = 0.0
    for row in rows:
        results = [json.loads((out / f"{row}-{seed}.json").read_text()) for seed in seeds]
        seconds += sum(found["search_s"] for result in results for found in result.values())
        full = [result["full"] for result in results]
        kept, tried = (sum(found[name] for found in full) for name in ("kept", "tried"))
        scenes = sorted(
            (scene for found in full for scene in found["scenes"].values()), key=lambda scene: float(scene["near"][3])
        )
        chosen = scenes[: round(SELECTED * tried)]
        hits = [pool(results, "full", planner)[0] for planner in PLANNERS]
        order = [
            " ".join(f"{pool(results, name, planner)[1]:.2f}" for name in ("full", "no-mtr", "no-mtr-no-ts", "no-ts"))
            for planner in PLANNERS
            if all(len(result) == len(VARIANTS) for result in results)
        ]
        cells = [
            row.replace("+", " + "),
            f"{kept} of {tried}",
            *(", ".join(f"{share:.0f}" for share in share_near(some)) if some else "-" for some in (scenes, chosen)),
            *(f"{hit:.2f}" if scenes else "-" for hit in hits),
            "; ".join(order),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", f"{seconds / 3600:.1f} CPU hours of searches.", ""])


def main() -> None:
    """Run the rows that are missing, then print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rows", default=",".join(READINGS))
    parser.add_argument("--seeds", default="0,1")
    parser.add_argument("--vehicles", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--full-only", action="store_true", help="leave the ablation out")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows, seeds = given.rows.split(","), [int(seed) for seed in given.seeds.split(",")]
    variants = VARIANTS[:1] if given.full_only else VARIANTS
    jobs = [Job(row, seed, given.data, given.out, given.vehicles, variants) for row in rows for seed in seeds]
    with ProcessPoolExecutor(given.workers) as processes:
        for _ in processes.map(run, jobs):
            pass
    print(format_table(rows, seeds, given.out))


if __name__ == "__main__":
    main()
