"""NeuroNCAP's car: half a second of a plan in five sub-steps of tracker and kinematic bicycle.

Explicit Euler without lags; the tracker is nuPlan's linear-quadratic regulator over one second, with the project's own
weights. The published code mixes single and double precision; switch ``float32`` repeats where it rounds, which costs
1e-4 m at map coordinates. Functions of angles are rounded from double precision: single ones differ in their last digit
from one numerical library to the next.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.extensions.neuroncap.contact import NeuroncapCar
from benchmark.extensions.neuroncap.plan_path import (
    SUBSTEP_S,
    SUBSTEP_US,
    PlanPath,
    build_path,
    is_stopping_plan,
    read_waypoints,
)
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix, wrap_angle
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches

HORIZON_STEPS: Final = 10
LARGEST_ACCELERATION: Final = 6.0
"""m/s^2, of either sign."""
STOPPING_GAIN: Final = 1.5
_STOPPING_SPEED: Final = 0.5
_SPEED_WEIGHT: Final = 10.0
_LATERAL_WEIGHT: Final = 20.0
_STEERING_WEIGHT: Final = 0.05
_HORIZON_S: Final = HORIZON_STEPS * SUBSTEP_S
_CRUISING_GAIN: Final = _SPEED_WEIGHT * _HORIZON_S / (_SPEED_WEIGHT * _HORIZON_S**2 + 1.0)
"""Least squares over the horizon of one constant acceleration, whose square costs 1."""


@dataclass(frozen=True, slots=True)
class TrackedCar:
    """Car as the tracker sees it: (3,) x, y, heading in the frame of the plan, m/s, radians of the wheels."""

    pose: Floats
    speed: float
    steering: float
    wheelbase_m: float


def compute_controls(path: PlanPath, now_us: int, car: TrackedCar, *, clip_first: bool) -> tuple[float, float]:
    """Acceleration, m/s^2, and steering rate, rad/s, that the tracker asks for.

    With ``clip_first`` steering is planned with the limited acceleration, else the acceleration is not limited.
    """
    now = now_us * 1e-6
    excess = car.speed - float(path.at(path.speed, now + _HORIZON_S))
    wanted = car.speed - excess
    if wanted <= _STOPPING_SPEED and car.speed <= _STOPPING_SPEED:
        return -STOPPING_GAIN * excess, 0.0
    acceleration = -_CRUISING_GAIN * excess
    if clip_first:
        acceleration = float(np.clip(acceleration, -LARGEST_ACCELERATION, LARGEST_ACCELERATION))
    ahead = np.arange(HORIZON_STEPS)
    curvature = path.at(path.curvature, [now + SUBSTEP_S * step for step in ahead.tolist()])
    travel = SUBSTEP_S * (car.speed + SUBSTEP_S * acceleration * ahead)
    lateral, heading = _compute_tracking_errors(path, now_us, car.pose)
    free, response = _predict_lateral_error(travel, curvature, (lateral, heading, car.steering), car.wheelbase_m)
    rate = -_LATERAL_WEIGHT * response * free / (_LATERAL_WEIGHT * response**2 + _STEERING_WEIGHT)
    return acceleration, rate


def _compute_tracking_errors(path: PlanPath, now_us: int, pose: Floats) -> tuple[float, float]:
    """How far left of the path the car is, and how far it is turned left of it."""
    at = min(round((now_us - path.start_us) * 1e-6 / SUBSTEP_S), len(path.poses) - 1)
    x, y, heading = path.poses[at]
    lateral = np.cos(heading) * (pose[1] - y) - np.sin(heading) * (pose[0] - x)
    return float(lateral), float(wrap_angle(np.array(pose[2] - heading)))


def _predict_lateral_error(
    travel: Floats, curvature: Floats, start: tuple[float, float, float], wheelbase_m: float
) -> tuple[float, float]:
    """Lateral error at the end of the horizon without steering, and what a steering rate of one adds to it."""
    lateral, heading, steering = start
    more_lateral = more_heading = more_steering = 0.0
    for metres, bend in zip(travel.tolist(), curvature.tolist()):
        lateral += metres * heading
        heading += metres * (steering / wheelbase_m - bend)
        more_lateral += metres * more_heading
        more_heading += metres * more_steering / wheelbase_m
        more_steering += SUBSTEP_S
    return lateral, more_lateral


SUBSTEPS: Final = 5
STEP_US: Final = SUBSTEPS * SUBSTEP_US
_STEERING_RATIO: Final = 16.0
"""Of the steering wheel to the wheels."""
_LARGEST_STEERING_RAD: Final = np.pi / 3
_GRAVITY: Final = 9.8
_ACCELERATION_X, _YAW_RATE, _VELOCITY_X = 7, 12, 13
"""Columns of a CAN row."""
_single = np.float32


@dataclass(frozen=True, slots=True)
class Vehicle:
    """State of the car; values that the published code has in single precision are such numbers here.

    The pose is that of the rear axle, global; metres, radians and seconds, the speed may become negative. `steering` is
    of the wheels; a `fresh` car has not moved yet: its pose is still in single precision.
    """

    x: float
    y: float
    heading: float
    speed: float
    acceleration: float
    steering: float
    yaw_rate: float
    yaw_acceleration: float = 0.0
    steering_rate: float = 0.0
    fresh: bool = True

    @classmethod
    def start(
        cls, pose: Floats, canbus: NDArray[np.float32], steering_wheel_rad: float, switches: NeuroncapSwitches
    ) -> Self:
        """The car as it begins to drive itself, by the (4, 4) pose of its rear axle and (16,) CAN row of the state."""
        rounded = switches.float32 == "code"
        at = np.asarray(np.asarray(pose, _single) if rounded else pose, np.float64)
        heading = float(np.arctan2(at[1, 0], at[0, 0]))
        return cls(
            x=float(at[0, 3]),
            y=float(at[1, 3]),
            heading=float(_single(heading)) if rounded else heading,
            speed=float(canbus[_VELOCITY_X]),
            acceleration=float(canbus[_ACCELERATION_X]),
            steering=float(steering_wheel_rad) / _STEERING_RATIO,
            yaw_rate=float(canbus[_YAW_RATE]),
        )

    @property
    def columns(self) -> tuple[float, ...]:
        """x, y, heading, speed, acceleration, steering angle, yaw rate, yaw acceleration, steering rate."""
        moved = (self.x, self.y, self.heading, self.speed, self.acceleration, self.steering)
        return (*moved, self.yaw_rate, self.yaw_acceleration, self.steering_rate)

    @property
    def pose(self) -> Floats:
        """(4, 4) rear axle to global; flat on the ground at height 0."""
        return transform_matrix(quaternion_from_yaw(np.array(self.heading)), [self.x, self.y, 0.0])

    def canbus(self, car: NeuroncapCar, switches: NeuroncapSwitches) -> NDArray[np.float32]:
        """(16,) row as the engine reports it: position, rotation w x y z, acceleration, rotation rate, velocity."""
        turn, change, ahead = self.yaw_rate, self.yaw_acceleration, car.centre_ahead_m
        if switches.can_acceleration == "code":
            along, across = self.acceleration + ahead * (turn**2 + change), 0.0
        else:
            along, across = self.acceleration - ahead * turn**2, ahead * change
        rotation = quaternion_from_yaw(np.array(self.heading)).tolist()
        velocity = (self.speed, ahead * turn, 0.0)
        return np.array([self.x, self.y, 0.0, *rotation, along, across, _GRAVITY, 0.0, 0.0, turn, *velocity], _single)


@dataclass(frozen=True, slots=True)
class VehicleStep:
    """Half a second of driving: (5, 9) `Vehicle.columns` after each sub-step, and commands before and after the limit.

    Commands are (5, 2) acceleration and steering rate.
    """

    vehicle: Vehicle
    states: Floats
    commands: Floats
    unlimited: Floats


def drive_plan(
    vehicle: Vehicle, plan: ArrayLike, time_us: int, car: NeuroncapCar, switches: NeuroncapSwitches
) -> VehicleStep:
    """Follow a plan for 0.5 s: (1 to 6, 2) x forward and y left of the rear axle now, metres, 0.5 s apart."""
    waypoints = read_waypoints(plan, switches)
    stopping, reinserted = is_stopping_plan(waypoints), switches.reinsertion == "code"
    path: PlanPath | None = None
    origin, states, commands, unlimited = vehicle, [], [], []
    for number in range(SUBSTEPS):
        now_us = time_us + number * SUBSTEP_US
        if stopping:
            controls = -STOPPING_GAIN * vehicle.speed, 0.0
        else:
            if path is None or reinserted:
                path = build_path(waypoints, time_us, now_us)
            pose = np.zeros(3) if reinserted else _compute_relative_pose(origin, vehicle)
            tracked = TrackedCar(pose, vehicle.speed, vehicle.steering, car.wheelbase_m)
            controls = compute_controls(path, now_us, tracked, clip_first=switches.acceleration_clip == "paper")
        limited = float(np.clip(controls[0], -LARGEST_ACCELERATION, LARGEST_ACCELERATION))
        vehicle = _move(vehicle, limited, controls[1], car, rounded=switches.float32 == "code")
        states.append(vehicle.columns)
        commands.append((limited, controls[1]))
        unlimited.append(controls)
    return VehicleStep(vehicle, np.array(states), np.array(commands), np.array(unlimited))


def _compute_relative_pose(origin: Vehicle, vehicle: Vehicle) -> Floats:
    """(3,) pose of a car in the frame of another."""
    dx, dy = vehicle.x - origin.x, vehicle.y - origin.y
    cos, sin = np.cos(origin.heading), np.sin(origin.heading)
    turned = float(wrap_angle(np.array(vehicle.heading - origin.heading)))
    return np.array([dx * cos + dy * sin, dy * cos - dx * sin, turned])


def _move(now: Vehicle, acceleration: float, steering_rate: float, car: NeuroncapCar, *, rounded: bool) -> Vehicle:
    """One explicit step of the bicycle; all that it reads is of before the step."""
    turned = SUBSTEP_S * now.speed * np.tan(now.steering) / car.wheelbase_m
    if rounded and now.fresh:
        # The first sub-step is in single precision: its grid is 1.2e-4 m wide at coordinates over 1024.
        forward = _single(SUBSTEP_S) * _single(now.speed)
        x = float(_single(now.x) + forward * _single(np.cos(now.heading)))
        y = float(_single(now.y) + forward * _single(np.sin(now.heading)))
        new_heading = float(_single(wrap_angle(np.array(now.heading + turned))))
    else:
        x = now.x + SUBSTEP_S * now.speed * float(np.cos(now.heading))
        y = now.y + SUBSTEP_S * now.speed * float(np.sin(now.heading))
        new_heading = float(wrap_angle(np.array(now.heading + turned)))
    speed = now.speed + SUBSTEP_S * acceleration
    if rounded:
        acceleration = float((_single(acceleration) - _single(now.acceleration)) + _single(now.acceleration))
        speed = float(_single(now.speed) + _single(SUBSTEP_S) * _single(acceleration))
    steering = float(np.clip(now.steering + SUBSTEP_S * steering_rate, -_LARGEST_STEERING_RAD, _LARGEST_STEERING_RAD))
    yaw_rate = float(speed * np.tan(steering) / car.wheelbase_m)
    change = (yaw_rate - now.yaw_rate) / SUBSTEP_S
    return Vehicle(x, y, new_heading, speed, acceleration, steering, yaw_rate, change, steering_rate, fresh=False)
