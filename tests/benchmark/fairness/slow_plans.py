"""What a plan's severity is, one sample and one agent at a time: with polygons, and the encounter that is verified."""

import numpy as np
from shapely.geometry import Polygon

from benchmark.constants import PLAN_STEPS
from benchmark.fairness.severity_series import SeveritySeries, measure_severity
from benchmark.geometry import Floats, box_corners, ego_footprints, poses_between
from benchmark.interactions.contacts import KINDS, ContactPairs, is_agent_category
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.truth import SampleTruth
from benchmark.waypoints import chord_headings

TIMES = 0.1 * np.arange(31)


def ego_of(plan_lidar: Floats) -> Floats:
    """(31, 5) the ego along a plan."""
    start = np.array([0.0, 0.0, np.pi / 2])
    ways = np.vstack([start, np.column_stack([plan_lidar, chord_headings(plan_lidar, start_heading_rad=np.pi / 2)])])
    poses = [start]
    for step in range(PLAN_STEPS):
        poses += [poses_between(ways[step], ways[step + 1], np.array(part / 5)) for part in range(1, 6)]
    return np.array([ego_footprints(pose) for pose in poses])


def tracks_of(truth: SampleTruth, ego: Floats) -> ContinuousTracks:
    """The world of the next 3 s in steps of 0.1 s."""
    keyframes = ContinuousTracks(0.5 * np.arange(7), np.zeros((7, 5)), truth.boxes, truth.annotated, truth.categories)
    boxes, valid = keyframes.agents_at(TIMES)
    return ContinuousTracks(TIMES, ego, boxes, valid, truth.categories)


def first_contact(truth: SampleTruth, plan_lidar: Floats) -> tuple[float, str, str, float] | None:
    """When, whom, of what kind and how fast."""
    ego = ego_of(plan_lidar)
    tracks = tracks_of(truth, ego)
    shapes = [[Polygon(corners) for corners in box_corners(boxes)] for boxes in tracks.agents]
    own = [Polygon(corners) for corners in box_corners(ego)]
    ignored = [bool(tracks.valid[row, 0]) and own[0].intersects(shapes[row][0]) for row in range(len(tracks))]
    for at in range(1, len(TIMES)):
        hit = [row for row in range(len(tracks)) if tracks.valid[row, at] and own[at].intersects(shapes[row][at])]
        hit = [row for row in hit if not ignored[row]]
        if hit:
            row = min(hit, key=lambda one: truth.instances[one])
            back = max(at - 2, 0)
            speed = float(np.hypot(*(ego[at, :2] - ego[back, :2]))) / (0.1 * (at - back))
            pair = ContactPairs(
                ego=ego[at, None], ego_speed=np.array([speed]), other=tracks.agents[row, at, None],
                other_velocity=tracks.velocities_at(TIMES[at : at + 1], np.array([row]))[0],
                is_agent=np.array([is_agent_category(truth.categories[row])]),
            )  # fmt: skip
            return float(TIMES[at]), truth.instances[row], KINDS[pair.kinds[0]].value, float(pair.impact_speed[0])
    return None


def encounters(truth: SampleTruth, plan_lidar: Floats) -> list[SeveritySeries]:
    """With every adversary that does not touch the ego in the present."""
    ego = ego_of(plan_lidar)
    tracks = tracks_of(truth, ego)
    found = []
    for row, name in enumerate(truth.instances):
        if name not in truth.adversaries or not tracks.valid[row].any():
            continue
        now = Polygon(box_corners(ego)[0]).intersects(Polygon(box_corners(tracks.agents[row])[0]))
        if not (now and tracks.valid[row, 0]):
            found.append(measure_severity(tracks, row))
    return found
