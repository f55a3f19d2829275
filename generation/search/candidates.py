"""Which background vehicles may become adversaries, when they launch, and how they move then.

Appendix "The Adv-nuSc Dataset": up to 10 background vehicles that come close to the ego.
"""

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
import shapely

from benchmark.constants import FOUR_WHEELED_CATEGORIES
from benchmark.machine.storage import content_seed
from benchmark.scene import Scene
from generation.labels.labelling import ego_speed
from generation.search.hyperparameters import ChoiceOf, HyperParameters, Launch
from generation.search.reach import launch_in_reach, reach_at
from generation.search.recorded_motion import center_distance, drives_forward, in_canvas
from generation.search.reference_rules import CAR, in_reference_canvas, near_on_the_road, reference_launch


class NotTried(StrEnum):
    """Why an object of a scene is not tried as an adversary."""

    NOT_FOUR_WHEELED = "not-a-four-wheeler"
    ALREADY_ADVERSARY = "already-an-adversary"
    NEVER_NEAR = "never-near-the-ego"
    PARKED = "parked"
    OFF_ROAD = "off-the-drivable-area"
    OUT_OF_REACH = "cannot-get-in-the-way-of-the-ego"
    NO_LAUNCH = "no-frame-to-launch-at"
    EGO_STANDS = "ego-stands-after-the-launch"
    NOT_DRAWN = "not-drawn-by-the-seed"
    NO_CAR = "not-a-car"


def draw(scene: Scene, eligible: Sequence[int], hyper: HyperParameters, seed: int) -> tuple[int, ...]:
    """At most ``hyper.candidate_limit`` of the eligible agent indices, ascending; ``seed`` says which."""
    rng = np.random.default_rng(content_seed("candidates", scene.name, scene.token, seed))
    # Weighted draw without replacement: who waits least, with waiting times of rate "weight".
    measure = nearness if hyper.launch is Launch.REACH else staying_share
    weight = np.array([measure(scene, agent, hyper) for agent in eligible]) ** hyper.staying_preference
    drawn = np.argsort(rng.exponential(size=len(eligible)) / weight, kind="stable")[: hyper.candidate_limit]
    return tuple(sorted(eligible[index] for index in drawn))


def unfit(scene: Scene, agent: int, hyper: HyperParameters) -> NotTried | None:
    """First reason why an object cannot become an adversary, or ``None``.

    An eligible vehicle comes close on the road and launches at a driving ego.
    """
    agents = scene.agents
    if agents.categories[agent] not in FOUR_WHEELED_CATEGORIES:
        return NotTried.NOT_FOUR_WHEELED
    if agents.ids[agent] in scene.adversaries:
        return NotTried.ALREADY_ADVERSARY
    return (
        _unfit_as_we_choose(scene, agent, hyper) if hyper.choice is ChoiceOf.OURS else _unfit_as_reference(scene, agent)
    )


def _unfit_as_reference(scene: Scene, agent: int) -> NotTried | None:
    if scene.agents.categories[agent] != CAR:
        return NotTried.NO_CAR
    near, on_road = near_on_the_road(scene, agent)
    if not on_road:
        return NotTried.OFF_ROAD if in_reference_canvas(scene, agent).any() else NotTried.NEVER_NEAR
    if not near:
        return NotTried.NEVER_NEAR
    return None if reference_launch(scene, agent) is not None else NotTried.NO_LAUNCH


def _unfit_as_we_choose(scene: Scene, agent: int, hyper: HyperParameters) -> NotTried | None:
    agents = scene.agents
    canvas = in_canvas(scene, agents.position[agent, :, :2], hyper.half_extent_m) & agents.valid[agent]
    by_reach = hyper.launch is Launch.REACH
    if not canvas.any() or (not by_reach and center_distance(scene, agent)[canvas].min() >= hyper.proximity_m):
        return NotTried.NEVER_NEAR
    path = agents.position[agent, agents.valid[agent], :2]
    if not hyper.parked and np.ptp(path, axis=0).max() < hyper.least_motion_m:
        return NotTried.PARKED
    shapely.prepare(scene.road_map.drivable_area)
    if scene.road_map.is_drivable(agents.position[agent, canvas, :2]).mean() < hyper.least_drivable_share:
        return NotTried.OFF_ROAD
    launch = launch_frame(scene, agent, hyper)
    if launch is None:
        return NotTried.OUT_OF_REACH if by_reach else NotTried.NO_LAUNCH
    if not (ego_speed(scene)[launch:] >= hyper.moving_ego_m_s).any():
        return NotTried.EGO_STANDS
    return None


def staying_share(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    """Share of the frames after its launch that an eligible vehicle's recording spends in the area around the ego.

    It is more than 0.
    """
    launch = launch_frame(scene, agent, hyper)
    inside = in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m) & scene.agents.valid[agent]
    return float(inside[launch:].mean())


def nearness(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    """Nearness in time of a launched eligible vehicle to the ego's way: 1 at once, 1/2 after 3 s; more than 0."""
    launch = launch_frame(scene, agent, hyper)
    return float("nan") if launch is None else 1.0 / (1.0 + reach_at(scene, agent, launch, hyper) / 3.0)


def launch_frame(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame at which an agent may take over by the rule of ``hyper`` (`hyperparameters.Launch`), if any."""
    match hyper.launch:
        case Launch.NEAR:
            return _launch_near(scene, agent, hyper)
        case Launch.REFERENCE:
            return reference_launch(scene, agent)
        case Launch.REACH:
            return launch_in_reach(scene, agent, hyper)
        case Launch.START:
            inside = in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m)
            there = np.flatnonzero(inside & scene.agents.valid[agent])
            last = inside.size - 1 - hyper.shortest_drive_frames
            return int(there[0]) if len(there) and there[0] <= last else None


def _launch_near(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame at which an agent may take over near the ego.

    It has been there for the history, is close enough to the ego, drives forwards without sliding, stands on the
    road, and enough of the scene is left.
    """
    valid = scene.agents.valid[agent]
    seen = np.convolve(valid, np.ones(hyper.history_frames + 1), mode="full")[: len(valid)] > hyper.history_frames
    last = len(valid) - 1 - hyper.shortest_drive_frames
    close = center_distance(scene, agent) < hyper.launch_distance_m
    for frame in np.flatnonzero(seen & close):
        if frame > last:
            return None
        if drives_forward(scene, agent, int(frame)):
            on_road = scene.road_map.is_drivable(scene.agents.position[agent, frame, :2])
            if on_road:
                return int(frame)
    return None
