"""What a record says of a rig: views that it lacks, and how far it is from the one that networks were trained on."""

from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.categories import LIDAR_PLACE, CategoryNames
from benchmark.extensions.own_recordings.rigs import NUSCENES_VIEWS, find_angles, turn_between
from benchmark.records.run_schema import PlannerFacts, is_baseline
from benchmark.scene import Camera

_WIDTH, _HEIGHT = 1600, 900
_TRAINED: Final = {
    "CAM_FRONT": (1266.0, 1.51),
    "CAM_FRONT_RIGHT": (1261.0, 1.50),
    "CAM_FRONT_LEFT": (1273.0, 1.51),
    "CAM_BACK": (809.0, 1.57),
    "CAM_BACK_LEFT": (1257.0, 1.56),
    "CAM_BACK_RIGHT": (1260.0, 1.55),
}
"""Focal lengths at 1600 x 900 pixels, and heights above the ground in metres, of nuScenes' cars; they look level."""
_FOCAL_SHARE: Final = 0.05
_HEIGHT_M: Final = 0.1
_PITCH_DEG: Final = 1.0
_YAW_DEG: Final = 5.0
"""Smaller differences are those between nuScenes' own cars, and are not told."""


def list_caveats(planner: PlannerFacts, names: CategoryNames, cameras: Sequence[Camera]) -> Iterator[str]:
    """Sentences on the rig of a scene for a planner; none for one that looks at nothing."""
    if is_baseline(planner):
        return
    views = {camera.name: camera for camera in cameras}
    if missing := [view for view in CAMERA_NAMES if view not in views]:
        yield f"the rig has no camera for {', '.join(missing)}: these views are absent from what the planner sees"
    if "images" not in planner.wants:
        return
    if place := dict(names).get(LIDAR_PLACE):
        yield f"plans are given from a stated place of the lidar, {place.replace(' ', ', ')} m in the ego frame"
    told = [text for view in CAMERA_NAMES if view in views and (text := _compare(views[view]))]
    if told:
        yield f"the cameras are not those that networks were trained on (nuScenes' at 1600 x 900): {'; '.join(told)}"


def _compare(camera: Camera) -> str:
    """How a view differs from nuScenes', in words; empty where it hardly does."""
    focal, height = _TRAINED[camera.name]
    # Networks resize whole pictures to one size, so that both focal lengths change with the picture's shape.
    across = float(camera.intrinsic[0, 0]) * _WIDTH / camera.width
    down = float(camera.intrinsic[1, 1]) * _HEIGHT / camera.height
    yaw, pitch = find_angles(camera.rotation)
    turned = turn_between(yaw, NUSCENES_VIEWS[camera.name].yaw_deg)
    parts = []
    if max(abs(across / focal - 1.0), abs(down / focal - 1.0)) > _FOCAL_SHARE:
        shape = f"{across:.0f}" if abs(across / down - 1.0) <= _FOCAL_SHARE else f"{across:.0f} x {down:.0f}"
        parts.append(f"focal length {shape} px, not {focal:.0f}")
    if abs(float(camera.translation[2]) - height) > _HEIGHT_M:
        parts.append(f"{float(camera.translation[2]):.2f} m high, not {height:.2f}")
    if abs(pitch) > _PITCH_DEG:
        parts.append(f"pitch {pitch:+.1f} degrees")
    if abs(turned) > _YAW_DEG:
        parts.append(f"turned by {turned:+.0f} degrees")
    return f"{camera.name} {', '.join(parts)}" if parts else ""
