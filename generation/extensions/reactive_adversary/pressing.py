"""Planning against an ego that reacts: every second, from where it really is, against the driver that it is.

A recorded ego must pass, so that nobody can get in its way. One that reacts may have to brake, and who does not is hit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from benchmark.constants import FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Floats, boxes_overlap, to_local
from benchmark.interactions.reaction import REACTION_S
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.careful_driver import (
    HIT_WEIGHT,
    CarefulDriverCheck,
    ReactivePlanning,
    compute_ego_speed_at,
)
from generation.extensions.reactive_adversary.driven_ego import DrivenWorld, get_undisturbed
from generation.search.planning import AdversaryPlanning, PlannedTrack, build_planning_frame
from generation.search.proposals import SearchSteps
from generation.search.refinement import ResamplingUnderflowError, build_trace_frame
from generation.search.scoring import ScoreTerms
from generation.search.verify import DiscardReason, VerificationFailure

EVERY_FRAMES: Final = 2 * FRAMES_PER_KEYFRAME
"""Between two plans."""
MEETING_WEIGHT: Final = 5.0
"""Of a candidate that an ego runs into that keeps its speed, and that the ego survives."""
MEETING_S: Final = (2.0, 5.0)
"""A meeting within so many seconds counts in full, a later one less, to none."""
HARDEST_M_S2: Final = 5.5
"""Braking that is counted on; the driver has a little more."""
LEAST_SPEED_M_S: Final = 1.0
LEAST_PRESSURE: Final = 0.02
"""A scene in which fewer plans of who keeps its speed are wrong is inert."""
HORIZON_STEPS: Final = (2, 4, 6)


@dataclass(frozen=True, slots=True)
class PressingPlanning(ReactivePlanning):
    """Planning frames of an adversary that the ego has to answer; ``scene`` has the recorded ego.

    ``reaction`` is the ego's at a planning frame (`DrivenWorld.reaction`).
    """

    ego_answers: ClassVar[bool] = True

    reaction: tuple[float, float] = (REACTION_S, 0.0)

    def run(self) -> SearchSteps[PlannedTrack]:
        """Plan, execute and let the ego answer, to the end of the scene or to where there is no use in going on."""
        world = DrivenWorld.of(self.scene, self.hyper.ego, self.agent)
        poses, state = self.find_first_pose()[None], self.compute_first_state()
        plans, rounds, last = [], [], len(self.scene.timestamps_us) - 1
        world.advance(self.start)
        frame = self.start
        while frame < last:
            here = replace(self, scene=world.expect(), reaction=world.reaction)
            try:
                refinement = yield from here.plan(frame, state, poses)
            except ResamplingUnderflowError:
                return _give_up(poses, VerificationFailure(DiscardReason.NOTHING_TO_DRAW, frame))
            steps = min(EVERY_FRAMES, last - frame)
            executed = refinement.motion.center[refinement.chosen, 1 : steps + 1]
            plans.append(build_planning_frame(frame, refinement))
            failure = here.find_failure(frame, executed, refinement.score)
            if failure is not None:
                return _give_up(poses, failure)
            if self.keep_rounds:
                rounds.append(
                    build_trace_frame(here.scene, self.agent, frame, state, refinement, self.hyper, self.model)
                )
            poses, state = np.concatenate([poses, executed]), refinement.motion.state(refinement.chosen, steps)
            frame += steps
            world.advance(frame, self.start, poses)
            if world.contact is not None:
                break
        planned = PlannedTrack(poses, tuple(plans), tuple(rounds), None)
        drive = world.finish(self.start, poses)
        failure = drive.find_failure(self.scene)
        if failure is None and not drive.has_reacted(get_undisturbed(self.scene, self.hyper.ego)):
            failure = VerificationFailure(DiscardReason.EGO_INERT)
        if failure is not None:
            return replace(planned, failure=failure)
        scene = drive.tracks.put_into(self.scene).with_adversary(
            self.agent, slice(self.start, self.start + len(poses)), poses
        )
        pressure = measure_pressure(scene, self.agent, self.start)
        if pressure < LEAST_PRESSURE:
            return replace(planned, failure=VerificationFailure(DiscardReason.EGO_INERT))
        return replace(planned, driven=drive.tracks, pressure=pressure)

    def build_rating(
        self, frame: int, offsets: tuple[int, ...], track: Floats
    ) -> Callable[[SimulatedMotion], ScoreTerms]:
        """As against a recorded ego, and what the ego cannot answer costs; what it has to answer pays."""
        rate = AdversaryPlanning.build_rating(self, frame, offsets, track)
        waiting, braking = self.reaction
        careful = replace(
            CarefulDriverCheck.of(self.scene, self.agent, frame, compute_ego_speed_at(self.scene, frame)),
            waiting=waiting,
            braking=braking,
            hardest=HARDEST_M_S2,
        )
        size = self.scene.agents.size[self.agent, :2]

        def rated(motion: SimulatedMotion) -> ScoreTerms:
            terms, placed = rate(motion), careful.place(motion, size)
            hit = careful.hits(placed)
            soon = np.clip(
                (MEETING_S[1] - careful.find_meeting_times(placed)) / (MEETING_S[1] - MEETING_S[0]), 0.0, 1.0
            )
            more = HIT_WEIGHT * hit - MEETING_WEIGHT * soon * ~hit
            return replace(terms, further=more if terms.further is None else terms.further + more)

        return rated


def _give_up(poses: Floats, failure: VerificationFailure) -> PlannedTrack:
    return PlannedTrack(poses, (), (), failure)


def measure_pressure(scene: Scene, agent: int, start: int) -> float:
    """Share of key frames from which an ego that keeps its speed runs into a vehicle within 1, 2 and 3 s, their mean.

    Half of the plans keep to the path that the ego took, half go straight on.
    """
    last, ego = len(scene.timestamps_us) - 1, scene.ego.boxes
    steps = FRAMES_PER_KEYFRAME * np.arange(1, PLAN_STEPS + 1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ego[:, :2], axis=0).T))])
    found, counted = 0.0, 0
    size = scene.agents.size[agent, :2]
    for key in scene.keyframes.tolist():
        speed = compute_ego_speed_at(scene, key)
        if key + steps[-1] > last:
            break
        counted += 1
        if speed < LEAST_SPEED_M_S or key + steps[-1] < start:
            continue
        at = key + steps
        other = np.column_stack(
            [scene.agents.position[agent, at, :2], np.broadcast_to(size, (len(at), 2)), scene.agents.yaw[agent, at]]
        )
        metres = speed * (scene.seconds[at] - scene.seconds[key])
        for plan in (_follow_way(ego, way, key, metres), _go_straight(ego[key], metres)):
            touched = boxes_overlap(plan, other)
            # Who is run into from behind did not run into anybody.
            touched &= to_local(other[:, :2], plan[:, [0, 1, 4]])[..., 0] > -0.5 * ego[key, 2]
            found += 0.5 * float(np.mean([touched[:count].any() for count in HORIZON_STEPS]))
    return found / max(counted, 1)


def _follow_way(ego: Floats, way: Floats, key: int, metres: Floats) -> Floats:
    """(S, 5) bodies of who keeps to the ego's path; straight on after its end."""
    station = way[key] + metres
    columns = [np.interp(station, way, column) for column in (ego[:, 0], ego[:, 1], np.unwrap(ego[:, 4]))]
    beyond = np.maximum(station - way[-1], 0.0)
    yaw = columns[2]
    size = np.broadcast_to(ego[key, 2:4], (len(metres), 2))
    return np.column_stack([columns[0] + beyond * np.cos(yaw), columns[1] + beyond * np.sin(yaw), size, yaw])


def _go_straight(box: Floats, metres: Floats) -> Floats:
    """(S, 5) bodies of who drives on as it heads."""
    boxes = np.repeat(box[None], len(metres), axis=0)
    boxes[:, 0] += metres * np.cos(box[4])
    boxes[:, 1] += metres * np.sin(box[4])
    return boxes
