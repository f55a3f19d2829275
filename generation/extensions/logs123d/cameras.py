"""Cameras of a log as pinhole cameras, and their images as they go into a root.

nuScenes tables know no distortion. An image that follows the plain pinhole model goes in as the bytes that it has; all
others are drawn anew as a pinhole camera sees them whose scale in the middle is theirs, so the rim of a wide lens is
lost.
"""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Floats, rotation_matrix
from benchmark.scene import Camera
from benchmark.untrusted.files import PICTURE, to_one_line
from benchmark.untrusted.http_images import decode_picture
from generation.extensions.logs123d.log_files import Table, to_pose
from generation.extensions.logs123d.poses import compose, invert
from generation.nuscenes_writer.scenes import encode_jpeg

_QUALITY: Final = 95
_LONGEST_SIDE: Final = 16_384
_ENDS: Final = {"jpg": b"\xff\xd9", "png": b"IEND"}

Rays = NDArray[np.float64]
"""(..., 3) directions, z along the optical axis, x right, y down."""


@dataclass(frozen=True, slots=True)
class Lens:
    """What the metadata of a camera say.

    Attributes:
        name: The source's own.
        camera_to_imu: (7,) pose.
        size: Width and height that the numbers hold for, pixels.
        matrix: (3, 3) pinhole camera that stands for it.
        project: From rays to (..., 2) pixels; ``None`` where the pixels follow ``matrix``.
    """

    name: str
    camera_to_imu: Floats
    size: tuple[int, int]
    matrix: Floats
    project: Callable[[Rays], Floats] | None

    def view_deg(self) -> tuple[float, float]:
        """Yaw, left positive, and pitch, up positive, of the optical axis in the body frame, degrees."""
        axis = rotation_matrix(self.camera_to_imu[3:])[:, 2]
        return float(np.degrees(np.arctan2(axis[1], axis[0]))), float(np.degrees(np.arcsin(np.clip(axis[2], -1, 1))))

    def to_camera(self, image_size: tuple[int, int], body_to_imu: Floats) -> Camera:
        """The camera of images of some size, on a body with a (7,) pose in the IMU frame."""
        mount = compose(invert(body_to_imu), self.camera_to_imu)
        camera = Camera(self.name, mount[:3], mount[3:], self.matrix, *self.size)
        return camera.resized(*image_size)


def read_lens(table: Table) -> Lens | None:
    """The camera of a file; ``None`` where it says no intrinsics."""
    given = table.metadata
    name = given.get("camera_name") or table.path.stem.partition(".")[2]
    if not isinstance(name, str) or not name.isprintable() or not name.replace("_", "").replace("-", "").isalnum():
        raise table.damaged(f"its camera_name is {to_one_line(repr(name), 60)}, which is no name")
    size = _whole(table, "width"), _whole(table, "height")
    pose = to_pose(given.get("camera_to_imu_se3"), f"{table.path}: its camera_to_imu_se3")
    model = str(given.get("camera_model", "pinhole"))
    if model not in _MODELS:
        raise table.damaged(f"its camera_model is {to_one_line(model, 40)}, which is none of {', '.join(_MODELS)}")
    intrinsics = given.get("intrinsics" if model != "fisheye_mei" else "projection")
    if intrinsics is None:
        return None
    matrix, project = _MODELS[model](table, intrinsics)
    if not np.isfinite(matrix).all() or not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise table.damaged("its focal lengths are not positive")
    return Lens(name, pose, size, matrix, project)


def _whole(table: Table, name: str) -> int:
    value = table.metadata.get(name)
    if not isinstance(value, int) or not 1 <= value <= _LONGEST_SIDE:
        raise table.damaged(f"its {name} is {to_one_line(repr(value), 40)} pixels")
    return value


def _list_numbers(table: Table, value: Any, name: str, count: int) -> Floats:
    right = isinstance(value, list) and len(value) == count and all(type(one) in (int, float) for one in value)
    numbers = np.array(value if right else [np.nan], np.float64)
    if not np.isfinite(numbers).all():
        raise table.damaged(f"its {name} are {to_one_line(repr(value), 60)}, not {count} numbers")
    return numbers


def _matrix(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> Floats:
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _read_pinhole(table: Table, intrinsics: Any) -> tuple[Floats, Callable[[Rays], Floats] | None]:
    matrix = _matrix(*_list_numbers(table, intrinsics, "intrinsics", 5).tolist())
    given = table.metadata.get("distortion")
    if given is None or table.metadata.get("is_undistorted") is True:
        return matrix, None
    distortion = _list_numbers(table, given, "distortion", 5)
    if not distortion.any():
        return matrix, None

    def project(rays: Rays) -> Floats:
        points, _ = cv2.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, distortion)
        return np.asarray(points, np.float64).reshape(*rays.shape[:-1], 2)

    return matrix, project


def _read_ftheta(table: Table, intrinsics: Any) -> tuple[Floats, Callable[[Rays], Floats]]:
    """Radius in pixels = sum of c_i theta^i, theta from the axis in radians."""
    numbers = _list_numbers(table, intrinsics, "intrinsics", 14)
    centre, forward = numbers[:2], numbers[2:8]

    def project(rays: Rays) -> Floats:
        across = np.linalg.norm(rays[..., :2], axis=-1)
        radius = np.polyval(forward[::-1], np.arctan2(across, rays[..., 2]))
        scale = np.divide(radius, across, out=np.zeros_like(radius), where=across > 1e-12)
        return np.asarray(centre + scale[..., None] * rays[..., :2])

    return _matrix(forward[1], forward[1], *centre.tolist()), project


def _read_mei(table: Table, projection: Any) -> tuple[Floats, Callable[[Rays], Floats]]:
    """The unified model: a ray meets the unit sphere, which is seen from ``mirror_parameter`` behind its centre."""
    gamma_1, gamma_2, u0, v0 = _list_numbers(table, projection, "projection", 4).tolist()
    k1, k2, p1, p2 = _list_numbers(table, table.metadata.get("distortion") or [0.0] * 4, "distortion", 4).tolist()
    (mirror,) = _list_numbers(table, [table.metadata.get("mirror_parameter")], "mirror_parameter", 1).tolist()

    def project(rays: Rays) -> Floats:
        sphere = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        x, y = (sphere[..., axis] / (sphere[..., 2] + mirror) for axis in (0, 1))
        square = x * x + y * y
        radial = 1 + k1 * square + k2 * square * square
        u = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        v = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        return np.stack([gamma_1 * u + u0, gamma_2 * v + v0], axis=-1)

    return _matrix(gamma_1 / (1 + mirror), gamma_2 / (1 + mirror), u0, v0), project


_MODELS: Final[Mapping[str, Callable[[Table, Any], tuple[Floats, Any]]]] = {
    "pinhole": _read_pinhole,
    "ftheta": _read_ftheta,
    "fisheye_mei": _read_mei,
}


def inspect_image(data: bytes, where: str) -> tuple[str, tuple[int, int]]:
    """Extension, ``jpg`` or ``png``, and width and height of an image; one that is cut short is refused."""
    from PIL import Image

    kind = "jpg" if data[:2] == b"\xff\xd8" else "png" if data[:4] == b"\x89PNG" else ""
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as image:
            size = image.size
    except Exception as error:
        raise InputError(f"{where} is neither JPEG nor PNG, or is damaged; convert the log again") from error
    if size[0] * size[1] > PICTURE.values or _ENDS.get(kind, b"none") not in data[-1024:]:
        raise InputError(f"{where} is cut short, or has {size[0]} x {size[1]} pixels; convert the log again")
    return kind, size


def rectify(data: bytes, lens: Lens, where: str) -> bytes:
    """JPEG bytes of the image as the lens' pinhole camera sees it; the bytes themselves where they follow it."""
    if lens.project is None:
        return data
    try:
        image = decode_picture(io.BytesIO(data), PICTURE)
    except ValueError as error:
        raise InputError(f"{where} cannot be read ({error}); convert the log again") from error
    height, width = image.shape[:2]
    scale = np.array([width, height]) / lens.size
    across, down = np.meshgrid(np.arange(width) / scale[0], np.arange(height) / scale[1])
    rays = np.stack([across, down, np.ones_like(across)], axis=-1) @ np.linalg.inv(lens.matrix).T
    at_x, at_y = np.moveaxis((lens.project(rays) * scale).astype(np.float32), -1, 0)
    seen = cv2.remap(image, np.ascontiguousarray(at_x), np.ascontiguousarray(at_y), cv2.INTER_LINEAR)
    return encode_jpeg(np.asarray(seen, np.uint8), _QUALITY)


_SIDES: Final = (
    ("ahead", 0.0, 25.0),
    ("to the left", 90.0, 45.0),
    ("back", 180.0, 25.0),
    ("to the right", -90.0, 45.0),
)
"""Names of sides, their yaw, and how far from it a camera may look, degrees."""


def name_missing_views(views: Mapping[str, tuple[float, float]]) -> list[str]:
    """Sides that no camera looks to, from yaw and pitch by name: Argoverse 2 has none that looks straight back."""
    yaws = [yaw for yaw, _ in views.values()]
    return [side for side, at, off in _SIDES if all(abs((yaw - at + 180) % 360 - 180) > off for yaw in yaws)]


def find_file(folder: Path, name: str, where: str) -> Path:
    """An image that a log names by its path below a folder; one that leads out of it is refused."""
    parts = Path(name).parts
    if not name or Path(name).is_absolute() or ".." in parts or not name.isprintable():
        raise InputError(f"{where} names the image {to_one_line(name, 80)!r}, which does not lie below --sensors")
    return folder / name
