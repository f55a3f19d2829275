"""Scene scores of a golden set of AlpaSim's own evaluation: every time, every drive and whole runs, by both rules."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.alpasim_score.bodies import ContactSide
from benchmark.extensions.alpasim_score.scene_score import (
    CORRIDOR_M,
    JULY,
    SEPTEMBER,
    DriveMeasures,
    LoggedDrive,
    RuleSet,
    SceneScore,
    measure_drive,
    score_drive,
)
from benchmark.geometry import Bools, Floats, yaw_of_quaternion
from benchmark.metrics.rates import compute_ratios_over_scenes
from benchmark.untrusted.text_files import parse_json
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet, unpack_gzip

INPUTS: Final = "inputs.json.gz"
EXPECTED: Final = {"expected_main_2026-07.json.gz": JULY, "expected_challenge_2026-09.json.gz": SEPTEMBER}
TOLERANCE: Final = 2e-5
"""Theirs is partly in single precision."""
EGO: Final = "EGO"
PARTS: Final = {
    "dist_to_gt_trajectory": "from_path_m",
    "dist_traveled_m": "driven_m",
    "progress_clipped_rel": "progress",
    "collision_front": "front",
    "collision_rear": "rear",
    "collision_lateral": "lateral",
    "collision_at_fault": "at_fault",
    "offroad": "off_road",
    "offroad_or_collision": "incident",
    "offroad_or_collision_at_fault": "incident_at_fault",
}
"""Our names of values of a drive; those under September's rules alone are below."""
CORRIDOR_PARTS: Final = {"lateral_dist_to_gt_trajectory": "beside_path_m", "left_corridor_laterally": "corridor"}


def compare_scene_scores(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare values at each time, drives and runs of a set, under both rule sets."""
    scenes = {scene["name"]: scene for scene in _read(folder.path / INPUTS)}
    logs = {name: read_log(scene) for name, scene in scenes.items()}
    measured = {name: measure_drive(log) for name, log in logs.items()}
    for file, rules in EXPECTED.items():
        expected = _read(folder.path / file)
        scores = {name: _score(scenes[name], measures, rules) for name, measures in measured.items()}
        for scene in expected["scenes"]:
            name = scene["name"]
            here = comparison.at(name, f"{rules.name}: ")
            _compare_drive(here, scores[name], scene, rules)
            if (measures := measured[name]) is not None:
                _compare_times(here, measures, scene["per_time"], rules)
        for label, run in expected["runs"].items():
            _compare_run(comparison.at(label, f"{rules.name}: "), scores, run)


GOLDEN: Final = GoldenSet(
    name="alpasim score",
    files=("manifest.json", INPUTS, *EXPECTED),
    compare=(compare_scene_scores,),
    quantities={"*": TOLERANCE},
    built_in=Path(__file__).parent / "golden" / "score",
    usual="score",
)


def read_log(scene: Mapping[str, Any]) -> LoggedDrive:
    """The drive of a scene of the inputs, whose numbers are of single precision."""
    ego = scene["actors"][EGO]
    times = np.asarray(ego["t_us"], np.int64)
    tracks = [_read_track(actor, times) for name, actor in scene["actors"].items() if name != EGO]
    recorded = scene["recorded_rig"]
    return LoggedDrive(
        times_us=times,
        ego=_read_track(ego, times)[0],
        others=np.array([boxes for boxes, _ in tracks]).reshape(-1, len(times), 5),
        present=np.array([present for _, present in tracks], np.bool_).reshape(-1, len(times)),
        recorded_us=np.asarray(recorded["t_us"], np.int64),
        recorded=_place_centers(_singles(recorded["pose"]), _singles(scene["rig_to_aabb"])),
        scored_from_us=int(scene["render_start_us"]) + int(scene["force_gt_us"]),
        ends_us=int(times[-1]),
    )


def _score(scene: Mapping[str, Any], measures: DriveMeasures | None, rules: RuleSet) -> SceneScore | None:
    if measures is None:
        return None
    flags = (np.asarray(scene[name], np.bool_) for name in ("offroad", "picture_black"))
    return score_drive(measures, rules, *flags)


def _compare_drive(here: Comparison, ours: SceneScore | None, scene: Mapping[str, Any], rules: RuleSet) -> None:
    rows = scene.get("summary_rows", [])
    here.verdicts("drives with a score", (ours is not None) != bool(rows))
    if ours is None or not rows:
        return
    (row,) = rows
    here.numbers("score", ours.score, row["score"])
    here.verdicts("verdicts", [bool(ours.verdict) == row["passed"], ours.verdict != (row["failure_reason"] or "")])
    here.numbers("progress score", ours.progress_score, row["score_metrics"]["progress_score"])
    for theirs, name in {**PARTS, **(CORRIDOR_PARTS if rules.corridor_fails else {})}.items():
        value, golden = getattr(ours, name), row["metrics"][theirs]
        if isinstance(value, bool):
            here.verdicts(theirs, float(value) != golden)
        else:
            here.numbers(theirs, value, golden)


def _compare_times(here: Comparison, ours: DriveMeasures, golden: Mapping[str, Any], rules: RuleSet) -> None:
    numbers = {
        "progress": ours.way,
        "progress_rel_to_total": ours.way if rules.whole_way else ours.reachable_way,
        "dist_to_gt_trajectory": ours.from_path_m,
        "dist_traveled_m": ours.driven_m,
        "gt_dist_traveled_m": np.full_like(ours.way, ours.way_m),
    }
    verdicts = {f"collision_{side.name.lower()}": ours.sides == side for side in ContactSide if side}
    verdicts["collision_any"] = ours.sides > ContactSide.NONE
    if golden["eval_relevant"]["values"] and any(golden["eval_relevant"]["values"]):
        verdicts["eval_relevant"] = ours.relevant
    if rules.corridor_fails:
        numbers["lateral_dist_to_gt_trajectory"] = ours.beside_path_m
        verdicts["left_corridor_laterally"] = ours.beside_path_m >= CORRIDOR_M
    for name, values in numbers.items():
        here.numbers(f"{name} over time", values, golden[name]["values"])
    for name, flags in verdicts.items():
        here.same(f"{name} over time", flags, np.asarray(golden[name]["values"]) > 0.0)


def _compare_run(here: Comparison, scores: Mapping[str, SceneScore | None], run: Mapping[str, Any]) -> None:
    """Scores of all drives of a run, and its kilometres between incidents, which are means over its rollouts."""
    parts = [(clip, rollout, found) for name, clip, rollout in run["parts"] if (found := scores[name]) is not None]
    failed = {(clip, rollout or f"failed-{place}") for place, (clip, rollout, _) in enumerate(run["failed"])}
    golden = {(clip, rollout): (score, status == "pass") for clip, rollout, score, status, _ in run["scores"]}
    ours = {(clip, rollout): (found.score, not found.verdict) for clip, rollout, found in parts}
    ours |= dict.fromkeys(failed, (0.0, False))
    here.verdicts("drives of a run", sorted(ours) != sorted(golden))
    if ours.keys() == golden.keys():
        here.numbers("scores of a run", [ours[key][0] for key in golden], [score for score, _ in golden.values()])
        here.verdicts("verdicts of a run", [ours[key][1] != passed for key, (_, passed) in golden.items()])
    (means,) = run["metrics_results"]
    for end, name in (("", "incident"), ("_at_fault", "incident_at_fault")):
        by_rollout = {
            rollout: [(found.driven_m / 1000.0, getattr(found, name)) for _, own, found in parts if own == rollout]
            for rollout in sorted({rollout for _, rollout, _ in parts})
        }
        between = [compute_km_between(drives) for drives in by_rollout.values()]
        theirs = means[f"avg_dist_between_incidents{end}"]
        known = [value for value in between if value is not None]
        here.verdicts(f"incidents{end} in a run", (len(known) == len(between)) != (theirs is not None))
        if theirs is not None and len(known) == len(between):
            here.numbers(f"km between incidents{end}", np.mean(known), theirs)


def compute_km_between(drives: Sequence[tuple[float, bool]]) -> float | None:
    """Kilometres driven for each incident, of drives with their kilometres; ``None`` without an incident."""
    values, incidents = (np.array([[drive[place]] for drive in drives], np.float64) for place in range(2))
    (rate,) = compute_ratios_over_scenes(values, incidents, [str(place) for place in range(len(drives))], seed=0)
    return rate.value


def _read_track(actor: Mapping[str, Any], times: NDArray[np.int64]) -> tuple[Floats, Bools]:
    """(T, 5) boxes of an actor at times, and whether it is there; between its poses linear and by the shorter turn."""
    own, pose = np.asarray(actor["t_us"], np.int64), _singles(actor["pose"])
    place = np.column_stack([np.interp(times, own, pose[:, axis]) for axis in range(2)])
    yaw = np.interp(times, own, np.unwrap(yaw_of_quaternion(pose[:, 3:])))
    size = np.broadcast_to(_singles(actor["size"])[:2], place.shape)
    return np.column_stack([place, size, yaw]), (times >= own[0]) & (times <= own[-1])


def _place_centers(rig: Floats, to_box: Floats) -> Floats:
    """(R, 2) centres of boxes whose pose in (R, 7) rigs is (7,)."""
    w, xyz, offset = rig[:, 3:4], rig[:, 4:], to_box[:3]
    turned = offset + 2.0 * np.cross(xyz, np.cross(xyz, offset) + w * offset)
    return np.asarray((rig[:, :3] + turned)[:, :2], np.float32).astype(np.float64)


def _singles(values: Any) -> Floats:
    return np.asarray(values, np.float32).astype(np.float64)


def _read(path: Path) -> Any:
    return parse_json(unpack_gzip(path))
