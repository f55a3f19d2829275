"""Planning frames of one adversary, and the discard rules of the reference code: bad score or place, never contact."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel, SimulatedMotion, VehicleState, compute_rear_axle, simulate
from benchmark.geometry import Floats, boxes_overlap, to_local, wrap_angle
from benchmark.records.attempts import PlanningFrame
from benchmark.records.scene_pages import TraceFrame
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.labels.manoeuvres import Manoeuvre
from generation.search.driven_tracks import DrivenTracks
from generation.search.hyperparameters import DiscardRules, ExecutionModel, HyperParameters, ScoreDefinition
from generation.search.manoeuvre_requests import ManoeuvreRequest
from generation.search.proposals import Diversify, SearchSteps
from generation.search.recorded_motion import compute_initial_state, is_in_canvas
from generation.search.reference_scoring import (
    SPEED_FRAMES,
    STEP_FRAMES,
    build_reference_surroundings,
    compute_reference_previous,
    compute_reference_state,
    compute_reference_terms,
    is_challenge_on,
)
from generation.search.refinement import EvaluatedBatch, Refinement, ResamplingUnderflowError, build_trace_frame, refine
from generation.search.scoring import ScoreTerms, ScoringSurroundings, build_surroundings, compute_score_terms
from generation.search.threat import build_threat_rating
from generation.search.verify import EGO, DiscardReason, VerificationFailure, find_contacts

WORST_SCORE: Final = 7.0
"""A scene in which the best candidate of any planning frame scores higher is dropped."""
FARTHEST_M: Final = 50.0
"""From the ego's rear axle, along either axis of the map."""


def find_score_failure(best_score: float, frame: int) -> VerificationFailure | None:
    """Why the reference code drops a scene after a planning frame: its best candidate is too bad."""
    if best_score <= WORST_SCORE:
        return None
    return VerificationFailure(
        DiscardReason.SCORES_TOO_HIGH, frame, quantity="best score", value=best_score, limit=WORST_SCORE
    )


def find_distance_failure(scene: Scene, centers: Floats, first: int) -> VerificationFailure | None:
    """Why the reference code drops a scene for where its adversary was: 50 m from the ego along an axis of the map.

    (F, 2) ``centers`` of the adversary begin at frame ``first``; the scene's last frame is not looked at.
    """
    last = len(scene.timestamps_us) - 1
    offset = np.abs(centers[: last - first] - scene.ego.pose[first : first + len(centers)][: last - first, :2])
    out = np.flatnonzero((offset > FARTHEST_M).any(axis=1))
    return VerificationFailure(DiscardReason.LEAVES_AREA, first + int(out[0])) if len(out) else None


@dataclass(frozen=True, slots=True)
class PlannedTrack:
    """(F, 3) executed poses of an adversary from the launch on, how they were planned, and why the rest was not.

    ``driven`` are tracks of an ego that reacted, ``pressure`` how much it was pressed.
    """

    poses: Floats
    plans: tuple[PlanningFrame, ...]
    rounds: tuple[TraceFrame, ...]
    failure: VerificationFailure | None
    driven: DrivenTracks | None = None
    pressure: float = 0.0


@dataclass(frozen=True, slots=True)
class AdversaryPlanning:
    """Planning frames of one adversary, one after the other; contact with an ego that answers is no failure.

    ``stages`` collects seconds of physics and scoring. ``road_around`` is the (3,) pose around which the road is looked
    at, by default the ego's at each planning frame.
    """

    ego_answers: ClassVar[bool] = False

    scene: Scene
    agent: int
    start: int
    hyper: HyperParameters
    diversify: Diversify
    model: MotionModel
    rng: np.random.Generator
    stages: dict[str, float]
    keep_rounds: bool = False
    asked: Manoeuvre | None = None
    road_around: Floats | None = None

    def run(self) -> SearchSteps[PlannedTrack]:
        """Plan and execute to the end of the scene, or to where there is no use in going on."""
        track = [self.find_first_pose()[None]]
        state = self.compute_first_state()
        plans: list[PlanningFrame] = []
        rounds: list[TraceFrame] = []
        finding: VerificationFailure | None = None
        for frame in range(self.start, len(self.scene.timestamps_us) - 1, self.hyper.executed_frames):
            try:
                refinement = yield from self.plan(frame, state, np.concatenate(track))
            except ResamplingUnderflowError:
                finding = VerificationFailure(DiscardReason.NOTHING_TO_DRAW, frame)
                break
            steps = min(self.hyper.executed_frames, len(self.scene.timestamps_us) - 1 - frame)
            executed = refinement.motion.center[refinement.chosen, 1 : steps + 1]
            plans.append(build_planning_frame(frame, refinement))
            finding = self.find_failure(frame, executed, refinement.score)
            if finding is None or finding.reason is DiscardReason.LEAVES_AREA:
                track.append(executed)
            if finding is not None:
                break
            if self.keep_rounds:
                rounds.append(
                    build_trace_frame(self.scene, self.agent, frame, state, refinement, self.hyper, self.model)
                )
            state = self._compute_next_state(refinement, steps, np.concatenate(track))
        return PlannedTrack(np.concatenate(track), tuple(plans), tuple(rounds), finding)

    def find_first_pose(self) -> Floats:
        """Pose (3,) of the box centre at the hand-over."""
        return self._find_recorded_pose(self.start)

    def compute_first_state(self) -> VehicleState:
        """Motion at the hand-over."""
        if self.hyper.motion is ExecutionModel.REFERENCE:
            return self._compute_state_from_positions(self.start, self._find_recorded_pose(self.start)[None])
        return compute_initial_state(self.scene, self.agent, self.start, self.model.limits)

    def _compute_next_state(self, refinement: Refinement, steps: int, track: Floats) -> VehicleState:
        """Motion at the next planning frame: of the executed candidate, or what two positions say."""
        if self.hyper.motion is ExecutionModel.REFERENCE:
            return self._compute_state_from_positions(self.start + len(track) - 1, track)
        return refinement.motion.state(refinement.chosen, steps)

    def _compute_state_from_positions(self, frame: int, track: Floats) -> VehicleState:
        now, before = self._find_pose(frame, track), self._find_pose(frame - SPEED_FRAMES, track)
        return compute_reference_state(before, now, float(self.scene.agents.size[self.agent, 0]))

    def find_failure(self, frame: int, executed: Floats, score: float) -> VerificationFailure | None:
        """Why there is no use in going on after executing (F, 3) poses from the frame after ``frame`` on."""
        if not np.isfinite(executed).all():
            return VerificationFailure(DiscardReason.NO_SAFE_CANDIDATE, frame)
        if self.hyper.discards is DiscardRules.REFERENCE:
            score_failure = find_score_failure(score, frame) if self.hyper.scored else None
            return score_failure or find_distance_failure(self.scene, executed[:, :2], frame + 1)
        touched = self._touched(frame, executed) if self.hyper.scored else None
        if touched is not None:
            return VerificationFailure(DiscardReason.NO_SAFE_CANDIDATE, frame, touched)
        inside = is_in_canvas(self.scene, executed[:, :2], self.hyper.half_extent_m, first=frame + 1)
        return (
            None if inside.all() else VerificationFailure(DiscardReason.LEAVES_AREA, frame + 1 + int(np.argmin(inside)))
        )

    def plan(self, frame: int, state: VehicleState, track: Floats) -> SearchSteps[Refinement]:
        """Search one planning frame; arguments as of `evaluation`."""
        evaluate, previous = self.build_evaluation(frame, state, track), self._find_previous_pose(frame, state, track)
        return (yield from refine(self.diversify, evaluate, previous, self.hyper, self.rng))

    def build_evaluation(self, frame: int, state: VehicleState, track: Floats) -> Callable[[Floats], EvaluatedBatch]:
        """Function that simulates and scores (B, 16, 3) waypoints at a planning frame.

        ``track`` holds the (F, 3) executed poses of the box centre from the launch to ``frame``.
        """
        offsets = self.offsets(frame)
        steps = max(offsets[-1], min(self.hyper.executed_frames, len(self.scene.timestamps_us) - 1 - frame))
        rate = self.build_rating(frame, offsets, track)
        length = float(self.scene.agents.size[self.agent, 0])

        def evaluate(waypoints: Floats) -> EvaluatedBatch:
            begun = time.process_time()
            motion = simulate(waypoints, state, length, steps=steps, model=self.model)
            simulated = time.process_time()
            terms = rate(motion)
            self.stages["physics"] += simulated - begun
            self.stages["scoring"] += time.process_time() - simulated
            return EvaluatedBatch(motion, terms)

        return evaluate

    def offsets(self, frame: int) -> tuple[int, ...]:
        """Frames after a planning frame that are scored."""
        left = len(self.scene.timestamps_us) - 1 - frame
        # If less than a timestep is left, the scene's last frame is used.
        return tuple(offset for offset in self.hyper.scored_frames if offset <= left) or (left,)

    def build_rating(
        self, frame: int, offsets: tuple[int, ...], track: Floats
    ) -> Callable[[SimulatedMotion], ScoreTerms]:
        """Function that rates the motion of candidates at a planning frame."""
        raster = self._build_raster(frame)
        frames = tuple(frame + offset for offset in offsets)
        size = self.scene.agents.size[self.agent, :2]
        if self.hyper.score is ScoreDefinition.REFERENCE:
            reference_around = build_reference_surroundings(self.scene, self.agent, frames, raster)
            on = is_challenge_on(self._compute_distances(frame, track), self.start, frame, self.rng)
            return lambda motion: compute_reference_terms(
                motion.center[:, offsets], size, reference_around, challenged=on
            )
        around = self.around(frames, raster)
        hyper = self.hyper if self.asked is None else self.hyper.where_asked()
        further = (
            build_threat_rating(self.scene, self.agent, frame, offsets, around, hyper) if hyper.threatens else None
        )
        missing = self._missing(frame, offsets, track)

        def rate(motion: SimulatedMotion) -> ScoreTerms:
            center, speed = motion.center[:, offsets], motion.states[:, offsets, 3]
            terms = compute_score_terms(center, size, around, hyper, speed=speed)
            if further is not None:
                terms = replace(terms, further=further(motion))
            return terms if missing is None else replace(terms, asked=missing(center, speed))

        return rate

    def around(self, frames: tuple[int, ...], raster: DrivableRaster) -> ScoringSurroundings:
        """Surroundings that candidates can hit at some frames."""
        return build_surroundings(self.scene, self.agent, frames, raster, raster_ego=self.hyper.raster_ego)

    def _build_raster(self, frame: int) -> DrivableRaster:
        pose = self.road_around
        if pose is None:
            pose = self.scene.ego.pose[frame]
            pose[:2] += self.scene.lidar.translation[0] * np.array([np.cos(pose[2]), np.sin(pose[2])])
        return DrivableRaster.around(self.scene.road_map, pose, half_extent_m=self.hyper.half_extent_m)

    def _missing(
        self, frame: int, offsets: tuple[int, ...], track: Floats
    ) -> Callable[[Floats, Floats], Floats] | None:
        """Function that says how far candidates are from the manoeuvre; ``None`` if none is asked for or it is done."""
        if self.asked is None or self.hyper.manoeuvre_weight == 0.0:
            return None
        wish = ManoeuvreRequest(self.asked, self.scene, self.agent, self.start)
        return None if wish.is_fulfilled(track) else wish.at(frame, offsets, track)

    def _compute_distances(self, frame: int, track: Floats) -> Floats:
        """(F,) from its centre to the ego's rear axle, from the frame before the launch to ``frame``."""
        first = max(self.start - 1, 0)
        centers = np.stack([self._find_pose(at, track)[:2] for at in range(first, frame + 1)])
        return np.asarray(np.linalg.norm(centers - self.scene.ego.pose[first : frame + 1, :2], axis=1))

    def _find_previous_pose(self, frame: int, state: VehicleState, track: Floats) -> Floats:
        """Own rear-axle pose (3,) half a second ago in the local frame: recorded before the launch, executed after.

        The reference code takes the box centre four frames ago. A vehicle that was not there yet had its present speed.
        """
        if self.hyper.motion is ExecutionModel.REFERENCE:
            return compute_reference_previous(
                self._find_pose(frame - STEP_FRAMES, track), self._find_pose(frame, track)
            )
        past = frame - FRAMES_PER_KEYFRAME
        if past < self.start and not (past >= 0 and self.scene.agents.valid[self.agent, past]):
            return np.array([-state.speed * FRAMES_PER_KEYFRAME / FRAME_HZ, 0.0, 0.0])
        center = self._find_pose(past, track)
        axle = compute_rear_axle(center, float(self.scene.agents.size[self.agent, 0]))
        turn = wrap_angle(axle[2:] - state.pose[2])
        return np.concatenate([to_local(axle[:2], state.pose), turn])

    def _find_pose(self, frame: int, track: Floats) -> Floats:
        """Pose (3,) of the box centre: recorded before the launch, executed from then on."""
        return track[frame - self.start] if frame >= self.start else self._find_recorded_pose(frame)

    def _find_recorded_pose(self, frame: int) -> Floats:
        agents = self.scene.agents
        return np.array([*agents.position[self.agent, frame, :2], agents.yaw[self.agent, frame]])

    def _touched(self, frame: int, executed: Floats) -> str | None:
        frames = frame + 1 + np.arange(len(executed))
        size = np.broadcast_to(self.scene.agents.size[self.agent, :2], (len(executed), 2))
        boxes = np.column_stack([executed[:, :2], size, executed[:, 2]])
        if not self.ego_answers and boxes_overlap(boxes, self.scene.ego.boxes[frames]).any():
            return EGO
        _, other = find_contacts(boxes, self.scene, self.agent, frames)
        return self.scene.agents.ids[other[0]] if len(other) else None


def build_planning_frame(frame: int, refinement: Refinement) -> PlanningFrame:
    """Report on a planning frame."""

    def finite(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return PlanningFrame(
        frame=frame,
        round=refinement.round,
        score=finite(refinement.score),
        best_scores=tuple(finite(float(entry.scores.min())) for entry in refinement.rounds),
        collision_free=tuple(entry.collision_free for entry in refinement.rounds),
    )
