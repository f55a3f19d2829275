"""NeuroNCAP's loop as pure steps: a world and a plan give the next world; no clock, no input, no output.

One step is half a second of whole microseconds. In it the order is fixed:

1. the state before this one is checked for contact, at its own pose or at ten instants on the way to it; the first
   contact ends the run, and the plan is dropped;
2. while priming, the next recorded frame is taken; afterwards the car drives.

So a state is checked one step late, as in the published code, and the last one that was planned from by `finish_run`.

Also the open-loop rates beside the score (each plan laid out rigidly against what actors will do), and the driving
command: where the recorded path lies three seconds ahead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from benchmark.constants import COMMAND_LATERAL_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.extensions.neuroncap.actors import Actor, interpolate_pose
from benchmark.extensions.neuroncap.contact import EgoMoment, NeuroncapCar, NeuroncapContact, find_contact
from benchmark.extensions.neuroncap.plan_path import WAYPOINT_US, read_waypoints
from benchmark.extensions.neuroncap.recording import NeuroncapRecording, Singles
from benchmark.extensions.neuroncap.staging import StagedRun
from benchmark.extensions.neuroncap.vehicle import STEP_US, Vehicle, VehicleStep, drive_plan
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix
from benchmark.planning import Command
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches

_AHEAD_S: Final = 3.0
_SLOWEST_M_S: Final = 2.0
_EXTENSION_M: Final = 100.0


def extend_path(path: Floats, switches: NeuroncapSwitches) -> Floats:
    """The recorded (F, 3) path of x, y, yaw, continued for 100 m as (F + 1, 2) positions.

    By the switches, the continuation divides by the norm of the last step with its turn in it, or follows the last step
    that moves. As ``code``, the last position is not finite where the last two frames are the same, and a recording
    that stands makes every command straight.
    """
    steps = np.diff(path, axis=0)
    if switches.command_extension == "paper":
        moving = np.flatnonzero(np.linalg.norm(steps[:, :2], axis=1) > 0)
        yaw = path[-1, 2]
        last = steps[moving[-1], :2] if len(moving) else np.array([np.cos(yaw), np.sin(yaw)])
    else:
        last = steps[-1]
    with np.errstate(invalid="ignore"):
        end = path[-1, :2] + _EXTENSION_M * last[:2] / np.linalg.norm(last)
    return np.concatenate([path[:, :2], end[None]])


def compute_command(pose: Floats, speed: float, path: Floats, switches: NeuroncapSwitches) -> Command:
    """Command of a (4, 4) rear-axle pose: left or right where the path lies over 2 m to that side, else straight.

    Asked is the point of the recording's (F, 3) path nearest to the point three seconds straight ahead.
    """
    extended = extend_path(path, switches)
    ahead = (pose @ np.array([_AHEAD_S * max(speed, _SLOWEST_M_S), 0.0, 0.0, 1.0]))[:2]
    start, step = extended[:-1], np.diff(extended, axis=0)
    squared = np.sum(step**2, axis=1)
    if switches.command_extension == "code" and not (squared > 0).all():
        # Two equal samples in a row give 0 / 0 in the published code; NaN compares as neither left nor right.
        return Command.STRAIGHT
    share = np.sum((ahead - start) * step, axis=1) / np.where(squared > 0, squared, 1.0)
    nearest = start + np.clip(share, 0.0, 1.0)[:, None] * step
    point = nearest[int(np.argmin(np.linalg.norm(nearest - ahead, axis=1)))]
    left = float(np.linalg.inv(pose[:2, :2])[1] @ (point - pose[:2, 3]))
    if left > COMMAND_LATERAL_M:
        return Command.LEFT
    return Command.RIGHT if left < -COMMAND_LATERAL_M else Command.STRAIGHT


_STILL_M: Final = 0.2
"""Next waypoints nearer than this to the origin give no heading."""


def find_future_hits(
    future: Sequence[EgoMoment], actors: Sequence[Actor], car: NeuroncapCar, switches: NeuroncapSwitches
) -> tuple[bool, ...]:
    """Whether a plan touches an actor at 0.5, 1.0 .. 3.0 s: six verdicts on `compute_future_moments`."""
    contacts = (find_contact(moment, actors, car, switches) for moment in future)
    return tuple(contact is not None for contact in contacts)


def compute_future_moments(time_us: int, pose: Floats, plan: ArrayLike, switches: NeuroncapSwitches) -> list[EgoMoment]:
    """Ego at 0.5, 1.0 .. 3.0 s by a plan, (6, 2) x forward and y left, laid out rigidly from its (4, 4) rear axle.

    As ``plan_3s`` code, the pose at 3 s is that of 2.5 s. Speeds are the published code's, and decide nothing.
    """
    waypoints = np.asarray(plan, np.float64)[:, :2]
    around = np.concatenate([np.zeros((1, 2)), waypoints, waypoints[-1:]])
    spans = np.linalg.norm(around[2:] - around[:-2], axis=1)
    moments, last = [], PLAN_STEPS - 2
    for step in range(PLAN_STEPS):
        chord, end = waypoints[min(step, last) + 1] - waypoints[min(step, last)], waypoints[min(step, last) + 1]
        yaw = float(np.arctan2(chord[1], chord[0])) if np.linalg.norm(end) >= _STILL_M else 0.0
        position = waypoints[min(step, last) if switches.plan_3s == "code" else step]
        planned = transform_matrix(quaternion_from_yaw(np.array(yaw)), [*position, 0.0])
        seconds = PLAN_STEP_S * (step + 1)
        moments.append(EgoMoment(time_us + WAYPOINT_US * (step + 1), pose @ planned, float(spans[step] / seconds)))
    return moments


_INSTANTS: Final = 10
"""Of contact within a step."""
_INSTANT_US: Final = STEP_US // _INSTANTS
_STEP_S: Final = STEP_US / 1e6
_NO_TIME_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class NeuroncapEgoState:
    """Ego at a planning instant: (4, 4) rear axle to global, (16,) CAN row; a recorded frame unless `is_driven`."""

    time_us: int
    pose: Floats
    canbus: Singles
    is_driven: bool

    @property
    def speed(self) -> np.float32:
        """Size of the planar velocity that the CAN row has, m/s, in its precision."""
        return np.float32(np.linalg.norm(self.canbus[13:15]))

    def moment(self, switches: NeuroncapSwitches) -> EgoMoment:
        """The ego as contact sees it."""
        return EgoMoment(self.time_us, self.pose, float(self.impact_speed(switches)))

    def impact_speed(self, switches: NeuroncapSwitches) -> np.float32:
        """Speed along the heading that counts at a contact: that of the centre, or of the rear axle."""
        return self.speed if switches.impact_speed_of_ego == "code" else np.float32(self.canbus[13])


@dataclass(frozen=True, slots=True)
class Engine:
    """Constants of a run; `path` (F, 3) is the recording's, `priming_steps` are those of a recorded ego.

    No state from `end_us` on is planned from; `check_futures` lays plans out against the future, too.
    """

    recording: NeuroncapRecording
    path: Floats
    actors: tuple[Actor, ...]
    start_frame: int
    end_us: int
    priming_steps: int
    switches: NeuroncapSwitches
    car: NeuroncapCar
    check_futures: bool = False

    @classmethod
    def of(
        cls,
        recording: NeuroncapRecording,
        run: StagedRun,
        *,
        priming_steps: int,
        renderer_knows: frozenset[str],
        switches: NeuroncapSwitches,
        check_futures: bool = False,
    ) -> "Engine":
        """Engine for one run, with `priming_steps` of the recorded ego.

        Only recorded actors that `renderer_knows` can be shown: with a scenario they are gone unless it lists them. The
        published code lets actors that the renderer does not know stand where they were.
        """
        others = recording.actors
        if run.actors:
            others = tuple(actor for actor in others if actor.uuid not in renderer_knows)
        return cls(
            recording=recording,
            path=recording.path,
            actors=(*others, *run.actors),
            start_frame=run.start_frame,
            end_us=run.end_us,
            priming_steps=priming_steps,
            switches=switches,
            car=NeuroncapCar.of(switches),
            check_futures=check_futures,
        )

    def frame(self, number: int) -> NeuroncapEgoState:
        """A recorded frame as a state."""
        recording = self.recording
        return NeuroncapEgoState(int(recording.times[number]), recording.poses[number], recording.canbus[number], False)


@dataclass(frozen=True, slots=True)
class UncheckedState:
    """A state that is not checked yet, with the one before and the plan made from it, ``None`` where there is none."""

    before: NeuroncapEgoState | None
    state: NeuroncapEgoState
    plan: Floats | None


@dataclass(frozen=True, slots=True)
class NeuroncapWorld:
    """A run at a planning instant; `vehicle` and `last`, its sub-steps, are there once it drives itself.

    `waiting` is the state one step ago with its plan, not checked yet; `checked` counts states, `future_hits` checked
    plans that touch an actor at 0.5, 1.0 .. 3.0 s.
    """

    step: int
    state: NeuroncapEgoState
    vehicle: Vehicle | None = None
    before: NeuroncapEgoState | None = None
    waiting: UncheckedState | None = None
    checked: int = 0
    contact: NeuroncapContact | None = None
    future_hits: tuple[int, ...] = (0,) * PLAN_STEPS
    last: VehicleStep | None = None


def begin(engine: Engine) -> NeuroncapWorld:
    """The world at the start frame."""
    return NeuroncapWorld(step=0, state=engine.frame(engine.start_frame))


def is_running(engine: Engine, world: NeuroncapWorld) -> bool:
    """Whether a plan is needed: no contact so far, and time is left."""
    return world.contact is None and world.state.time_us < engine.end_us


def find_command(engine: Engine, world: NeuroncapWorld) -> Command:
    """The driving command of a world's state."""
    return compute_command(world.state.pose, float(world.state.speed), engine.path, engine.switches)


def step(engine: Engine, world: NeuroncapWorld, plan: ArrayLike) -> NeuroncapWorld:
    """Advance a world by half a second; it stays, with a contact, if the state before turned out to touch an actor.

    ``plan`` is (1 to 6, 2), x forward and y left of the rear axle, metres, 0.5 s apart, and not driven while priming.
    """
    world = _check_waiting(engine, world)
    if world.contact is not None:
        return world
    waypoints = np.asarray(read_waypoints(plan, engine.switches), np.float64)
    waiting = UncheckedState(world.before, world.state, waypoints)
    state, vehicle, last = _advance(engine, world, plan)
    return replace(
        world, step=world.step + 1, state=state, vehicle=vehicle, before=world.state, waiting=waiting, last=last
    )


def finish_run(engine: Engine, world: NeuroncapWorld) -> NeuroncapWorld:
    """The world after its last state was checked; with ``last_state`` as paper also the state that was reached."""
    world = _check_waiting(engine, world)
    if world.contact is None and engine.switches.last_state == "paper":
        world = _check_waiting(engine, replace(world, waiting=UncheckedState(world.before, world.state, None)))
    return world


def _advance(
    engine: Engine, world: NeuroncapWorld, plan: ArrayLike
) -> tuple[NeuroncapEgoState, Vehicle | None, VehicleStep | None]:
    if world.step < engine.priming_steps:
        return engine.frame(engine.start_frame + world.step + 1), None, None
    state, switches = world.state, engine.switches
    vehicle = world.vehicle
    if vehicle is None:
        frame = engine.priming_steps + (engine.start_frame if switches.steering_index == "paper" else 0)
        wheel = float(engine.recording.steering_wheel[frame])
        vehicle = Vehicle.start(state.pose, state.canbus, wheel, switches)
    last = drive_plan(vehicle, plan, state.time_us, engine.car, switches)
    row = last.vehicle.canbus(engine.car, switches)
    return NeuroncapEgoState(state.time_us + STEP_US, last.vehicle.pose, row, True), last.vehicle, last


def _check_waiting(engine: Engine, world: NeuroncapWorld) -> NeuroncapWorld:
    """The world with the waiting state checked, if there is one."""
    waiting = world.waiting
    if waiting is None:
        return world
    switches, contact = engine.switches, None
    for moment in compute_moments(waiting.before, waiting.state, switches):
        contact = find_contact(moment, engine.actors, engine.car, switches)
        if contact is not None:
            break
    hits = world.future_hits
    if engine.check_futures and waiting.plan is not None and len(waiting.plan) == PLAN_STEPS:
        state = waiting.state
        future = compute_future_moments(state.time_us, state.pose, waiting.plan, switches)
        plan_hits = find_future_hits(future, engine.actors, engine.car, switches)
        hits = tuple(count + hit for count, hit in zip(hits, plan_hits))
    return replace(world, waiting=None, checked=world.checked + 1, contact=contact, future_hits=hits)


def compute_moments(
    before: NeuroncapEgoState | None, state: NeuroncapEgoState, switches: NeuroncapSwitches
) -> list[EgoMoment]:
    """Instants at which a state is checked, in order of time: its own, or ten on the way to it.

    With ``first_gap`` as paper, there are ten on the way to the first driven state, too.
    """
    on_the_way = before is not None and state.is_driven and (before.is_driven or switches.first_gap == "paper")
    if before is None or not on_the_way:
        return [state.moment(switches)]
    instants = []
    for instant in range(1, _INSTANTS + 1):
        fraction = instant * _INSTANT_US / 1e6 / (_STEP_S + _NO_TIME_S)
        first, second = before.impact_speed(switches), state.impact_speed(switches)
        speed = np.float32(first + np.float32(instant / _INSTANTS) * np.float32(second - first))
        pose = interpolate_pose(before.pose, state.pose, fraction)
        instants.append(EgoMoment(before.time_us + instant * _INSTANT_US, pose, float(speed)))
    return instants
