"""Cameras of AlpaSim's messages: ours as pinholes, and theirs, of any kind, as the pinholes that our planners know.

``rig_to_camera`` is in effect the camera's pose in the rig, nuScenes' ``calibrated_sensor`` as it is. Pictures of
cameras that are no ideal pinhole are drawn anew as one with the same centre and the same scale there.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.alpasim.messages import build_message
from benchmark.extensions.alpasim.poses import decode_pose, encode_pose
from benchmark.geometry import Floats, quaternion_of, rotation_matrix
from benchmark.scene import Camera

_GLOBAL_SHUTTER: Final = 5
_BODY_OF_OPTICAL: Final = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Turns camera axes x forward, y left, z up into x right, y down, z forward."""
_MOST_PIXELS: Final = 16_384
_MOST_COEFFICIENTS: Final = 32
_FROM_PIXELS: Final = 1


def encode_camera(camera: Camera, name: str, *, body: bool = False) -> Any:
    """A message ``AvailableCamera`` of one of our cameras; ``body`` turns its axes to x forward, y left, z up."""
    rotation = quaternion_of(rotation_matrix(camera.rotation) @ _BODY_OF_OPTICAL) if body else camera.rotation
    pinhole = {
        "principal_point_x": camera.intrinsic[0, 2],
        "principal_point_y": camera.intrinsic[1, 2],
        "focal_length_x": camera.intrinsic[0, 0],
        "focal_length_y": camera.intrinsic[1, 1],
        "radial_coeffs": [0.0] * 6,
        "tangential_coeffs": [0.0] * 2,
        "thin_prism_coeffs": [0.0] * 4,
    }
    spec = build_message(
        "CameraSpec",
        opencv_pinhole_param=pinhole,
        logical_id=name,
        resolution_h=camera.height,
        resolution_w=camera.width,
        shutter_type=_GLOBAL_SHUTTER,
    )
    pose = encode_pose(camera.translation, rotation)
    return build_message("AvailableCamera", intrinsics=spec, rig_to_camera=pose, logical_id=name)


@dataclass(frozen=True, slots=True, eq=False)
class RemoteCamera:
    """A camera that a simulator declared: how it projects, at which size, and where it sits in the rig.

    ``kind`` is ``pinhole``, ``fisheye`` or ``ftheta``, and ``spec`` its message.
    """

    kind: str
    spec: Any
    width: int
    height: int
    translation: Floats
    rotation: Floats

    @classmethod
    def of(cls, message: Any, *, body: bool = False) -> "RemoteCamera":
        """A declared camera; `ValueError` in a sentence for one that cannot be used."""
        spec = message.intrinsics
        fields = {"pinhole": "opencv_pinhole_param", "fisheye": "opencv_fisheye_param", "ftheta": "ftheta_param"}
        kind = next((kind for kind, field in fields.items() if spec.HasField(field)), None)
        if kind is None:
            raise ValueError("has no intrinsics")
        if not (0 < spec.resolution_w <= _MOST_PIXELS and 0 < spec.resolution_h <= _MOST_PIXELS):
            raise ValueError(f"has a resolution of {spec.resolution_w} x {spec.resolution_h}")
        params = getattr(spec, fields[kind])
        numbers = [number for _, value in params.ListFields() for number in _numbers(value)]
        if len(numbers) > _MOST_COEFFICIENTS or not np.isfinite(numbers).all():
            raise ValueError("has intrinsics that are not finite, or too many of them")
        position, rotation = (np.array(part) for part in decode_pose(message.rig_to_camera))
        if not np.isfinite([*position, *rotation]).all() or abs(rotation @ rotation - 1.0) > 1e-3:
            raise ValueError("has no pose in the rig: its rotation is not a unit quaternion")
        rotation /= np.linalg.norm(rotation)
        if body:
            rotation = quaternion_of(rotation_matrix(rotation) @ _BODY_OF_OPTICAL.T)
        camera = cls(kind, params, spec.resolution_w, spec.resolution_h, position, rotation)
        if not (camera._focal(1.0, 1.0) > 0.0).all():
            raise ValueError("has a focal length that is not above zero")
        return camera

    def seen(self, pixels: NDArray[np.uint8], name: str) -> tuple[Camera, NDArray[np.uint8]]:
        """The pinhole of one of its pictures, (height, width, 3), and the picture as that pinhole sees it."""
        height, width = pixels.shape[:2]
        across, down = width / self.width, height / self.height
        focal = self._focal(across, down)
        centre = self.spec.principal_point_x * across, self.spec.principal_point_y * down
        intrinsic = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
        if not self._is_ideal:
            import cv2

            maps = _find_source_pixels(self, width, height, intrinsic.tobytes())
            pixels = np.asarray(cv2.remap(pixels, *maps, cv2.INTER_LINEAR), np.uint8)
        return Camera(name, self.translation, self.rotation, intrinsic, width, height), pixels

    @property
    def _is_ideal(self) -> bool:
        spec = self.spec
        if self.kind != "pinhole":
            return False
        return not any([*spec.radial_coeffs, *spec.tangential_coeffs, *spec.thin_prism_coeffs])

    def _focal(self, across: float, down: float) -> Floats:
        """(2,) pixels per unit of slope in the middle of a picture."""
        if self.kind != "ftheta":
            return np.array([self.spec.focal_length_x * across, self.spec.focal_length_y * down])
        return np.full(2, down * float(self._pixels_of(np.array([1e-4]))[0]) / 1e-4)

    def _pixels_of(self, angle: Floats) -> Floats:
        """Distances from the principal point, in pixels of the native size, of angles from the axis."""
        forward, back = list(self.spec.angle_to_pixeldist_poly), list(self.spec.pixeldist_to_angle_poly)
        if forward and not (self.spec.reference_poly == _FROM_PIXELS and back):
            return np.asarray(np.polyval(forward[::-1], angle))
        if not back:
            raise ValueError("has no polynomial")
        distance = np.linspace(0.0, float(np.hypot(self.width, self.height)), 4096)
        return np.interp(angle, np.maximum.accumulate(np.polyval(back[::-1], distance)), distance)

    def source_pixels(self, width: int, height: int, intrinsic: Floats) -> tuple[Any, Any]:
        """(height, width) columns and rows in its picture of the pixels of a pinhole."""
        import cv2

        spec, size = self.spec, (width, height)
        if self.kind == "pinhole":
            radial = [*spec.radial_coeffs, *[0.0] * 6][:6]
            tangential, prism = [*spec.tangential_coeffs, 0.0, 0.0][:2], [*spec.thin_prism_coeffs, *[0.0] * 4][:4]
            terms = np.array([*radial[:2], *tangential, *radial[2:], *prism])
            return cv2.initUndistortRectifyMap(intrinsic, terms, np.eye(3), intrinsic, size, cv2.CV_32FC1)
        if self.kind == "fisheye":
            terms = np.array([*spec.radial_coeffs, *[0.0] * 4][:4])
            return cv2.fisheye.initUndistortRectifyMap(intrinsic, terms, np.eye(3), intrinsic, size, cv2.CV_32FC1)
        rows, columns = np.indices((height, width), np.float64)
        x, y = (columns - intrinsic[0, 2]) / intrinsic[0, 0], (rows - intrinsic[1, 2]) / intrinsic[1, 1]
        away = np.maximum(np.hypot(x, y), 1e-12)
        across, down = width / self.width, height / self.height
        reach = self._pixels_of(np.arctan(away)) * down / away
        c, d, e = 1.0, 0.0, 0.0
        if spec.HasField("linear_cde"):
            c, d, e = spec.linear_cde.linear_c, spec.linear_cde.linear_d, spec.linear_cde.linear_e
        u = intrinsic[0, 2] + (c * x + d * y) * reach * across / down
        v = intrinsic[1, 2] + (e * x + y) * reach
        return u.astype(np.float32), v.astype(np.float32)


@lru_cache(maxsize=32)
def _find_source_pixels(camera: RemoteCamera, width: int, height: int, intrinsic: bytes) -> tuple[Any, Any]:
    """`RemoteCamera.source_pixels`, computed once for each camera and size of picture."""
    return camera.source_pixels(width, height, np.frombuffer(intrinsic).reshape(3, 3))


def _numbers(value: Any) -> list[float]:
    if isinstance(value, int | float):
        return [float(value)]
    if hasattr(value, "ListFields"):
        return [float(number) for _, number in value.ListFields()]
    return [float(number) for number in value]
