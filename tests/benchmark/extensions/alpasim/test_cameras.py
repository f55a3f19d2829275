"""Cameras of other kinds as pinholes: a point is where the pinhole says, whatever drew the picture."""

from typing import Any

import numpy as np
import pytest

from benchmark.extensions.alpasim.cameras import RemoteCamera, encode_camera
from benchmark.extensions.alpasim.messages import build_message
from tests.benchmark.closed_loop.seeing import small_cameras

SIZE = (480, 320)
FTHETA = {
    "principal_point_x": 481.0,
    "principal_point_y": 322.0,
    "reference_poly": 2,
    "angle_to_pixeldist_poly": [0.0, 460.0, 0.0, -9.0],
    "max_angle": 1.2,
    "linear_cde": {"linear_c": 1.01, "linear_d": 0.002, "linear_e": -0.003},
}
FISHEYE = {
    "principal_point_x": 480.0,
    "principal_point_y": 320.0,
    "focal_length_x": 450.0,
    "focal_length_y": 452.0,
    "radial_coeffs": [0.02, -0.01, 0.001, 0.0],
}
PINHOLE = {**FISHEYE, "radial_coeffs": [-0.2, 0.05, 0, 0, 0, 0], "tangential_coeffs": [0.001, -0.002]}
FIELDS = {"ftheta": "ftheta_param", "fisheye": "opencv_fisheye_param", "pinhole": "opencv_pinhole_param"}


def camera(kind: str, params: dict[str, Any], **changes: Any) -> RemoteCamera:
    spec = {FIELDS[kind]: params, "resolution_w": 2 * SIZE[0], "resolution_h": 2 * SIZE[1], **changes}
    pose = {"quat": {"w": 0.5, "x": -0.5, "y": 0.5, "z": -0.5}, "vec": {"z": 1.5}}
    return RemoteCamera.of(build_message("AvailableCamera", intrinsics=spec, rig_to_camera=pose))


def project(kind: str, point: Any) -> Any:
    """Where a point of the camera frame is in a picture of half the native size, written out from the definitions."""
    x, y, z = point
    if kind == "ftheta":
        theta, away = np.arctan2(np.hypot(x, y), z), np.hypot(x, y)
        reach = 0.5 * (460.0 * theta - 9.0 * theta**3)
        return np.array(
            [240.5 + (1.01 * x + 0.002 * y) * reach / away, 161.0 + (-0.003 * x + y) * reach / away],
        )
    a, b = x / z, y / z
    r = np.hypot(a, b)
    if kind == "fisheye":
        theta = np.arctan(r)
        scale = theta * (1 + 0.02 * theta**2 - 0.01 * theta**4 + 0.001 * theta**6) / r
        return np.array([240.0 + 225.0 * scale * a, 160.0 + 226.0 * scale * b])
    bent = 1 - 0.2 * r**2 + 0.05 * r**4
    u = a * bent + 2 * 0.001 * a * b - 0.002 * (r**2 + 2 * a**2)
    v = b * bent + 0.001 * (r**2 + 2 * b**2) + 2 * -0.002 * a * b
    return np.array([240.0 + 225.0 * u, 160.0 + 226.0 * v])


@pytest.mark.parametrize(("kind", "params"), [("ftheta", FTHETA), ("fisheye", FISHEYE), ("pinhole", PINHOLE)])
def test_a_spot_is_where_the_pinhole_says(kind: str, params: dict[str, Any]) -> None:
    remote = camera(kind, params)
    for point in ([0.0001, 0.0, 1.0], [0.35, 0.2, 1.0], [-0.6, -0.3, 1.0], [0.5, -0.4, 1.0]):
        u, v = project(kind, point)
        rows, columns = np.indices(SIZE[::-1])
        spot = 255.0 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 18.0)
        seen, pixels = remote.seen(np.repeat(spot[..., None], 3, axis=2).astype(np.uint8), "CAM_FRONT")
        light = pixels[..., 0].astype(float)
        found = np.array([(columns * light).sum(), (rows * light).sum()]) / light.sum()
        expected = (seen.intrinsic @ np.array(point))[:2]
        assert np.abs(found - expected).max() < 0.7, (point, found, expected)


def test_the_other_polynomial_is_inverted() -> None:
    back = {**FTHETA, "reference_poly": 1, "angle_to_pixeldist_poly": [], "pixeldist_to_angle_poly": [0.0, 1 / 460.0]}
    assert camera("ftheta", back)._pixels_of(np.array([0.5]))[0] == pytest.approx(230.0, abs=0.5)


def test_a_pinhole_of_nuscenes_passes_unchanged_and_is_scaled_with_the_picture() -> None:
    ours = small_cameras()[0]
    remote = RemoteCamera.of(encode_camera(ours, "front"))
    pixels = np.arange(2 * ours.height * 2 * ours.width * 3, dtype=np.int64).astype(np.uint8)
    picture = pixels.reshape(2 * ours.height, 2 * ours.width, 3)
    seen, same = remote.seen(picture, ours.name)
    assert same is picture
    np.testing.assert_allclose(seen.intrinsic, ours.resized(2 * ours.width, 2 * ours.height).intrinsic)
    np.testing.assert_allclose(seen.rotation, ours.rotation, atol=1e-7)
    np.testing.assert_allclose(seen.translation, ours.translation, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "params", "changes", "says"),
    [
        ("pinhole", {**PINHOLE, "focal_length_x": float("nan")}, {}, "not finite"),
        ("pinhole", {**PINHOLE, "focal_length_x": 0.0}, {}, "focal length"),
        ("pinhole", {**PINHOLE, "radial_coeffs": [0.0] * 64}, {}, "too many"),
        ("pinhole", PINHOLE, {"resolution_w": 0}, "resolution"),
        ("ftheta", {**FTHETA, "angle_to_pixeldist_poly": []}, {}, "polynomial"),
    ],
)
def test_cameras_that_cannot_be_used_say_why(kind: str, params: Any, changes: Any, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        camera(kind, params, **changes)
    with pytest.raises(ValueError, match="no intrinsics"):
        RemoteCamera.of(build_message("AvailableCamera"))
