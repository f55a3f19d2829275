"""Runs of planners that never were: plans by formulas, collisions judged by ``exact`` for real."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.constants import FRAMES_PER_KEYFRAME, LIDAR_FROM_REAR_AXLE_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.fairness.plan_severity import measure_plan_severities
from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.machine.storage import content_key, content_seed
from benchmark.metrics.disagreement import MISS
from benchmark.pdm.totals import DrivenPlan
from benchmark.planning import Command, PlanFrame
from benchmark.protocols import PROTOCOLS, STANDARD, ProtocolOutcomes
from benchmark.records.row_schema import DiagnosisRow, ForecastRow, OutcomeRow, PlanRow, SampleRow
from benchmark.records.run import write_record
from benchmark.records.run_schema import DataFacts, SceneFacts
from benchmark.records.scene_assessment import AssessmentSummary
from benchmark.truth import SampleTruth
from tests.benchmark.metrics.made_attacks import judged
from tests.leaderboard.site.made_scenes import MadeScene

NEAR_M = 30.0
"""Others farther from the ego than this are left out of the truth."""
VERSIONS = {name: PROTOCOLS[name].version for name in STANDARD}
CAUSES_OF_FORECASTERS = (("misforecast", "plan clear of forecast"), ("misplanned", "plan hits forecast"))
_EXTRA_STEPS = {"uniad": 3, "vad": 3, "vad-23": 3, "sparsedrive": 2, "diffusiondrive": 2}


@dataclass(frozen=True, slots=True)
class MadePlanner:
    """A planner and its habits."""

    name: str
    native: str | None
    privileged: bool
    frame: PlanFrame
    alertness: float
    unsteadiness_m: float
    forecasts: bool
    failing: float = 0.0


@dataclass(frozen=True, slots=True)
class SceneTruth:
    """A scene as protocols see it: sample by sample, in the lidar's frame."""

    scene: MadeScene
    truths: tuple[SampleTruth, ...]
    lidar: Floats


def truth_of(scene: MadeScene) -> SceneTruth:
    """What happens around every sample of a scene."""
    keyframes, others = np.array(scene.keyframes), scene.others
    axle = scene.on_plane(scene.ego_s_m[keyframes])
    lidar = _ahead(axle)
    places = scene.on_plane(others.s_m[:, keyframes], others.d_m[:, keyframes])
    places[..., 2] += others.turned_rad[:, None]
    there = keyframes[None] >= np.array(others.first)[:, None]
    truths = [_sample(scene, index, lidar, places, there) for index in range(len(keyframes))]
    return SceneTruth(scene, tuple(truths), lidar)


def _sample(scene: MadeScene, index: int, lidar: Floats, places: Floats, there: Bools) -> SampleTruth:
    steps = np.arange(index, index + PLAN_STEPS + 1)
    valid = steps < len(lidar)
    window = np.minimum(steps, len(lidar) - 1)
    near = np.hypot(*(places[:, window, :2] - lidar[window, :2]).T).min(axis=0) < NEAR_M
    annotated = there[:, window] & valid
    near &= annotated.any(axis=1)
    size = np.broadcast_to(scene.others.size_m[near, None, :2], (int(near.sum()), PLAN_STEPS + 1, 2))
    seen = in_lidar_frame(places[near][:, window], lidar[index])
    frame = scene.keyframes[index]
    return SampleTruth(
        scene=scene.name,
        sample_token=scene.sample_token(frame),
        index=index,
        timestamp_us=scene.time_us(frame),
        lidar_pose=lidar[index] + [*scene.origin_m, 0.0],
        lidar_ahead_m=LIDAR_FROM_REAR_AXLE_M,
        ego_future=in_lidar_frame(lidar[window[1:]], lidar[index]),
        ego_future_valid=valid[1:],
        command=Command.STRAIGHT,
        instances=tuple(scene.agent(int(row)) for row in np.flatnonzero(near)),
        categories=tuple(scene.others.categories[row] for row in np.flatnonzero(near)),
        boxes=np.concatenate([seen[..., :2], size, seen[..., 2:]], axis=-1),
        annotated=annotated[near],
        has_points=annotated[near],
        has_lidar_points=annotated[near],
        adversaries=frozenset({scene.agent(len(scene.others.categories) - 1)} if scene.manoeuvre is not None else ()),
    )


def in_lidar_frame(places: Floats, lidar: Floats) -> Floats:
    """(..., 3) poses as seen from poses of a lidar: x right, y forward; straight ahead is pi/2."""
    offset, yaw = places[..., :2] - lidar[..., :2], lidar[..., 2]
    right = offset[..., 0] * np.sin(yaw) - offset[..., 1] * np.cos(yaw)
    forward = offset[..., 0] * np.cos(yaw) + offset[..., 1] * np.sin(yaw)
    return np.stack([right, forward, wrap_angle(places[..., 2] - yaw + np.pi / 2)], axis=-1)


def _ahead(axle: Floats) -> Floats:
    heading = np.stack([np.cos(axle[..., 2]), np.sin(axle[..., 2]), np.zeros_like(axle[..., 2])], axis=-1)
    return np.asarray(axle + LIDAR_FROM_REAR_AXLE_M * heading)


def run(
    folder: Path, planner: MadePlanner, data: DataFacts, split: str, truths: Sequence[SceneTruth], *, seed: int
) -> None:
    """Write the record of a planner on a split."""
    rows = [row for found in truths for row in _rows(planner, found, seed)]
    scenes = [found.scene for found in truths]
    facts: dict[str, Any] = {
        "planner": {
            "name": planner.name,
            "privileged": planner.privileged,
            "weights_sha256": content_key("weights", planner.name) if planner.forecasts else None,
            "code_sha256": content_key("code", planner.name),
            "settings": {"alertness": planner.alertness},
            "seed": 0,
            "native_protocol": planner.native,
        },
        "data": data,
        "split": split,
        "scenes": [scene.name for scene in scenes],
        "scenes_in_split": len(scenes),
        "scene_facts": {
            scene.name: SceneFacts(
                source=scene.source,
                manoeuvre=scene.manoeuvre,
                adversaries=int(scene.manoeuvre is not None),
                judgement=None if scene.manoeuvre is None else _judgement(place),
            )
            for place, scene in enumerate(scenes)
        },
        "config": {"protocols": list(VERSIONS), "seed": 0},
        "environment": {
            "hardware": {"cpu": "made up"},
            "packages": {"challenger-bench": "0.1.0"},
            "source": {"commit": None, "dirty": None},
        },
    }
    write_record(folder, facts, rows, VERSIONS, seed=0)


def _judgement(place: int) -> AssessmentSummary | None:
    """Every fourth adversarial scene is not judged; of the others the careful human survives every second."""
    said = None if place % 4 == 3 else judged(place % 2 == 0)
    return None if said is None else said.model_copy(update={"least_ttc_s": 6.0 - 0.25 * place})


def _rows(planner: MadePlanner, found: SceneTruth, seed: int) -> list[SampleRow]:
    rng = np.random.default_rng(content_seed("made plans", planner.name, found.scene.name, seed))
    axle = _plans(planner, found.scene, rng)
    lidar = in_lidar_frame(_ahead(axle), found.lidar[:, None])[..., :2]
    waypoints = lidar
    if planner.frame is PlanFrame.EGO:
        seen = in_lidar_frame(axle, found.scene.on_plane(found.scene.ego_s_m[np.array(found.scene.keyframes)])[:, None])
        waypoints = np.stack([seen[..., 1], -seen[..., 0]], axis=-1)
    raises = rng.random(len(axle)) < planner.failing
    exact = PROTOCOLS["exact"].evaluate(found.truths, lidar)
    outcomes = {"exact": exact} | {name: _official(name, exact, rng) for name in VERSIONS if name != "exact"}
    by_protocol = {name: each.as_rows() for name, each in outcomes.items()}
    severe = measure_plan_severities(found.truths, lidar)
    rows = []
    for index, truth in enumerate(found.truths):
        verdicts = {name: OutcomeRow(**each[index]) for name, each in by_protocol.items()}
        given = _as_given(planner, waypoints[index], truth)
        row = _row(truth, None if raises[index] else given, verdicts, planner, rng)
        rows.append(row if raises[index] else row.model_copy(update={"severity": severe[index]}))
    return rows


def _plans(planner: MadePlanner, scene: MadeScene, rng: np.random.Generator) -> Floats:
    """(S, 6, 3) poses of the rear axle: between driving on as before and what the recorded ego did."""
    keyframes = np.array(scene.keyframes)
    s = scene.ego_s_m[keyframes]
    speed = np.gradient(scene.ego_s_m)[keyframes] * 12.0
    ahead_s = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    recorded = np.interp(
        keyframes[:, None] + FRAMES_PER_KEYFRAME * np.arange(1, PLAN_STEPS + 1),
        np.arange(scene.frames),
        scene.ego_s_m,
    )
    beyond = keyframes[:, None] + FRAMES_PER_KEYFRAME * np.arange(1, PLAN_STEPS + 1) >= scene.frames
    onwards = s[:, None] + speed[:, None] * ahead_s * (1 + 0.05 * rng.standard_normal((len(s), 1)))
    along = np.where(beyond, onwards, planner.alertness * recorded + (1 - planner.alertness) * onwards)
    sideways = planner.unsteadiness_m * rng.standard_normal((len(s), 1)) * (ahead_s / 3.0) ** 2
    return scene.on_plane(along, sideways)


def _official(name: str, exact: ProtocolOutcomes, rng: np.random.Generator) -> ProtocolOutcomes:
    """Contacts at the waypoints, some of them missed, never one invented."""
    at_waypoints = exact.step("waypoint_collision").astype(np.bool_)
    seen = at_waypoints & (rng.random((len(exact), 1)) > 0.2)
    names = ("before_mask", "recorded", "obj_col")[: _EXTRA_STEPS[name]]
    columns = {"before_mask": seen, "recorded": np.zeros_like(seen), "obj_col": seen}
    counted = exact.valid.any(axis=1) if PROTOCOLS[name].counts_incomplete else exact.counted
    return ProtocolOutcomes(
        collision=seen, l2=exact.l2, valid=exact.valid, counted=counted, steps={each: columns[each] for each in names}
    )


def _as_given(planner: MadePlanner, waypoints: Floats, truth: SampleTruth) -> PlanRow:
    """The plan in the planner's own frame, with what it thinks of the others."""
    if not planner.forecasts:
        return PlanRow(frame=planner.frame.value, waypoints=np.round(waypoints, 4).tolist())
    modes = np.stack([waypoints, waypoints * 0.8, waypoints * [1.0, 1.15]])
    return PlanRow(
        frame=planner.frame.value,
        waypoints=np.round(waypoints, 4).tolist(),
        modes=np.round(modes, 3).tolist(),
        mode_scores=[0.6, 0.3, 0.1],
        forecasts=_forecasts(truth, planner.frame),
    )


def _forecasts(truth: SampleTruth, frame: PlanFrame) -> ForecastRow:
    """Everybody goes on as in the first half second."""
    boxes = truth.boxes[-5:]
    if frame is PlanFrame.EGO:
        x, y, length, width, yaw = np.moveaxis(boxes, -1, 0)
        boxes = np.stack([y + truth.lidar_ahead_m, -x, length, width, yaw - np.pi / 2], axis=-1)
    step = boxes[:, 1, :2] - boxes[:, 0, :2]
    ahead = np.arange(1, PLAN_STEPS + 1)[None, :, None]
    ways = boxes[:, 0, None, :2] + step[:, None] * ahead
    return ForecastRow(
        boxes=np.round(boxes[:, 0], 3).tolist(),
        trajectories=np.round(np.stack([ways, 0.9 * ways], axis=1), 3).tolist(),
        scores=[[0.7, 0.3]] * len(boxes),
    )


def _row(
    truth: SampleTruth,
    plan: PlanRow | None,
    judged: dict[str, OutcomeRow],
    planner: MadePlanner,
    rng: np.random.Generator,
) -> SampleRow:
    exact, diagnosis = judged["exact"], None
    if plan is not None and exact.facts["hit"] is not None:
        known = CAUSES_OF_FORECASTERS[int(rng.random() < 0.4)]
        cause, reason = known if planner.forecasts else ("not attributable", "no forecasts")
        touched = {name: exact.facts[name] for name in ("hit", "first_contact_s")}
        diagnosis = DiagnosisRow.model_validate({"cause": cause, "reason": reason, **touched})
    differing = {
        name: f"{MISS}: between waypoints"
        for name, outcome in judged.items()
        if exact.counted and outcome.counted and any(outcome.collision or ()) != any(exact.collision or ())
    }
    future = [
        [float(x), float(y), float(yaw)] if valid else None
        for (x, y, yaw), valid in zip(truth.ego_future, truth.ego_future_valid)
    ]
    return SampleRow(
        scene=truth.scene,
        sample_token=truth.sample_token,
        index=truth.index,
        timestamp_us=truth.timestamp_us,
        status="failed" if plan is None else "ok",
        command=int(truth.command),
        ego_motion="derived",
        lidar_ahead_m=truth.lidar_ahead_m,
        complete=truth.complete,
        recorded_future=future,
        plan=plan,
        error="Traceback: <b>out of memory</b>" if plan is None else None,
        outcomes={} if plan is None else judged,
        diagnosis=diagnosis,
        disagreements={} if plan is None else differing,
        driving=_driving(truth, planner) if plan is not None and truth.complete else None,
    )


def _driving(truth: SampleTruth, planner: MadePlanner) -> DrivenPlan:
    """Sub-scores by chance, better for the alert."""
    rng = np.random.default_rng(content_seed("driving", truth.sample_token, planner.name))
    passed = (rng.random(8) < 0.6 + 0.4 * planner.alertness).astype(float).tolist()
    nc, dac, ddc, ttc, lk, hc, ec, _ = passed
    return DrivenPlan(
        nc=nc,
        dac=dac,
        ddc=ddc,
        ep=round(float(rng.uniform(0.5, 1.0)), 6),
        ttc=ttc,
        lk=lk,
        hc=hc if truth.index >= 3 else None,
        ec=ec if truth.index else None,
        forgiven=[],
        progress_m=20.0,
        recorded_progress_m=22.0,
        collision_s=None if nc else 1.5,
        ttc_s=None if ttc else 0.5,
    )
