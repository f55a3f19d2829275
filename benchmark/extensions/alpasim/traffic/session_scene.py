"""A traffic session as a `Scene` at 12 Hz, so that what is searched, driven and written here knows no other world.

A frame and a keyframe are at the hand-over. Its ego is what was seen up to then and stands from then on: whoever looks
at later frames sees nothing that was recorded.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import (
    EGO_CENTER_FROM_REAR_AXLE_M,
    FOUR_WHEELED_CATEGORIES,
    FRAME_HZ,
    FRAMES_PER_KEYFRAME,
    LIDAR_FROM_REAR_AXLE_M,
)
from benchmark.extensions.alpasim.poses import SECOND_US
from benchmark.extensions.alpasim.traffic.corridor import estimate_road
from benchmark.extensions.alpasim.traffic.session_log import LoggedTrack, SessionLog
from benchmark.geometry import Floats, quaternion_from_yaw, to_global, to_local, wrap_angle
from benchmark.machine.storage import make_token
from benchmark.road_map import RoadMap
from benchmark.scene import Agents, Annotations, EgoTrack, LidarMount, Scene

AHEAD_S: Final = 3.0
"""The ego's own lane goes on so far where it drives when the session begins."""


@dataclass(frozen=True, slots=True)
class MapFrame:
    """A map, and where the session's local frame is in it: (3,) x, y, yaw of its origin."""

    road_map: RoadMap
    origin: Floats

    def to_map(self, poses: Floats) -> Floats:
        """(..., 3) local poses in the map's frame."""
        if not self.origin.any():
            return poses
        place = to_global(poses[..., :2], self.origin)
        return np.concatenate([place, wrap_angle(poses[..., 2:] + self.origin[2])], axis=-1)

    def to_session(self, poses: Floats) -> Floats:
        """(..., 3) poses of the map's frame in the local one."""
        if not self.origin.any():
            return poses
        place = to_local(poses[..., :2], self.origin)
        return np.concatenate([place, wrap_angle(poses[..., 2:] - self.origin[2])], axis=-1)


def compute_frames(log: SessionLog) -> NDArray[np.int64]:
    """(T,) times of frames, microseconds: whole half seconds before the hand-over, and on to the end of the logs."""
    known = (log.handover_us - log.first_us) * FRAME_HZ // SECOND_US
    later = (log.last_us - log.handover_us) * FRAME_HZ // SECOND_US
    first = -int(known) // FRAMES_PER_KEYFRAME * FRAMES_PER_KEYFRAME if known else 0
    first += FRAMES_PER_KEYFRAME if -first > known else 0
    steps = np.arange(first, max(int(later), FRAME_HZ) + 1)
    return np.asarray(log.handover_us + np.round(steps * SECOND_US / FRAME_HZ).astype(np.int64))


def estimate_frame(log: SessionLog) -> MapFrame:
    """The corridor of a session without a map."""
    driven = [
        (track.uuid, np.column_stack([track.poses.position[:, :2], _headings(track)]), track.size)
        for track in log.others
        if track.category in FOUR_WHEELED_CATEGORIES
    ]
    ego, yaw = log.ego.resample(log.ego.poses.times_us)
    poses = np.column_stack([ego[:, :2], yaw])
    times = np.array([log.handover_us - SECOND_US // 2, log.handover_us])
    reach = float(np.hypot(*np.diff(log.ego.resample(times)[0][:, :2], axis=0)[0])) * 2.0 * AHEAD_S
    ahead = poses[-1] + np.outer([0.5 * reach, reach], [np.cos(yaw[-1]), np.sin(yaw[-1]), 0.0])
    driven.append((log.ego.uuid, np.concatenate([poses, ahead]), log.ego.size))
    return MapFrame(estimate_road(driven), np.zeros(3))


def build_scene(log: SessionLog, frame: MapFrame, adversary: str = "") -> Scene:
    """The scene of a session, with an adversary by its name where there is one."""
    times = compute_frames(log)
    keyframes = np.arange(0, len(times), FRAMES_PER_KEYFRAME)
    agents = _build_agents(log.others, times, frame)
    position, yaw = log.ego.resample(np.minimum(times, log.handover_us))
    pose = frame.to_map(np.column_stack([position[:, :2], yaw]))
    heading = np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    axle = pose[:, :2] - EGO_CENTER_FROM_REAR_AXLE_M * heading
    height = position[:, 2] - 0.5 * log.ego.size[2]
    name = log.scene_id or "session"
    return Scene(
        name=name,
        token=make_token("traffic session", name, log.seed),
        description="",
        log=name,
        vehicle="",
        date="",
        timestamps_us=times,
        keyframes=keyframes,
        ego=EgoTrack(
            np.column_stack([axle, height]),
            quaternion_from_yaw(pose[:, 2]),
            float(log.ego.size[0]),
            float(log.ego.size[1]),
        ),
        agents=agents,
        annotations=annotate(agents, keyframes),
        cameras=(),
        lidar=LidarMount(np.array([LIDAR_FROM_REAR_AXLE_M, 0.0, 1.84]), quaternion_from_yaw(np.array(-np.pi / 2))),
        road_map=frame.road_map,
        adversaries=(adversary,) if adversary else (),
    )


def annotate(agents: Agents, keyframes: NDArray[np.int64]) -> Annotations:
    """Annotations of agents at (K,) frames; each box has one lidar point, since metrics drop boxes without any."""
    valid = agents.valid[:, keyframes]
    return Annotations(
        position=agents.position[:, keyframes],
        rotation=quaternion_from_yaw(agents.yaw[:, keyframes]),
        size=np.repeat(agents.size[:, None], len(keyframes), axis=1),
        valid=valid,
        attribute=np.full(valid.shape, "", dtype=np.str_),
        visibility=np.zeros(valid.shape, np.int64),
        num_lidar_pts=valid.astype(np.int64),
        num_radar_pts=np.zeros(valid.shape, np.int64),
    )


def _build_agents(tracks: tuple[LoggedTrack, ...], times: NDArray[np.int64], frame: MapFrame) -> Agents:
    position, yaw = np.zeros((len(tracks), len(times), 3)), np.zeros((len(tracks), len(times)))
    valid = np.zeros(yaw.shape, np.bool_)
    for row, track in enumerate(tracks):
        place, heading = track.resample(times)
        pose = frame.to_map(np.column_stack([place[:, :2], wrap_angle(heading)]))
        position[row, :, :2], position[row, :, 2], yaw[row] = pose[:, :2], place[:, 2], pose[:, 2]
        valid[row] = (times >= track.poses.times_us[0]) & (times <= track.poses.times_us[-1])
    return Agents(
        ids=tuple(track.uuid for track in tracks),
        categories=tuple(track.category for track in tracks),
        position=position,
        yaw=yaw,
        size=np.array([track.size for track in tracks]).reshape(len(tracks), 3),
        valid=valid,
    )


def _headings(track: LoggedTrack) -> Floats:
    return track.resample(track.poses.times_us)[1]
