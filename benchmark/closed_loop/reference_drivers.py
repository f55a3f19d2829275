"""The ladder of reference drivers in closed loop: each drives a course in which the others answer it.

The drivers are those of `benchmark.interactions`, which follow the recorded path of the ego and decide every 0.1 s as
in open loop, but with agents where their policy has them, each in its own world. Contact is looked for every 0.05 s.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from benchmark.closed_loop.agent_policy import AgentMotion, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANT_US, INSTANTS, SUBSTEP_US
from benchmark.closed_loop.simulation_state import CollisionEvent
from benchmark.closed_loop.stepping import begin_simulation
from benchmark.closed_loop.world_state import SimulationConfig, WorldState
from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.interactions.contacts import KINDS, is_at_fault
from benchmark.interactions.driver_simulation import (
    DriverSimulation,
    DrivingSituation,
    ReferenceDriver,
    compute_unreactive_motion,
)
from benchmark.interactions.reaction import REACTING, Driver
from benchmark.interactions.relations import PathRelations
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.records.drive_schema import LadderOutcome
from benchmark.scene import Scene

DECIMALS: Final = 6
"""Of seconds."""


def simulate_reference_drivers(
    scene: Scene, course: SimulationConfig, drivers: Sequence[Driver]
) -> dict[Driver, LadderOutcome]:
    """Let reference drivers drive a course, each by itself; the course's policy answers each driver."""
    tracks = ContinuousTracks.of_scene(scene)
    start = (course.start_us - int(scene.timestamps_us[0])) / 1e6
    last = (course.end_us - int(scene.timestamps_us[0])) / 1e6
    times = tracks.grid(start)
    situation = DrivingSituation(tracks, times[times <= last + 1e-6])
    return {driver: _run_driver(course, situation, driver) for driver in drivers}


def _run_driver(course: SimulationConfig, situation: DrivingSituation, driver: Driver) -> LadderOutcome:
    """One driver, to the first contact or to the end."""
    rung, world = ReferenceDriver(driver), begin_simulation(course)
    decides = driver in (Driver.IDM, *REACTING)
    advancing = DriverSimulation(situation, [rung]) if decides else None
    motion = None if decides else compute_unreactive_motion(situation, rung)
    moment, memory = world.others, world.memory
    moment = replace(moment, ego=situation.tracks.ego_at(situation.times[:1])[0], ego_speed=float(situation.speed[0]))
    for step in range(len(situation.times) - 1):
        if advancing is not None:
            advancing.step(step, update_situation(situation, world.ignored, moment, step), 0)
            (motion,) = advancing.collect_motions()
        assert motion is not None
        egos = compute_ego_boxes(situation, step, motion.free_from, motion.station)
        memory, moved = course.policy.act(memory, replace(moment, ego_after=egos[-1]), 0)
        touched = _find_first_contact(course, world, egos, moved, moment.time_us, float(motion.speed[step + 1]))
        if touched is not None:
            return _build_outcome(touched, course.start_us)
        speed = float(motion.speed[step + 1])
        now = moment.time_us + SUBSTEP_US
        moment = TrafficSnapshot(now, egos[-1], speed, moved.boxes[-1], moved.present[-1], moved.velocity)
    return LadderOutcome(survives=True)


def update_situation(
    situation: DrivingSituation, ignored: Bools, moment: TrafficSnapshot, step: int
) -> DrivingSituation:
    """The situation of now: of the recording only the ego's path is left; (N,) agents may be ignored."""
    relations = PathRelations.now(
        situation.path,
        float(situation.times[step]),
        moment.boxes,
        moment.present,
        moment.velocity,
        situation.tracks.hides,
        float(situation.station.min()),
    )
    return _CurrentSituation(situation, relations, ignored)


class _CurrentSituation(DrivingSituation):
    """A situation with other relations and other people to ignore."""

    def __init__(self, situation: DrivingSituation, relations: PathRelations, ignored: Bools) -> None:
        self.tracks, self.times, self.adversary = situation.tracks, situation.times, situation.adversary
        self.path, self.station, self.speed = situation.path, situation.station, situation.speed
        self.relations, self.ignored = relations, ignored


def compute_ego_boxes(situation: DrivingSituation, step: int, free_from: int, station: Floats) -> Floats:
    """(2, 5) a driver's body after 0.05 and 0.1 s of a step: the recording's until it drives by itself.

    (K,) ``station`` are metres along the path at the instants of the situation.
    """
    share = np.arange(1, INSTANTS + 1) / INSTANTS
    if step < free_from:
        first, last = situation.times[step : step + 2]
        return situation.tracks.ego_at(first + share * (last - first))
    return situation.path.boxes(station[step] + share * (station[step + 1] - station[step]))


def _find_first_contact(
    course: SimulationConfig, world: WorldState, egos: Floats, moved: AgentMotion, time_us: int, ego_speed: float
) -> CollisionEvent | None:
    for row in range(INSTANTS):
        hit = moved.present[row] & ~world.ignored & boxes_overlap(egos[row][None], moved.boxes[row])
        if hit.any():
            agent = int(np.argmax(hit))
            return CollisionEvent(
                agent=agent,
                uuid=course.ids[agent],
                category=course.categories[agent],
                time_us=time_us + (row + 1) * INSTANT_US,
                ego=egos[row],
                ego_speed=ego_speed,
                other=moved.boxes[row, agent],
                other_velocity=moved.velocity[agent],
            )
    return None


def _build_outcome(touched: CollisionEvent, start_us: int) -> LadderOutcome:
    kind = KINDS[int(touched.pair.kinds[0])]
    seconds = round((touched.time_us - start_us) / 1e6, DECIMALS)
    return LadderOutcome(False, seconds, touched.uuid, kind.value, is_at_fault(kind, unsure=False))
