"""Where a plan's waypoints are: the one conversion between the frames of plans, and the car's heading along a plan."""

import numpy as np

from benchmark.geometry import Floats, directions_of


def waypoints_in_lidar(waypoints: Floats, frame: str, lidar_ahead_m: float | Floats) -> Floats:
    """Waypoints as positions of the lidar origin, x right, y forward: what every protocol reads.

    From ``ego`` the reference point moves ahead along the heading of each step (`chord_headings`), because the lidar
    turns with the car.

    Args:
        waypoints: (..., N, 2) metres.
        frame: ``lidar`` or ``ego`` (`benchmark.planning.PlanFrame`).
        lidar_ahead_m: Lidar origin ahead of the rear axle; one number, or (...) of them.

    Returns:
        (..., 6, 2) metres.
    """
    if frame == "lidar":
        return waypoints
    heading = chord_headings(waypoints, start_heading_rad=0.0)
    own = np.asarray(lidar_ahead_m, np.float64)[..., None]
    ahead = waypoints + own[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return points_in_lidar(ahead, own)


def points_in_lidar(points_ego: Floats, lidar_ahead_m: float | Floats) -> Floats:
    """Points of the ego frame in the lidar frame: a rigid motion, unlike that of a plan, which moves its own point.

    (..., 2) x forward, y left of the rear axle become x right, y forward of the lidar origin, in metres.
    """
    return np.stack([-points_ego[..., 1], points_ego[..., 0] - lidar_ahead_m], axis=-1)


def points_in_ego(points_lidar: Floats, lidar_ahead_m: float) -> Floats:
    """The way back from `points_in_lidar`."""
    return np.stack([points_lidar[..., 1] + lidar_ahead_m, -points_lidar[..., 0]], axis=-1)


def chord_headings(waypoints: Floats, *, start_heading_rad: float, hold_below_m: float = 0.3) -> Floats:
    """Heading at each waypoint: direction of the chord between its neighbours, held where the car hardly moves.

    The rule of the ``exact`` protocol: chord from waypoint k-1 to k+1 (the start is the origin; the last step
    uses the last segment) if it is at least ``hold_below_m`` long, else the previous heading.

    Args:
        waypoints: (..., 6, 2) metres, relative to the start.
        start_heading_rad: Heading at the start.
        hold_below_m: Shortest chord that is trusted.

    Returns:
        (..., 6) radians.
    """
    waypoints = np.asarray(waypoints, np.float64)
    start = np.zeros((*waypoints.shape[:-2], 1, 2))
    path = np.concatenate([start, waypoints], axis=-2)
    behind, ahead = path[..., :-1, :], np.concatenate([path[..., 2:, :], path[..., -1:, :]], axis=-2)
    chord = ahead - behind
    long_enough, directions = np.hypot(chord[..., 0], chord[..., 1]) >= hold_below_m, directions_of(chord)
    headings = np.empty(waypoints.shape[:-1])
    held = np.full(waypoints.shape[:-2], start_heading_rad, dtype=np.float64)
    for step in range(waypoints.shape[-2]):
        held = np.where(long_enough[..., step], directions[..., step], held)
        headings[..., step] = held
    return headings
