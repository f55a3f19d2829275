"""A drive as a row of its record, and its plans beside what was recorded, where both speak of the same motion."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.adversary import AdversaryTrack, Replanning
from benchmark.closed_loop.episodes import Episode, EpisodeSpec
from benchmark.closed_loop.scoring import EpisodeScores
from benchmark.closed_loop.simulation_config import interpolate_recorded_poses
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import to_global, to_local, wrap_angle
from benchmark.planning import Plan
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.run_schema import TruthFacts
from benchmark.records.search_trace import SearchTraceFrame
from benchmark.scene import Scene
from benchmark.untrusted.plan_plausibility import ComparedPlans
from benchmark.waypoints import waypoints_in_lidar

NEAR_M: Final = 1.0
NEAR_RAD: Final = 0.1
NEAR_M_S: Final = 1.0
_JUST_NOW_US: Final = 100_000
_STEPS_US: Final = np.arange(PLAN_STEPS + 1, dtype=np.int64) * round(PLAN_STEP_S * 1e6)


def compare_drive(scene: Scene, row: EpisodeRow) -> ComparedPlans:
    """Plans of a drive that were made where the recorded car was, as fast as it was, with 3 s of recording ahead."""
    count = len(row.plans)
    if not count:
        return ComparedPlans.joined([])
    times, ego = np.array(row.ticks.time_us[:count], np.int64), np.array(row.ticks.ego[:count])
    poses, before = interpolate_recorded_poses(scene, times), interpolate_recorded_poses(scene, times - _JUST_NOW_US)
    speed = np.hypot(*(poses - before)[:, :2].T) / (_JUST_NOW_US * 1e-6)
    near = np.hypot(*(ego[:, :2] - poses[:, :2]).T) < NEAR_M
    near &= (np.abs(wrap_angle(ego[:, 2] - poses[:, 2])) < NEAR_RAD) & (np.abs(ego[:, 3] - speed) < NEAR_M_S)
    near &= times + _STEPS_US[-1] <= int(scene.timestamps_us[-1])
    ahead = np.array([float(scene.lidar.translation[0]), 0.0])
    lidar = interpolate_recorded_poses(scene, times[near, None] + _STEPS_US)
    lidar[..., :2] = to_global(ahead, lidar)
    forward = to_local(lidar[:, 1:, :2], lidar[:, :1])
    recorded = np.stack([-forward[..., 1], forward[..., 0]], axis=-1)
    plans = [
        waypoints_in_lidar(np.array(plan.waypoints[:PLAN_STEPS]), plan.frame, ahead[0])
        for plan, is_near in zip(row.plans, near.tolist(), strict=True)
        if is_near
    ]
    return ComparedPlans(np.array(plans).reshape(-1, PLAN_STEPS, 2), recorded)


DECIMALS: Final = 6
"""Of stored states and scores; plans are stored as they were given."""


def build_episode_row(stage: EpisodeSpec, drive: Episode, scores: EpisodeScores | None) -> EpisodeRow:
    """Row of a drive; a failed one has no scores."""
    motion, failure = drive.motion, drive.failure
    contact = None if scores is None or scores.contact is None else _rounded(asdict(scores.contact))
    return EpisodeRow.model_validate(
        {
            "scene": stage.scene.name,
            "family": stage.family,
            "run": stage.run,
            "status": "ok" if failure is None else "failed",
            "end": drive.end,
            "primed": drive.primed,
            "ticks": {
                "time_us": motion.times_us[motion.ticks].tolist(),
                "ego": np.round(motion.ego[motion.ticks], DECIMALS).tolist(),
                "command": [int(command) for command in drive.commands],
                "station": np.round(drive.stations, DECIMALS).tolist(),
            },
            "plans": [_encode_plan(plan) for plan in drive.plans],
            "contact": contact,
            "passed": [] if scores is None else [_rounded(asdict(collision)) for collision in scores.passed],
            "scores": None if scores is None else _score_row(drive, scores),
            "failure": None if failure is None else {"reason": failure.reason.value, "text": failure.text},
            "adversary": None if drive.adversary is None else encode_adversary_track(stage, drive.adversary),
            "window": None if drive.window is None else asdict(drive.window),
            "between": [[_encode_plan(plan) for plan in plans] for plans in drive.between],
            "notes": list(drive.notes),
            "terminated": drive.terminated,
            "ttc_s": [] if scores is None else [round(s, 2) + 0.0 if np.isfinite(s) else None for s in scores.ttc_s],
        }
    )


def _encode_plan(plan: Plan) -> dict[str, Any]:
    return {"frame": plan.frame.value, "waypoints": np.asarray(plan.waypoints, float).tolist()}


def mark_labelled(rows: Sequence[EpisodeRow], scenes: Mapping[str, TruthFacts]) -> list[EpisodeRow]:
    """Rows that say whether their scenes are labelled throughout."""
    missing = {name for name, truth in scenes.items() if truth.unlabelled}
    return [
        row if row.unlabelled == (row.scene in missing) else row.model_copy(update={"unlabelled": not row.unlabelled})
        for row in rows
    ]


def encode_adversary_track(stage: EpisodeSpec, track: AdversaryTrack) -> dict[str, Any]:
    """A track as it is stored in the row of its drive."""
    scores = [None if planning.score is None else round(planning.score, DECIMALS) + 0.0 for planning in track.replanned]
    return {
        "agent": track.agent,
        "uuid": stage.scene.agents.ids[track.agent],
        "start": track.start,
        "poses": track.poses.tolist(),
        "replanned": [planning.frame for planning in track.replanned],
        "scores": scores,
        "traffic": [
            {
                "agent": agent,
                "first": first,
                "poses": [None if np.isnan(pose).any() else pose for pose in poses.tolist()],
            }
            for agent, first, poses in track.traffic
        ],
    }


def build_search_trace(track: AdversaryTrack) -> tuple[SearchTraceFrame, ...]:
    """Candidates of an adversary at each of its planning frames, if it was asked to keep them."""
    return tuple(SearchTraceFrame.model_validate(planning.considered) for planning in track.replanned)


def decode_adversary_track(row: EpisodeRow) -> AdversaryTrack | None:
    """The stored track of a drive's adversary, with nothing of what was considered; ``None`` where there was none."""
    stored = row.adversary
    if stored is None:
        return None
    replanned = tuple(
        Replanning(frame, score, braked=score is None) for frame, score in zip(stored.replanned, stored.scores)
    )
    gone = [np.nan] * 3
    traffic = tuple(
        (driven.agent, driven.first, np.array([pose or gone for pose in driven.poses])) for driven in stored.traffic
    )
    return AdversaryTrack(stored.agent, stored.start, np.array(stored.poses).reshape(-1, 3), replanned, traffic)


def _score_row(drive: Episode, scores: EpisodeScores) -> dict[str, Any]:
    return _rounded(
        {
            "progress_m": scores.progress.metres,
            "recorded_progress_m": scores.progress.recorded_m,
            "route_share": scores.progress.share,
            "comfortable": scores.comfortable,
            "nuplan": None if scores.nuplan is None else asdict(scores.nuplan),
            "hd": None if scores.hd is None else asdict(scores.hd),
            "neuroncap": None if drive.neuroncap is None else asdict(drive.neuroncap),
            "further": scores.further,
        }
    )


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same with every number rounded; never -0.0."""
    rounded: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            rounded[name] = _rounded(value)
        elif isinstance(value, float):
            rounded[name] = round(value, DECIMALS) + 0.0
        else:
            rounded[name] = value
    return rounded
