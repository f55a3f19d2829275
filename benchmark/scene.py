"""A recorded or generated driving scene: what happened, seen by whom, on which road.

Metres, radians, seconds; right-handed, x forward, y left, yaw counter-clockwise; global frame. Whether an agent is
there is a mask (``valid``); where it is not, the arrays hold the nearest valid value, never NaN and never zero.
"""

import re
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.geometry import Bools, Floats, quaternion_from_yaw, yaw_of_quaternion
from benchmark.report.terminal import html_table
from benchmark.road_map import Handedness, RoadMap


class Conditions(StrEnum):
    """Light and weather of a scene, as its description says."""

    DAY = "day"
    DUSK = "dusk"
    NIGHT = "night"
    RAIN = "rain"

    @classmethod
    def find_in(cls, description: str) -> tuple["Conditions", ...]:
        """Every look that a scene description names; none where it names none: nuScenes never says that it is day."""
        words = description.lower()
        return tuple(look for look in cls if re.search(rf"\b{look.value}", words))

    @classmethod
    def from_description(cls, description: str) -> "Conditions":
        """Read the look from a nuScenes scene description, which names night and rain in words."""
        named = cls.find_in(description)
        return next((look for look in (cls.RAIN, cls.NIGHT, cls.DUSK) if look in named), cls.DAY)


UNUSUAL: Final = MappingProxyType({"unusual": True})
"""Of a field that came later: content keys know it only where its value is not the default."""


@dataclass(frozen=True, slots=True)
class Camera:
    """One calibrated camera.

    Attributes:
        name: nuScenes channel, for example ``CAM_FRONT``.
        translation: (3,) camera origin in the ego frame, metres.
        rotation: (4,) quaternion w, x, y, z that turns camera axes (x right, y down, z forward) into ego axes.
        intrinsic: (3, 3) pinhole matrix, pixels.
        width: Image width, pixels.
        height: Image height, pixels.
    """

    name: str
    translation: Floats
    rotation: Floats
    intrinsic: Floats
    width: int
    height: int

    def resized(self, width: int, height: int) -> Self:
        """The same camera with another image size; the intrinsic scales with it."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsic=scale @ self.intrinsic, width=width, height=height)


@dataclass(frozen=True, slots=True)
class LidarMount:
    """Where LIDAR_TOP sits.

    Attributes:
        translation: (3,) metres in the ego frame.
        rotation: (4,) quaternion; nuScenes' lidar looks with +y forward.
    """

    translation: Floats
    rotation: Floats


@dataclass(frozen=True, slots=True)
class EgoTrack:
    """Recorded motion of the ego vehicle; the origin is the rear axle on the ground.

    Attributes:
        position: (T, 3) metres.
        rotation: (T, 4) quaternions.
        length_m: Of the body, as is ``width_m``; another car's in other simulators alone.
    """

    position: Floats
    rotation: Floats
    length_m: float = field(default=EGO_LENGTH_M, metadata=UNUSUAL)
    width_m: float = field(default=EGO_BODY_WIDTH_M, metadata=UNUSUAL)

    @property
    def yaw(self) -> Floats:
        """(T,) headings, radians."""
        return yaw_of_quaternion(self.rotation)

    @property
    def pose(self) -> Floats:
        """(T, 3) planar x, y, yaw of the rear axle."""
        return np.column_stack([self.position[:, :2], self.yaw])

    @property
    def boxes(self) -> Floats:
        """(T, 5) body boxes x, y, length, width, yaw (real body, not the metric footprint)."""
        yaw = self.yaw
        ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
        size = np.broadcast_to([self.length_m, self.width_m], (len(yaw), 2))
        return np.column_stack([self.position[:, :2] + ahead, size, yaw])


@dataclass(frozen=True, slots=True)
class SweepPoses:
    """Where each sensor really was, for sources whose sensors have clocks of their own.

    Frame k after a keyframe holds the k-th sweep of that sensor. nuScenes' lidar turns at 20 Hz, so its five sweeps
    lie in the first half of the time to the next keyframe, while the frames of `Scene` are spread evenly.

    Attributes:
        lidar: (T, 4, 4) lidar frame to global frame.
        cameras: (C, T, 4, 4) camera axes to global frame, in the order of ``Scene.cameras``.
    """

    lidar: Floats
    cameras: Floats


@dataclass(frozen=True, slots=True)
class Agents:
    """Everything that is annotated, at every frame.

    Attributes:
        ids: N instance identifiers, unique.
        categories: N nuScenes category names.
        position: (N, T, 3) box centres, metres.
        yaw: (N, T) radians.
        size: (N, 3) length, width, height, metres.
        valid: (N, T) whether the agent is there.
    """

    ids: tuple[str, ...]
    categories: tuple[str, ...]
    position: Floats
    yaw: Floats
    size: Floats
    valid: Bools

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def boxes(self) -> Floats:
        """(N, T, 5) boxes x, y, length, width, yaw."""
        size = np.broadcast_to(self.size[:, None, :2], (*self.yaw.shape, 2))
        return np.concatenate([self.position[..., :2], size, self.yaw[..., None]], axis=-1)


@dataclass(frozen=True, slots=True)
class Annotations:
    """The keyframe annotations as their source has them: what a writer must give back unchanged.

    Attributes:
        position: (N, K, 3) true 3-D box centres, metres.
        rotation: (N, K, 4) quaternions.
        size: (N, K, 3) length, width, height.
        valid: (N, K) whether the object is annotated at the keyframe.
        attribute: (N, K) attribute names, joined by ``;``, empty for none.
        visibility: (N, K) nuScenes visibility level 1..4; 0 where the source has none.
        num_lidar_pts: (N, K) counts.
        num_radar_pts: (N, K) counts.
    """

    position: Floats
    rotation: Floats
    size: Floats
    valid: Bools
    attribute: NDArray[np.str_]
    visibility: NDArray[np.int64]
    num_lidar_pts: NDArray[np.int64]
    num_radar_pts: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Scene:
    """One scene.

    Attributes:
        name: nuScenes scene name, for example ``scene-0061``.
        token: Token of the scene in its data set.
        description: Free text; names the look.
        log: Name of the log file (nuScenes ``log.logfile``).
        vehicle: Recording vehicle (nuScenes ``log.vehicle``).
        date: Capture date ``YYYY-MM-DD``.
        timestamps_us: (T,) microseconds, uniformly 12 Hz as far as the source allows.
        keyframes: (K,) indices of the 2 Hz keyframes in ``timestamps_us``.
        ego: Recorded ego motion.
        agents: Every object at every frame.
        annotations: Every object at every keyframe, in the order of ``agents``.
        cameras: Calibrated cameras, possibly none.
        lidar: Lidar mount.
        road_map: Map, possibly cropped to the scene's surroundings.
        adversaries: Instance identifiers of generated adversaries.
        sweep_poses: Poses of the single sensors; ``None`` where all sensors share the ego pose of the frame.
        driving_side: Side that traffic keeps to, as the user stated; ``None``: it has to be found
            (`benchmark.fairness.fault_roads`).
    """

    name: str
    token: str
    description: str
    log: str
    vehicle: str
    date: str
    timestamps_us: NDArray[np.int64]
    keyframes: NDArray[np.int64]
    ego: EgoTrack
    agents: Agents
    annotations: Annotations
    cameras: tuple[Camera, ...]
    lidar: LidarMount
    road_map: RoadMap
    adversaries: tuple[str, ...] = ()
    sweep_poses: SweepPoses | None = None
    driving_side: Handedness | None = None

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {self.seconds[-1]:.1f} s, {len(self.agents.ids)} road users, {self.look.value}>"

    def _repr_html_(self) -> str:
        facts = {
            "description": self.description,
            "log": self.log,
            "location": self.road_map.location,
            "frames": f"{len(self.timestamps_us)}, of them {len(self.keyframes)} key frames",
            "road users": f"{len(self.agents.ids)}",
            "adversaries": ", ".join(self.adversaries) or "none",
            "cameras": ", ".join(camera.name for camera in self.cameras) or "none",
        }
        return html_table(repr(self)[1:-1], ("fact", "value"), [*facts.items()])

    @property
    def look(self) -> Conditions:
        """Light and weather."""
        return Conditions.from_description(self.description)

    @property
    def seconds(self) -> Floats:
        """(T,) seconds since the first frame."""
        return np.asarray((self.timestamps_us - self.timestamps_us[0]) * 1e-6)

    def first_frames(self, count: int) -> Self:
        """The beginning of the scene.

        Args:
            count: Frames that stay, at least one.

        Returns:
            A scene of so many frames, and of the keyframes among them; objects that come later never do.
        """
        keyframes = self.keyframes[self.keyframes < count]
        agents, known, sweeps = self.agents, self.annotations, self.sweep_poses
        return replace(
            self,
            timestamps_us=self.timestamps_us[:count],
            keyframes=keyframes,
            ego=replace(self.ego, position=self.ego.position[:count], rotation=self.ego.rotation[:count]),
            agents=replace(
                agents, position=agents.position[:, :count], yaw=agents.yaw[:, :count], valid=agents.valid[:, :count]
            ),
            annotations=Annotations(
                **{name: getattr(known, name)[:, : len(keyframes)] for name in Annotations.__dataclass_fields__}
            ),
            sweep_poses=None if sweeps is None else SweepPoses(sweeps.lidar[:count], sweeps.cameras[:, :count]),
        )

    def with_adversary(self, agent: int, frames: slice, poses: Floats) -> Self:
        """Replace part of one agent's track; everything else stays as recorded.

        Args:
            agent: Index of the agent.
            frames: Contiguous frames, ``slice(start, stop)``; from ``start`` to ``stop`` the agent exists.
            poses: (stop - start, 3) x, y, yaw of the box centre. Height above ground, size and category stay.

        Returns:
            A scene in which the agent is an adversary. Its annotations inside ``frames`` follow the new track, are
            fully visible, claim at least one lidar point (metrics drop boxes without points) and have the attribute
            of their motion.
        """
        position, yaw, valid = self.agents.position.copy(), self.agents.yaw.copy(), self.agents.valid.copy()
        position[agent, frames, :2], yaw[agent, frames] = poses[:, :2], poses[:, 2]
        position[agent, frames, 2] = position[agent, frames.start, 2]
        valid[agent, frames] = True
        agents = replace(self.agents, position=position, yaw=yaw, valid=valid)
        name = self.agents.ids[agent]
        return replace(
            self,
            agents=agents,
            annotations=self._annotations_of(agents, agent, frames),
            adversaries=(*(known for known in self.adversaries if known != name), name),
        )

    def with_track(self, agent: int, frames: slice, poses: Floats) -> Self:
        """Replace the rest of the track of one who is no adversary, and answers the ego.

        Args:
            agent: Index of the agent.
            frames: Contiguous frames at which it exists; it is gone after the last.
            poses: As of `with_adversary`.

        Returns:
            A scene with the track, with annotations as of `with_adversary`.
        """
        changed = self.with_adversary(agent, frames, poses)
        changed.agents.valid[agent, frames.stop :] = False
        changed.annotations.valid[agent, self.keyframes >= frames.stop] = False
        return replace(changed, adversaries=self.adversaries)

    def with_ego(self, poses: Floats) -> Self:
        """The same with an ego that was driven elsewhere; frames at which it was not stay as recorded, to the bit.

        Args:
            poses: (T, 3) x, y, yaw of the rear axle. Height and tilt are those of the nearest recorded place.

        Returns:
            A scene without poses of single sensors: all of them share the ego's.
        """
        ego = self.ego
        moved = np.flatnonzero((poses != ego.pose).any(axis=1))
        away = np.linalg.norm(poses[moved, None, :2] - ego.position[:, :2], axis=-1)
        nearest = away.argmin(axis=1)
        position, rotation = ego.position.copy(), ego.rotation.copy()
        position[moved] = np.column_stack([poses[moved, :2], ego.position[nearest, 2]])
        turned = 0.5 * (poses[moved, 2] - ego.yaw[nearest])
        cos, sin = np.cos(turned), np.sin(turned)
        w, x, y, z = ego.rotation[nearest].T
        rotation[moved] = np.column_stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w])
        return replace(self, ego=replace(ego, position=position, rotation=rotation), sweep_poses=None)

    def _annotations_of(self, agents: Agents, agent: int, frames: slice) -> Annotations:
        old = self.annotations
        fields = {name: getattr(old, name).copy() for name in Annotations.__dataclass_fields__}
        fields["attribute"] = fields["attribute"].astype(object)
        inside = (self.keyframes >= frames.start) & (self.keyframes < frames.stop)
        at = self.keyframes[inside]
        fields["position"][agent, inside] = agents.position[agent, at]
        fields["rotation"][agent, inside] = quaternion_from_yaw(agents.yaw[agent, at])
        fields["size"][agent, inside] = agents.size[agent]
        fields["valid"][agent, inside] = True
        fields["visibility"][agent, inside] = 4
        fields["num_lidar_pts"][agent, inside] = np.maximum(fields["num_lidar_pts"][agent, inside], 1)
        fields["attribute"][agent, inside] = [self._attribute(agents, agent, int(frame)) for frame in at]
        fields["attribute"] = fields["attribute"].astype(np.str_)
        return Annotations(**fields)

    def _attribute(self, agents: Agents, agent: int, frame: int) -> str:
        """Moving above 0.3 m/s, else stopped; cycles carry their rider."""
        category = agents.categories[agent]
        if category in ("vehicle.bicycle", "vehicle.motorcycle"):
            return "cycle.with_rider"
        first, last = max(frame - 1, 0), min(frame + 1, len(self.timestamps_us) - 1)
        span = float(self.seconds[last] - self.seconds[first])
        distance = float(np.linalg.norm(agents.position[agent, last, :2] - agents.position[agent, first, :2]))
        return "vehicle.moving" if distance > 0.3 * max(span, 1e-6) else "vehicle.stopped"
