"""The policy ``adversary``: the search of open loop, again and again, against where the ego really is.

All others behave by a policy of their own. At each planning frame `generation.search.planning` plans in what has
happened, what is expected of the ego and what the others will do. Its best is driven to the next planning frame if it
can then end without touching any but the ego, to the scene's last frame (`safe_endings`). That ending is kept, and
driven where nothing better is found.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.adversary import ADVERSARY, AdversaryTrack, Handover, Replanning, round_poses
from benchmark.closed_loop.agent_policy import AgentMotion, AgentPolicy, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import SUBSTEP_US
from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import MotionModel, VehicleState, compute_rear_axle
from benchmark.geometry import Floats, to_local
from benchmark.machine.storage import content_seed
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.braking import brake_on_path
from generation.extensions.reactive_adversary.candidate_choice import choose_by_rules, find_drivable, list_allowed
from generation.extensions.reactive_adversary.careful_driver import (
    CarefulDriverCheck,
    ReactivePlanning,
    build_driven_motion,
    compute_ego_speed_at,
    get_careful_driver_check,
)
from generation.extensions.reactive_adversary.ego_prediction import EgoObservations, predict_ego, predict_turns
from generation.extensions.reactive_adversary.returning import find_recorded_rest
from generation.extensions.reactive_adversary.rules import AdversaryRules, rasterise_road
from generation.extensions.reactive_adversary.safe_endings import (
    AHEAD_FRAMES,
    BRAKING_M_S2,
    ExpectedAgents,
    SurroundingTracks,
    predict_others,
)
from generation.extensions.reactive_adversary.search_trace import build_search_trace
from generation.extensions.reactive_adversary.settings import LONGEST_FRAMES, AdversarySettings, EgoPrediction
from generation.search.adversary import ALGORITHM_VERSION, compute_scene_identity
from generation.search.planning import AdversaryPlanning
from generation.search.proposals import Diversify, Prior, run_searches
from generation.search.recorded_motion import compute_initial_state
from generation.search.refinement import Refinement, ResamplingUnderflowError, compare_scores

_NO_SCRIPT: Final = (EgoPrediction.RECORDING, EgoPrediction.MOTION_ONLY)
_FAR_M: Final = 5.0
"""Nearer than this to the edge of the area around the ego, an adversary looks at the road around itself."""


@dataclass(frozen=True, slots=True)
class AdversaryMemory:
    """Memory of an adversary; a value.

    `state` is its motion at the end of the planned `track`, (F, 3) from the hand-over on; `ahead` (60, 3) is how the
    last plan would have gone on. `ending` (K, 3) goes on to the scene's last frame where nothing better is found: it
    touches none if the others do as expected when it was looked at.
    """

    others: Any
    seen: EgoObservations
    state: VehicleState
    track: Floats
    ahead: Floats
    ending: Floats
    randomness: Any
    replanned: tuple[Replanning, ...] = ()
    on_scripted_track: bool = True


@dataclass(frozen=True, slots=True)
class _ChosenMotion:
    """Motion that is driven next.

    `executed` are (F, 3) poses after the planning frame; then `ahead` (60, 3) are as meant, `ending` (K, 3), to the
    last frame, touch no other as far as is known. `picked` is round and index of its candidate.
    """

    executed: Floats
    ahead: Floats
    ending: Floats
    state: VehicleState
    replanning: Replanning
    on_scripted_track: bool = False
    picked: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class ReactiveAdversary:
    """Policy of an adversary from its hand-over on; ``draws`` is false, as it draws by scene content and ``run``."""

    scene: Scene
    agent: int
    start: int
    run: int
    settings: AdversarySettings
    others: AgentPolicy[Any]
    prior: Prior
    diversify: Diversify
    name: str = ADVERSARY
    draws: bool = False
    handover: Handover = field(init=False, repr=False)
    model: MotionModel = field(init=False, repr=False)
    road: DrivableRaster | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        bound = self.settings.knows is EgoPrediction.MOTION_ONLY
        object.__setattr__(self, "road", rasterise_road(self.scene) if bound else None)
        object.__setattr__(self, "handover", Handover.of(self.scene, self.agent, self.start))
        object.__setattr__(self, "model", self.settings.hyper.motion_model())

    def init(self, time_us: int, key: int) -> tuple[AdversaryMemory, AgentMotion]:
        """All where they are; nothing is planned yet."""
        memory, moved = self.others.init(time_us, key)
        hyper, agent_id = self.settings.hyper, self.scene.agents.ids[self.agent]
        content = (compute_scene_identity(self.scene), agent_id, self.run, hyper.fingerprint, self.prior.fingerprint)
        rng = np.random.default_rng(content_seed(*content, ALGORITHM_VERSION, 0))
        planning = self._build_planning(self.scene, rng)
        first = planning.find_first_pose()
        own = AdversaryMemory(
            others=memory,
            seen=EgoObservations.recorded(self.scene, time_us),
            state=planning.compute_first_state(),
            track=first[None],
            ahead=np.repeat(first[None], AHEAD_FRAMES, axis=0),
            ending=self._find_first_ending(first, time_us, planning.compute_first_state()),
            randomness=rng.bit_generator.state,
        )
        return own, moved

    def act(self, memory: AdversaryMemory, moment: TrafficSnapshot, key: int) -> tuple[AdversaryMemory, AgentMotion]:
        """The next 0.1 s, planned anew where what was planned does not reach so far."""
        observations = memory.seen if memory.seen.times_us[-1] >= moment.time_us else memory.seen.then(moment)
        memory = replace(memory, seen=observations)
        times, last = self.scene.timestamps_us, len(self.scene.timestamps_us) - 1
        while (frame := self.start + len(memory.track) - 1) < last and times[frame] < moment.time_us + SUBSTEP_US:
            memory = self._plan_frame(memory, moment, frame)
        others, moved = self.others.act(memory.others, moment, key)
        return replace(memory, others=others), self.handover.moved(moved, round_poses(memory.track), moment.time_us)

    def adversary(self, memory: AdversaryMemory) -> AdversaryTrack:
        """Track that is planned for it so far."""
        return AdversaryTrack(self.agent, self.start, round_poses(memory.track), memory.replanned)

    def _build_planning(
        self, scene: Scene, rng: np.random.Generator, road_around: Floats | None = None
    ) -> AdversaryPlanning:
        stages = {"physics": 0.0, "scoring": 0.0}
        hyper = self.settings.hyper
        # In open loop the ego's future is known, and the adversary keeps clear of it.
        kind = AdversaryPlanning if self.settings.knows is EgoPrediction.RECORDING else ReactivePlanning
        return kind(
            scene, self.agent, self.start, hyper, self.diversify, self.model, rng, stages, road_around=road_around
        )

    def _plan_frame(self, memory: AdversaryMemory, moment: TrafficSnapshot, frame: int) -> AdversaryMemory:
        """Plan at a frame and drive on to the next one."""
        ego = predict_ego(self.scene, memory.seen, moment.plan, self.settings.knows)
        scene = replace(self.scene, ego=ego, sweep_poses=None)
        if self.settings.others != "replay":
            own = np.concatenate([memory.track, memory.ahead])
            others = ExpectedAgents(self.others, memory.others, self.handover, own)
            scene = predict_others(scene, others, moment, frame)
        rng = np.random.default_rng()
        rng.bit_generator.state = memory.randomness
        planning = self._build_planning(scene, rng, self._find_road_pose(scene, frame, memory.track[-1]))
        steps = min(self.settings.every_frames, len(scene.timestamps_us) - 1 - frame)
        around = SurroundingTracks.of(scene, self.agent, frame, moment.time_us)
        chosen, refinement = self._follow_scripted_track(scene, around, frame, steps, memory), None
        if chosen is None:
            refinement = self._search(planning, frame, memory)
            rules = self._build_rules(scene, frame, memory)
            chosen = self._choose_motion(scene, around, frame, steps, refinement, memory, rules)
            if rules is None and self.settings.knows is not EgoPrediction.RECORDING:
                chosen = self._yield_if_safer(scene, around, frame, steps, chosen, memory)
        replanning = self._build_replanning(scene, frame, memory.state, refinement, chosen)
        return replace(
            memory,
            state=chosen.state,
            track=np.concatenate([memory.track, chosen.executed]),
            ahead=chosen.ahead,
            ending=chosen.ending,
            randomness=rng.bit_generator.state,
            replanned=(*memory.replanned, replanning),
            on_scripted_track=chosen.on_scripted_track,
        )

    def _find_first_ending(self, first: Floats, time_us: int, state: VehicleState) -> Floats:
        """(K, 3) the rest of its recording after the hand-over, or brakes where that ends or touches another.

        Brakes alone where the scene was made with its track and that is not known.
        """
        scene, agents = self.scene, self.scene.agents
        around = SurroundingTracks.of(scene, self.agent, self.start, time_us)
        if agents.ids[self.agent] in scene.adversaries and self.settings.knows is EgoPrediction.MOTION_ONLY:
            path = np.repeat(first[None], 2, axis=0)
            brakes = [self._slow_on_path(path, around.frame_seconds, state, braking) for braking in BRAKING_M_S2]
            return around.find_longest(brakes)[1:]
        absent = np.flatnonzero(~agents.valid[self.agent, self.start :])
        recorded = slice(self.start, self.start + int(absent[0]) if len(absent) else None)
        poses = np.column_stack([agents.position[self.agent, recorded, :2], agents.yaw[self.agent, recorded]])
        poses = np.concatenate([first[None], poses[1:]])
        safe_ending = around.ending(poses, 0)
        return (around.find_longest(around.generate_endings(poses, 0)) if safe_ending is None else safe_ending)[1:]

    def _follow_scripted_track(
        self, scene: Scene, around: SurroundingTracks, frame: int, steps: int, memory: AdversaryMemory
    ) -> _ChosenMotion | None:
        """The rest of the track that the scene was made with, if the adversary is still on it and may drive it."""
        known = self.scene.agents.ids[self.agent] in self.scene.adversaries
        if not known or not memory.on_scripted_track or self.settings.knows in _NO_SCRIPT:
            return None
        agents = scene.agents
        last = len(scene.timestamps_us) - 1
        if not agents.valid[self.agent, frame : last + 1].all():
            return None
        poses = np.column_stack([agents.position[self.agent, :, :2], agents.yaw[self.agent]])[frame : last + 1]
        ending = around.ending(poses, steps)
        if ending is None:
            return None
        if not memory.seen.is_as_recorded(self.scene) and not self._does_ego_run_into(scene, frame, poses):
            return None
        state = compute_initial_state(scene, self.agent, frame + steps, self.model.limits)
        replanning = Replanning(frame, None, braked=False)
        return _ChosenMotion(
            poses[1 : steps + 1],
            _compute_ahead(poses, steps),
            ending[steps + 1 :],
            state,
            replanning,
            on_scripted_track=True,
        )

    def _does_ego_run_into(self, scene: Scene, frame: int, poses: Floats) -> bool:
        """Whether an ego that does not react would run into a track, however late."""
        size = self.scene.agents.size[self.agent, :2]
        careful = CarefulDriverCheck.of(scene, self.agent, frame, compute_ego_speed_at(scene, frame), len(poses))
        return bool(careful.is_met(careful.place(build_driven_motion(poses, float(size[0])), size), in_front=False)[0])

    def _yield_if_safer(
        self,
        scene: Scene,
        around: SurroundingTracks,
        frame: int,
        steps: int,
        chosen: _ChosenMotion,
        memory: AdversaryMemory,
    ) -> _ChosenMotion:
        """The chosen motion, or the brakes where a careful human does not survive it but survives them."""
        size = self.scene.agents.size[self.agent, :2]
        careful = get_careful_driver_check(scene, self.agent, frame, compute_ego_speed_at(scene, frame))
        now = memory.track[-1:]

        def hits(poses: Floats) -> bool:
            return bool(careful.hit(build_driven_motion(poses[: LONGEST_FRAMES + 1], float(size[0])), size)[0])

        if not hits(np.concatenate([now, chosen.executed, chosen.ahead])):
            return chosen
        slowed = self._compute_brakings(BRAKING_M_S2, around, memory)
        clear = [candidate for candidate in slowed if around.compute_clear_seconds(candidate) == np.inf]
        for poses in clear:
            if not hits(poses):
                return self._build_braked_motion(frame, steps, poses)
        # An adversary behind the ego without a safe plan takes the one nearest to safe.
        behind = bool(clear) and careful.is_following(now, size)
        return self._build_braked_motion(frame, steps, clear[-1]) if behind else chosen

    def _search(self, planning: AdversaryPlanning, frame: int, memory: AdversaryMemory) -> Refinement | None:
        """Result of the search; ``None`` where it has nothing to draw from."""
        try:
            (refinement,), _ = run_searches([planning.plan(frame, memory.state, memory.track)], self.prior)
        except ResamplingUnderflowError:
            return None
        return refinement

    def _build_rules(self, scene: Scene, frame: int, memory: AdversaryMemory) -> AdversaryRules | None:
        """Rules at a frame, of who has a road to keep to."""
        if self.road is None:
            return None
        speed = compute_ego_speed_at(scene, frame)
        careful = [get_careful_driver_check(scene, self.agent, frame, speed)]
        for ego in predict_turns(scene, memory.seen, self.road):
            careful.append(CarefulDriverCheck.of(replace(scene, ego=ego), self.agent, frame, speed))
        scripted = scene.agents.ids[self.agent] in scene.adversaries
        recorded = None if scripted else find_recorded_rest(scene, self.agent, frame)
        return AdversaryRules.of(scene, self.road, careful, self.agent, memory.track[-1], recorded)

    def _find_road_pose(self, scene: Scene, frame: int, pose: Floats) -> Floats | None:
        """Around the ego, as the search looks; around itself where the area around the ego has lost it."""
        half = self.settings.hyper.half_extent_m - _FAR_M
        lost = np.abs(to_local(pose[:2], scene.ego.pose[frame])).max() > half
        return pose.copy() if lost else None

    def _choose_motion(
        self,
        scene: Scene,
        around: SurroundingTracks,
        frame: int,
        steps: int,
        refinement: Refinement | None,
        memory: AdversaryMemory,
        rules: AdversaryRules | None,
    ) -> _ChosenMotion:
        """The best candidate that may be driven, or the brakes."""
        # An adversary that is already off the road may return to it, however.
        on_road = bool(scene.road_map.is_drivable(memory.track[-1, :2]))
        candidates = [] if refinement is None else list_allowed(refinement, self.settings.hyper, steps, on_road=on_road)

        @functools.cache
        def list_options() -> list[Floats]:
            cached_ending = np.concatenate([memory.track[-1:], memory.ending])
            return [*self._compute_brakings((0.0, *BRAKING_M_S2), around, memory), cached_ending]

        chosen: tuple[int, int, Floats] | Floats | None
        if rules is not None:
            chosen = choose_by_rules(candidates, refinement, around, steps, rules, list_options)
            if chosen is None:
                chosen = rules.find_clearest(around, scene, frame, list_options())
        else:
            chosen = find_drivable(candidates, refinement, around, steps)
            if chosen is None:
                # Brakes on the meant path, as gently as touches no other; or the ending kept; or the longest one.
                chosen = around.find_longest(list_options())
        if not isinstance(chosen, tuple):
            return self._build_braked_motion(frame, steps, chosen)
        assert refinement is not None
        return self._build_searched_motion(frame, steps, refinement, *chosen)

    def _build_searched_motion(
        self, frame: int, steps: int, refinement: Refinement, number: int, index: int, ending: Floats
    ) -> _ChosenMotion:
        """A candidate of the search, and how it may end."""
        motion = refinement.batches[number].evaluated.motion
        score = float(compare_scores(refinement.batches, self.settings.hyper)[number, index])
        return _ChosenMotion(
            motion.center[index, 1 : steps + 1],
            _compute_ahead(motion.center[index], steps),
            ending[steps + 1 :],
            motion.state(index, steps),
            Replanning(frame, score, braked=False),
            picked=(number, index),
        )

    def _build_replanning(
        self, scene: Scene, frame: int, state: VehicleState, refinement: Refinement | None, chosen: _ChosenMotion
    ) -> Replanning:
        """Note on a planning frame."""
        if not self.settings.keep_considered:
            return chosen.replanning
        hyper, picked = self.settings.hyper, chosen.picked
        considered = build_search_trace(
            scene, self.agent, frame, state, refinement, picked, hyper, self.model, as_made=chosen.on_scripted_track
        )
        return replace(chosen.replanning, considered=considered)

    def _compute_brakings(
        self, brakings: Sequence[float], around: SurroundingTracks, memory: AdversaryMemory
    ) -> list[Floats]:
        """Poses to the scene's last frame of who brakes from now on, so hard, on the path that was meant."""
        path = np.concatenate([memory.track[-1:], memory.ahead])
        return [self._slow_on_path(path, around.frame_seconds, memory.state, braking) for braking in brakings]

    def _build_braked_motion(self, frame: int, steps: int, poses: Floats) -> _ChosenMotion:
        """Poses from the planning frame to the last one that no search found."""
        executed = poses[1 : steps + 1]
        way = executed[-1, :2] - poses[steps - 1, :2]
        state = VehicleState(
            compute_rear_axle(executed[-1], float(self.scene.agents.size[self.agent, 0])),
            float(np.hypot(*way)) * FRAME_HZ,
        )
        replanning = Replanning(frame, None, braked=True)
        return _ChosenMotion(executed, _compute_ahead(poses, steps), poses[steps + 1 :], state, replanning)

    @staticmethod
    def _slow_on_path(path: Floats, seconds: Floats, state: VehicleState, braking_m_s2: float) -> Floats:
        """(K, 3) poses of who leaves its plan's speed for a steady braking from now on."""
        # The pose before now sets the initial speed along the path.
        back = np.array([np.cos(path[0, 2]), np.sin(path[0, 2])]) / FRAME_HZ * state.speed
        before = np.array([[*(path[0, :2] - back), path[0, 2]]])
        times = np.concatenate([[-1.0 / FRAME_HZ], seconds])
        return brake_on_path(np.concatenate([before, path]), 1, times, braking_m_s2)[1:]


def _compute_ahead(poses: Floats, steps: int) -> Floats:
    """(60, 3) how a motion goes on after some frames; its last pose stands for what is beyond it."""
    rest = poses[steps + 1 : steps + 1 + AHEAD_FRAMES]
    missing = AHEAD_FRAMES - len(rest)
    return np.concatenate([rest, np.repeat(poses[-1:], missing, axis=0)]) if missing else rest
