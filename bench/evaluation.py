"""Time of one evaluation, physics and scoring of 256 candidates: ours, and working as the reference code works.

Run as ``OMP_NUM_THREADS=1 python bench/evaluation.py``. Processor time. The slow side is measured on fewer candidates
and scaled up. It counts what the reference does one at a time: two 80 x 80 pseudo-inverses a candidate, two polygons
and a test for each pair that its distance rule leaves open, at the frames that we score. What the reference does with
arrays is counted as taking it as long as us; so the ratios are lower bounds for this way of working. "all in Python"
adds a Python loop for steering and motion, which the reference vectorises.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.dynamics.bicycle import DriverLimits, MotionModel, SimulatedMotion, VehicleState, simulate
from benchmark.geometry import Floats, box_corners
from benchmark.machine.workers import single_threaded
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.diffusion.prior import TrajectoryPrior, diversify
from generation.search.candidates import launch_frame
from generation.search.eligibility import eligibility_of
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_motion import initial_state
from generation.search.scoring import Surroundings, score_terms, surroundings
from generation.sources.town import town_scene
from tests.benchmark.dynamics.slow_physics import slow_path, slow_simulate

CANDIDATES, SLOW_CANDIDATES, REPEATS = 256, 16, 30
USUAL = HyperParameters()
EVERY_FRAME = HyperParameters(lookahead_frames=68, lookahead_stride=1)
SI, REFERENCE = MotionModel.si(), MotionModel.reference()


@dataclass(frozen=True, slots=True)
class Case:
    """One planning frame."""

    name: str
    hyper: HyperParameters
    waypoints: Floats
    state: VehicleState
    size: Floats
    around: Surroundings

    def simulate(self) -> SimulatedMotion:
        """All candidates, as far as they are scored."""
        return simulate(self.waypoints, self.state, float(self.size[0]), steps=self.frames[-1], model=SI)

    @property
    def frames(self) -> tuple[int, ...]:
        """Scored frames after the planning frame."""
        return self.hyper.scored_frames


def milliseconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Smallest processor time of several runs, after one to warm up."""
    work()
    best = np.inf
    for _ in range(repeats):
        started = time.process_time()
        work()
        best = min(best, time.process_time() - started)
    return 1e3 * best


def sampled(prior: TrajectoryPrior, speed: float) -> Floats:
    rng = np.random.default_rng(0)
    return diversify(prior.sample(CANDIDATES, np.array([-0.5 * speed, 0.0, 0.0]), rng), rng)


def town_case(name: str, prior: TrajectoryPrior, hyper: HyperParameters, *, traffic: bool) -> Case:
    """A planning frame of the embedded town: the one with most traffic near the vehicle, or one with the ego alone."""
    chosen = [(scene, each.agent) for scene in map(town, range(4)) for each in eligibility_of(scene, USUAL, 0).chosen]
    scene, agent, frame = max(
        ((scene, agent, launch_frame(scene, agent, USUAL) or 0) for scene, agent in chosen),
        key=lambda place: neighbours(*place),
    )
    frame = min(frame, len(scene.timestamps_us) - 1 - hyper.scored_frames[-1])
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[frame])
    around = surroundings(scene, agent, tuple(frame + offset for offset in hyper.scored_frames), raster)
    if not traffic:
        around = Surroundings(around.boxes[:, -1:], around.present[:, -1:], around.ego_center, raster)
    state = initial_state(scene, agent, frame, DriverLimits())
    return Case(name, hyper, sampled(prior, state.speed), state, scene.agents.size[agent, :2], around)


def town(number: int) -> Scene:
    return town_scene("val", number)


def neighbours(scene: Scene, agent: int, frame: int) -> int:
    """Vehicles and people within 15 m."""
    at = scene.agents.position[:, frame, :2]
    near = np.hypot(*(at - at[agent]).T) < 15.0
    return int((near & scene.agents.valid[:, frame]).sum())


def parked_case(name: str, prior: TrajectoryPrior, hyper: HyperParameters) -> Case:
    """A standing car in a car park: five rows of 20, 2.7 m apart."""
    x, y = np.meshgrid(2.7 * (np.arange(20.0) - 10.0), 6.0 * (np.arange(5.0) - 2.0))
    places = np.column_stack([x.ravel(), y.ravel(), np.full(100, 4.6), np.full(100, 1.9), np.full(100, np.pi / 2)])
    others = places[np.hypot(x.ravel(), y.ravel()) > 0.1]
    boxes = np.repeat(others[None], len(hyper.scored_frames), axis=0)
    raster = DrivableRaster(np.ones((200, 200), dtype=np.bool_), np.zeros(3), 0.5)
    around = Surroundings(
        boxes, np.ones(boxes.shape[:2], dtype=np.bool_), np.tile([20.0, 3.0], (len(boxes), 1)), raster
    )
    state = VehicleState(np.array([0.0, -0.3 * 4.6, np.pi / 2]), 0.0)
    return Case(name, hyper, sampled(prior, 2.0), state, np.array([4.6, 1.9]), around)


def polygon_loop(center: Floats, size: Floats, around: Surroundings) -> tuple[int, int]:
    """The reference's collision test: half edges by arrays, polygons one pair at a time; hits and polygon tests."""
    hits = tests = 0
    for step, others in enumerate(around.boxes):
        others = others[around.present[step]]
        distance = np.hypot(*(center[:, step, None, :2] - others[:, :2]).transpose(2, 0, 1))
        near = 0.5 * (size.min() + others[:, 2:4].min(axis=1))
        far = 0.5 * (size.max() + others[:, 2:4].max(axis=1))
        hits += int((distance < near).sum())
        for candidate, other in zip(*np.nonzero((distance >= near) & (distance <= far))):
            own = np.array([*center[candidate, step, :2], *size, center[candidate, step, 2]])
            mine, theirs = shapely.Polygon(box_corners(own)), shapely.Polygon(box_corners(others[other]))
            hits += bool(mine.intersects(theirs))
            tests += 1
    return hits, tests


def report(case: Case) -> None:
    """One line of figures."""
    motion, at = case.simulate(), np.array(case.frames)
    center, speed = motion.center[:, at], motion.states[:, at, 3]
    physics = milliseconds(case.simulate)
    scoring = milliseconds(lambda: score_terms(center, case.size, case.around, case.hyper, speed=speed))
    some = np.linspace(0, CANDIDATES - 1, SLOW_CANDIDATES).astype(int)
    scale, length = CANDIDATES / SLOW_CANDIDATES, float(case.size[0])
    start = VehicleState(case.state.pose, case.state.speed / 12.0)
    inverses = scale * milliseconds(lambda: [slow_path(case.waypoints[row, :, :2], REFERENCE) for row in some], 1)
    everything = scale * milliseconds(
        lambda: [slow_simulate(case.waypoints[row], start, length, steps=80, model=REFERENCE) for row in some], 1
    )
    polygons = scale * milliseconds(lambda: polygon_loop(center[some], case.size, case.around), 1)
    tests = round(scale * polygon_loop(center[some], case.size, case.around)[1])
    ours = physics + scoring
    print(
        f"{case.name:<28}{at[-1]:6d}{case.around.boxes.shape[1]:9d}{physics:9.2f}{scoring:9.2f}{ours:9.2f}"
        f"{inverses:12.0f}{tests:10d}{polygons:11.0f}{(ours + inverses + polygons) / ours:8.0f}"
        f"{(ours + everything + polygons) / ours:16.0f}"
    )


def main() -> None:
    single_threaded()
    prior = TrajectoryPrior.load()
    print(f"{CANDIDATES} candidates, milliseconds of processor time; the slow side on {SLOW_CANDIDATES}, scaled up")
    print(
        f"{'':<28}{'steps':>6}{'objects':>9}{'physics':>9}{'scoring':>9}{'sum':>9}"
        f"{'| inverses':>12}{'tests':>10}{'polygons':>11}{'ratio':>8}{'all in Python':>16}"
    )
    for hyper in (USUAL, EVERY_FRAME):
        report(town_case("free road", prior, hyper, traffic=False))
        report(town_case("town, dense traffic", prior, hyper, traffic=True))
        report(parked_case("parked between neighbours", prior, hyper))


if __name__ == "__main__":
    main()
