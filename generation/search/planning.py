"""The planning frames of one adversary: searched one after the other, the best candidate executed up to the next."""

import time
from dataclasses import dataclass

import numpy as np

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel, VehicleState, rear_axle, simulate
from benchmark.geometry import Floats, boxes_overlap, to_local, wrap_angle
from benchmark.records.attempts import PlanningFrame
from benchmark.records.scenes import TraceFrame
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.search.candidates import in_canvas, initial_state
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Diversify, SearchSteps
from generation.search.refinement import Evaluated, NothingToDraw, Refinement, refine
from generation.search.rounds import rounds_of
from generation.search.scoring import score_terms, surroundings
from generation.search.verify import EGO, Discard, Finding, contacts


@dataclass(frozen=True, slots=True)
class Driven:
    """What was planned and executed.

    Attributes:
        poses: (F, 3) executed poses from the launch on.
        plans: Trace, one entry per planning frame.
        rounds: Candidates and scores of the same frames, where they are kept.
        gave_up: Why the rest was not planned: what `verify` could only discard; ``None`` if nothing was left out.
    """

    poses: Floats
    plans: tuple[PlanningFrame, ...]
    rounds: tuple[TraceFrame, ...]
    gave_up: Finding | None


@dataclass(frozen=True, slots=True)
class Planning:
    """Planning frames of one adversary, one after the other.

    Attributes:
        scene: The scene that it is planned in.
        agent: Its index.
        start: Frame of the launch.
        hyper: Settings.
        diversify: Spread of the initial batch.
        model: Physics, with limits.
        rng: Source of every random number.
        stages: Seconds of physics and scoring are added here.
        keep_rounds: Whether the candidates of every round are kept; no result depends on it.
    """

    scene: Scene
    agent: int
    start: int
    hyper: HyperParameters
    diversify: Diversify
    model: MotionModel
    rng: np.random.Generator
    stages: dict[str, float]
    keep_rounds: bool = False

    def run(self) -> SearchSteps[Driven]:
        """Plan and execute to the end of the scene, or to where there is no use in going on."""
        assert self.model.limits is not None
        state = initial_state(self.scene, self.agent, self.start, self.model.limits)
        track = [self._recorded_pose(self.start)[None]]
        plans: list[PlanningFrame] = []
        rounds: list[TraceFrame] = []
        finding: Finding | None = None
        for frame in range(self.start, len(self.scene.timestamps_us) - 1, self.hyper.horizon):
            try:
                found = yield from self._plan(frame, state, np.concatenate(track))
            except NothingToDraw:
                finding = Finding(Discard.NOTHING_TO_DRAW, frame)
                break
            steps = min(self.hyper.horizon, len(self.scene.timestamps_us) - 1 - frame)
            executed = found.motion.center[found.chosen, 1 : steps + 1]
            plans.append(_trace(frame, found))
            finding = self._fault(frame, executed)
            if finding is None or finding.reason is Discard.LEAVES_AREA:
                track.append(executed)
            if finding is not None:
                break
            if self.keep_rounds:
                rounds.append(rounds_of(self.scene, self.agent, frame, state, found, self.hyper, self.model))
            state = found.motion.state(found.chosen, steps)
        return Driven(np.concatenate(track), tuple(plans), tuple(rounds), finding)

    def _fault(self, frame: int, executed: Floats) -> Finding | None:
        """Why there is no use in going on after executing (F, 3) poses from the frame after ``frame`` on."""
        if not np.isfinite(executed).all():
            return Finding(Discard.NO_SAFE_CANDIDATE, frame)
        touched = self._touched(frame, executed) if self.hyper.scored else None
        if touched is not None:
            return Finding(Discard.NO_SAFE_CANDIDATE, frame, touched)
        inside = in_canvas(self.scene, executed[:, :2], self.hyper.half_extent_m, first=frame + 1)
        return None if inside.all() else Finding(Discard.LEAVES_AREA, frame + 1 + int(np.argmin(inside)))

    def _plan(self, frame: int, state: VehicleState, track: Floats) -> SearchSteps[Refinement]:
        offsets = tuple(offset for offset in self.hyper.scored_frames if frame + offset < len(self.scene.timestamps_us))
        raster = _raster(self.scene, frame, self.hyper.half_extent_m)
        frames = tuple(frame + offset for offset in offsets)
        around = surroundings(self.scene, self.agent, frames, raster, raster_ego=self.hyper.raster_ego)
        size = self.scene.agents.size[self.agent, :2]
        previous = self._previous(frame, state, track)

        def evaluate(waypoints: Floats) -> Evaluated:
            begun = time.process_time()
            motion = simulate(waypoints, state, float(size[0]), steps=offsets[-1], model=self.model)
            simulated = time.process_time()
            terms = score_terms(motion.center[:, offsets], size, around, self.hyper, speed=motion.states[:, offsets, 3])
            self.stages["physics"] += simulated - begun
            self.stages["scoring"] += time.process_time() - simulated
            return Evaluated(motion, terms)

        return (yield from refine(self.diversify, evaluate, previous, self.hyper, self.rng))

    def _previous(self, frame: int, state: VehicleState, track: Floats) -> Floats:
        """Own rear-axle pose (3,) half a second ago in the local frame: recorded before the launch, executed after."""
        past = frame - FRAMES_PER_KEYFRAME
        center = track[past - self.start] if past >= self.start else self._recorded_pose(max(past, 0))
        axle = rear_axle(center, float(self.scene.agents.size[self.agent, 0]))
        turn = wrap_angle(axle[2:] - state.pose[2])
        return np.concatenate([to_local(axle[:2], state.pose), turn])

    def _recorded_pose(self, frame: int) -> Floats:
        agents = self.scene.agents
        return np.array([*agents.position[self.agent, frame, :2], agents.yaw[self.agent, frame]])

    def _touched(self, frame: int, executed: Floats) -> str | None:
        """Who is touched first, or ``None``."""
        frames = frame + 1 + np.arange(len(executed))
        size = np.broadcast_to(self.scene.agents.size[self.agent, :2], (len(executed), 2))
        boxes = np.column_stack([executed[:, :2], size, executed[:, 2]])
        if boxes_overlap(boxes, self.scene.ego.boxes[frames]).any():
            return EGO
        _, other = contacts(boxes, self.scene, self.agent, frames)
        return self.scene.agents.ids[other[0]] if len(other) else None


def _raster(scene: Scene, frame: int, half_extent_m: float) -> DrivableRaster:
    """Drivable area around the ego's lidar at a planning frame."""
    pose = scene.ego.pose[frame]
    pose[:2] += scene.lidar.translation[0] * np.array([np.cos(pose[2]), np.sin(pose[2])])
    return DrivableRaster.around(scene.road_map, pose, half_extent_m=half_extent_m)


def _trace(frame: int, found: Refinement) -> PlanningFrame:
    def finite(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return PlanningFrame(
        frame=frame,
        round=found.round,
        score=finite(found.score),
        best_scores=tuple(finite(float(entry.scores.min())) for entry in found.rounds),
        collision_free=tuple(entry.collision_free for entry in found.rounds),
    )
