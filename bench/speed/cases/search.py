"""The search for adversaries: an evaluation (physics and scoring of 256 candidates), whole attempts, their memory.

The slow side of an evaluation works as the reference code does, on 16 candidates: two 80 x 80 pseudo-inverses a
candidate, two polygons and a test for each pair that its distance rule leaves open, at the frames that we score. What
the reference does with arrays is left out, so that ratios are lower bounds; `-in-python` adds a Python loop for
steering and motion, which the reference vectorises.
"""

import pickle
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from bench.speed.case import Case
from benchmark.dynamics.bicycle import DriverLimits, MotionModel, VehicleState, simulate
from benchmark.geometry import Floats, box_corners
from benchmark.machine.metering import disable_malloc_trim
from benchmark.published import RUNTIME_S
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.diffusion.prior import TrajectoryPrior, diversify
from generation.search.adversary import search_vehicles
from generation.search.candidates import compute_eligibility, find_launch_frame
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_motion import compute_initial_state
from generation.search.scoring import ScoringSurroundings, build_surroundings, compute_score_terms
from generation.sources.town import build_town_scene
from tests.benchmark.dynamics.slow_physics import slow_path, slow_simulate

SLOW_CANDIDATES = 16
FRAMES = {"usual": HyperParameters(), "every-frame": HyperParameters(lookahead_frames=68, lookahead_stride=1)}
SI, REFERENCE = MotionModel.si(), MotionModel.reference()
RECORDED = Path(__file__).resolve().parents[4] / "shared" / "data" / "scenes"
town = cache(partial(build_town_scene, "val"))


def neighbours(scene: Scene, agent: int, frame: int) -> int:
    """Vehicles and people within 15 m."""
    at = scene.agents.position[:, frame, :2]
    return int(((np.hypot(*(at - at[agent]).T) < 15.0) & scene.agents.valid[:, frame]).sum())


def town_place(hyper: HyperParameters, *, traffic: bool) -> tuple[VehicleState, Floats, ScoringSurroundings]:
    """The planning frame of the town with most traffic near the vehicle; or that frame with the ego alone."""
    chosen = [
        (town(number), choice.agent)
        for number in range(4)
        for choice in compute_eligibility(town(number), FRAMES["usual"], 0).chosen
    ]
    places = [(scene, agent, find_launch_frame(scene, agent, FRAMES["usual"]) or 0) for scene, agent in chosen]
    scene, agent, frame = max(places, key=lambda place: neighbours(*place))
    frame = min(frame, len(scene.timestamps_us) - 1 - hyper.scored_frames[-1])
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[frame])
    around = build_surroundings(scene, agent, tuple(frame + offset for offset in hyper.scored_frames), raster)
    if not traffic:
        around = ScoringSurroundings(around.boxes[:, -1:], around.present[:, -1:], around.ego_center, raster)
    return compute_initial_state(scene, agent, frame, DriverLimits()), scene.agents.size[agent, :2], around


def parked_place(hyper: HyperParameters) -> tuple[VehicleState, Floats, ScoringSurroundings]:
    """A standing car in a car park: five rows of 20, 2.7 m apart."""
    x, y = (axis.ravel() for axis in np.meshgrid(2.7 * (np.arange(20.0) - 10.0), 6.0 * (np.arange(5.0) - 2.0)))
    places = np.column_stack([x, y, np.full(100, 4.6), np.full(100, 1.9), np.full(100, np.pi / 2)])
    boxes = np.repeat(places[None, np.hypot(x, y) > 0.1], len(hyper.scored_frames), axis=0)
    raster = DrivableRaster(np.ones((200, 200), dtype=np.bool_), np.zeros(3), 0.5)
    present = np.ones(boxes.shape[:2], dtype=np.bool_)
    around = ScoringSurroundings(boxes, present, np.tile([20.0, 3.0], (len(boxes), 1)), raster)
    return VehicleState(np.array([0.0, -0.3 * 4.6, np.pi / 2]), 0.0), np.array([4.6, 1.9]), around


PLACES: dict[str, Callable[[HyperParameters], tuple[VehicleState, Floats, ScoringSurroundings]]] = {
    "free-road": partial(town_place, traffic=False),
    "dense-traffic": partial(town_place, traffic=True),
    "parked": parked_place,
}


def candidates(place: str, frames: str, quick: bool, _folder: Path) -> Any:
    state, size, around = PLACES[place](FRAMES[frames])
    speed, rng = 2.0 if place == "parked" else state.speed, np.random.default_rng(0)
    sampled = TrajectoryPrior.load().sample(32 if quick else 256, np.array([-0.5 * speed, 0.0, 0.0]), rng)
    return FRAMES[frames], diversify(sampled, rng), state, size, around


def evaluation(state: Any) -> tuple[float, Any]:
    hyper, waypoints, start, size, around = state
    motion = simulate(waypoints, start, float(size[0]), steps=hyper.scored_frames[-1], model=SI)
    at = np.array(hyper.scored_frames)
    center, speed = motion.center[:, at], motion.states[:, at, 3]
    return len(waypoints), (center, compute_score_terms(center, size, around, hyper, speed=speed))


def slow_evaluation(state: Any, *, in_python: bool) -> tuple[float, Any]:
    _hyper, waypoints, start, size, around = state
    slow_start = VehicleState(start.pose, start.speed / 12.0)
    some = np.linspace(0, len(waypoints) - 1, SLOW_CANDIDATES).astype(int)
    # Where candidates are is taken from ours, in no time: it is what the reference does with arrays.
    for row in some:
        if in_python:
            slow_simulate(waypoints[row], slow_start, float(size[0]), steps=80, model=REFERENCE)
        else:
            slow_path(waypoints[row, :, :2], REFERENCE)
    center = evaluation((_hyper, waypoints[some], start, size, around))[1][0]
    return SLOW_CANDIDATES, polygon_loop(center, size, around)


def polygon_loop(center: Floats, size: Floats, around: ScoringSurroundings) -> int:
    """The reference's collision test: half edges by arrays, polygons one pair at a time; how many tests."""
    tests = 0
    for step, others in enumerate(around.boxes):
        others = others[around.present[step]]
        distance = np.hypot(*(center[:, step, None, :2] - others[:, :2]).transpose(2, 0, 1))
        near = 0.5 * (size.min() + others[:, 2:4].min(axis=1))
        far = 0.5 * (size.max() + others[:, 2:4].max(axis=1))
        for candidate, other in zip(*np.nonzero((distance >= near) & (distance <= far))):
            own = np.array([*center[candidate, step, :2], *size, center[candidate, step, 2]])
            shapely.Polygon(box_corners(own)).intersects(shapely.Polygon(box_corners(others[other])))
            tests += 1
    return tests


def evaluation_case(place: str, frames: str, *, in_python: bool = False) -> Case:
    return Case(
        f"evaluation/{place}-{frames}{'-in-python' * in_python}",
        f"Physics and scoring of 256 candidates, {frames.replace('-', ' ')} frames scored: {place.replace('-', ' ')}.",
        partial(candidates, place, frames),
        evaluation,
        "candidate",
        other=("as the reference works", partial(slow_evaluation, in_python=in_python)),
        more=lambda state, _: f"{state[4].boxes.shape[1]} objects, {state[0].scored_frames[-1]} steps",
    )


def prepare_search(quick: bool, _folder: Path) -> Any:
    disable_malloc_trim()
    # One try, so that the trace counts every evaluation that took time.
    hyper = HyperParameters(candidates=16 if quick else 256, tries=1)
    prior, scene = TrajectoryPrior.load(), town(0)
    agents = [vehicle.agent for vehicle in compute_eligibility(scene, hyper, 0).chosen][: 1 if quick else 2]
    # The first use of everything pays for matrices that are kept.
    search_vehicles([(scene, agents[0])], 0, HyperParameters(candidates=4, rounds=1, tries=1), prior)
    return prior, scene, agents, hyper


def search(state: Any) -> tuple[float, Any]:
    """Attempts one by one; a batch that was simulated and scored has an entry in the trace of a vehicle's search."""
    prior, scene, agents, hyper = state
    results = [search_vehicles([(scene, agent)], 0, hyper, prior)[0] for agent in agents]
    return sum(len(plan.best_scores) for result in results for plan in result.attempt.plans), results


def by_stage(_state: Any, found: Any) -> str:
    stages = {
        name: sum(attempt.stage_seconds[name] for attempt in found) / len(found)
        for name in ("sampling", "physics", "scoring", "other")
    }
    paper = ", ".join(
        f"{name} {seconds:.2f} s (paper {RUNTIME_S.get(name, 0.0):.2f})" for name, seconds in stages.items()
    )
    return f"an attempt {sum(stages.values()):.2f} s: {paper}"


def find_densest_scene(quick: bool, _folder: Path) -> Any:
    """The scene with most objects, of the recordings beside the repository or else of the town, as a worker gets it."""
    from benchmark.datasets.scenarionet import find_scenarionet, read_scenarionet

    if RECORDED.is_dir() and not quick:
        scenes = [read_scenarionet(path) for path in find_scenarionet(RECORDED)]
    else:
        scenes = [town(number) for number in range(1 if quick else 8)]
    scene, hyper = max(scenes, key=lambda scene: len(scene.agents)), HyperParameters(candidates=16 if quick else 256)
    agents = [vehicle.agent for vehicle in compute_eligibility(scene, hyper, 0).chosen]
    units = [(seed, agent) for seed in range(4) for agent in agents][: 1 if quick else 4]
    return pickle.dumps(scene), units, hyper, TrajectoryPrior.load()


def attempts_of_a_worker(state: Any) -> tuple[float, Any]:
    shipped, units, hyper, prior = state
    for seed, agent in units:
        search_vehicles([(pickle.loads(shipped), agent)], seed, hyper, prior)  # noqa: S301 - our own bytes
    return len(units), None


CASES = (
    *(evaluation_case(place, frames) for frames in FRAMES for place in PLACES),
    evaluation_case("dense-traffic", "usual", in_python=True),
    Case(
        "adversaries",
        "Where the processor time of an adversary goes; the paper's seconds are for a scene of about 240 frames.",
        prepare_search,
        search,
        "evaluation",
        more=by_stage,
    ),
    Case(
        "memory",
        "Most memory of a worker of the search in the densest scene, four attempts one after the other.",
        find_densest_scene,
        attempts_of_a_worker,
        "attempt",
        more=lambda state, _: f"the scene has {len(state[0]) / 1e6:.1f} MB",
        most_mb=1500.0,
    ),
)
