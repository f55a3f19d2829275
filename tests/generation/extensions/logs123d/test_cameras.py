"""Cameras of 123D logs: lenses that are no pinholes, sizes that differ, videos, and which image is of which frame."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from benchmark.constants import CATEGORIES
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.geometry import Floats, quaternion_from_yaw
from generation.extensions.logs123d.cameras import name_missing_views, read_lens, rectify
from generation.extensions.logs123d.importing import import_123d
from generation.extensions.logs123d.key_frames import choose_key_frames, pair_images
from generation.extensions.logs123d.labels import UNKNOWN_TO_NUSCENES, find_category, list_labels
from generation.extensions.logs123d.log_files import Table
from generation.extensions.logs123d.poses import IDENTITY, compose, interpolate, invert
from tests.generation.extensions.logs123d.made_logs import MadeLog, picture

SIZE = 400, 300


def camera_file(**metadata: Any) -> Table:
    given = {
        "camera_model": "pinhole", "camera_name": "front", "width": SIZE[0], "height": SIZE[1],
        "camera_to_imu_se3": [1.0, 0.0, 1.0, 0.5, -0.5, 0.5, -0.5], "is_undistorted": False,
        "intrinsics": [200.0, 200.0, 200.0, 150.0, 0.0], "distortion": None,
    }  # fmt: skip
    return Table(Path("camera.pcam_f0.arrow"), 0, (), given | metadata, {}, {})


def dot_at(pixel: Floats) -> bytes:
    """An image that is black but for a white dot."""
    image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    cv2.circle(image, (round(float(pixel[0])), round(float(pixel[1]))), 4, (255, 255, 255), -1)
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


def find_dot(data: bytes) -> Floats:
    image = np.asarray(Image.open(io.BytesIO(data)).convert("L"), np.float64)
    down, across = np.nonzero(image > 128)
    return np.array([across.mean(), down.mean()])


RAY = np.array([0.35, -0.2, 1.0])


def ftheta_pixel() -> Floats:
    theta = np.arctan2(np.hypot(*RAY[:2]), RAY[2])
    radius = 180.0 * theta - 10.0 * theta**3
    return np.asarray(np.array([200.0, 150.0]) + radius * RAY[:2] / np.hypot(*RAY[:2]))


def mei_pixel() -> Floats:
    sphere = RAY / np.linalg.norm(RAY)
    return np.asarray(500.0 * sphere[:2] / (sphere[2] + 2.0) + np.array([200.0, 150.0]))


def distorted_pixel() -> Floats:
    points, _ = cv2.projectPoints(
        RAY[None], np.zeros(3), np.zeros(3), np.array([[200.0, 0, 200], [0, 200.0, 150], [0, 0, 1]]),
        np.array([-0.2, 0.05, 0.0, 0.0, 0.0]),
    )  # fmt: skip
    return np.asarray(points.ravel())


@pytest.mark.parametrize(
    ("metadata", "pixel"),
    [
        ({"distortion": [-0.2, 0.05, 0.0, 0.0, 0.0]}, distorted_pixel()),
        (
            {"camera_model": "ftheta", "intrinsics": [200.0, 150.0, 0, 180.0, 0, -10.0, 0, 0, *[0.0] * 6]},
            ftheta_pixel(),
        ),
        (
            {"camera_model": "fisheye_mei", "mirror_parameter": 2.0, "projection": [500.0, 500.0, 200.0, 150.0],
             "distortion": [0.0] * 4},
            mei_pixel(),
        ),
    ],
)  # fmt: skip
def test_an_image_of_another_lens_is_drawn_anew_as_its_pinhole_camera_sees_it(metadata: Any, pixel: Floats) -> None:
    lens = read_lens(camera_file(**metadata))
    assert lens is not None and lens.project is not None
    expected = lens.matrix @ (RAY / RAY[2])
    assert np.linalg.norm(pixel - expected[:2]) > 1.5
    found = find_dot(rectify(dot_at(pixel), lens, "image"))
    assert np.linalg.norm(found - expected[:2]) < 1.0


def test_an_image_of_a_pinhole_camera_keeps_its_bytes() -> None:
    # Pixels that are undistorted already, whatever the distortion says: Argoverse 2 and PandaSet.
    lens = read_lens(camera_file(distortion=[-0.2, 0.1, 0.0, 0.0, 0.0], is_undistorted=True))
    assert lens is not None and rectify(b"bytes", lens, "image") == b"bytes"


def test_a_matrix_goes_with_the_size_that_images_have() -> None:
    lens = read_lens(camera_file())
    assert lens is not None
    camera = lens.to_camera((200, 150), IDENTITY)
    assert (camera.width, camera.height) == (200, 150)
    assert camera.intrinsic.tolist() == [[100, 0, 100], [0, 100, 75], [0, 0, 1]]
    assert lens.view_deg() == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_camera_without_intrinsics_is_left_out_and_one_with_wrong_ones_refused() -> None:
    assert read_lens(camera_file(intrinsics=None)) is None
    for wrong in ([1.0] * 4, [float("nan")] * 5, "none", [0.0] * 5):
        with pytest.raises(InputError):
            read_lens(camera_file(intrinsics=wrong))


def test_sides_without_a_camera_are_named() -> None:
    ring = {str(yaw): (float(yaw), 0.0) for yaw in (0, 45, -45, 99, -99, 153, -153)}
    assert name_missing_views(ring) == ["back"]
    assert name_missing_views({**ring, "b": (-178.0, 0.0)}) == []
    assert name_missing_views({"front": (3.0, 0.0)}) == ["to the left", "back", "to the right"]


def test_a_video_beside_the_log_gives_its_frames(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    made = replace(MadeLog(), frames=31, storage="int32", cameras={"pcam_f0": ("front", 0.0)})
    folder = made.write(tmp_path)
    with av.open(str(folder / "camera.pcam_f0.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.bit_rate = 64, 48, 4_000_000
        for row in range(31):
            shade = np.full((48, 64, 3), 7 * row, np.uint8)
            for packet in stream.encode(av.VideoFrame.from_ndarray(shade, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    import_123d(tmp_path / "logs", tmp_path / "root")
    samples = sorted((tmp_path / "root" / "samples" / "front").iterdir())
    shades = [float(np.asarray(Image.open(path)).mean()) for path in samples]
    assert shades == pytest.approx([7 * row for row in range(0, 31, 5)], abs=4)
    (folder / "camera.pcam_f0.mp4").write_bytes(b"none")
    with pytest.raises(InputError, match=r"camera\.pcam_f0\.mp4"):
        import_123d(tmp_path / "logs", tmp_path / "root")


def test_rows_of_an_asynchronous_log_that_no_frame_names_are_left(tmp_path: Path) -> None:
    """Cameras and ego at a higher rate than the frames."""
    made = MadeLog(frames=21, cameras={"pcam_f0": ("front", 0.0)})
    folder = made.write(tmp_path)
    import pyarrow as pa

    table = pa.ipc.open_file(str(folder / "sync.arrow")).read_all().take(list(range(0, 21, 2)))
    with pa.ipc.new_file(str(folder / "sync.arrow"), table.schema) as writer:
        writer.write_table(table)
    import_123d(tmp_path / "logs", tmp_path / "root")
    files = [*(tmp_path / "root" / "sweeps" / "front").iterdir(), *(tmp_path / "root" / "samples" / "front").iterdir()]
    assert len(files) == 11
    assert {path.read_bytes() for path in files} == {picture(row) for row in range(0, 21, 2)}
    # Half a second is between two frames of 5 Hz, and the earlier one is taken.
    assert open_data(tmp_path / "root").scene("drive-1").keyframes.shape == (5,)


def test_key_frames_come_at_two_hertz_and_a_gap_stays_one() -> None:
    ten_hz = 100_000 * np.arange(31)
    assert choose_key_frames(ten_hz).tolist() == [0, 5, 10, 15, 20, 25, 30]
    assert choose_key_frames(500_000 * np.arange(4)).tolist() == [0, 1, 2, 3]
    assert choose_key_frames(np.delete(ten_hz, range(8, 18))).tolist() == [0, 5, 10, 15, 20]
    # Frames of 6 Hz: every third.
    assert choose_key_frames(np.round(np.arange(13) * 1e6 / 6).astype(np.int64)).tolist() == [0, 3, 6, 9, 12]


def test_an_image_is_of_one_frame_and_a_camera_never_goes_back_in_time() -> None:
    times = 100_000 * np.arange(11)
    at = times + 20_000
    rows = np.arange(11)
    rows[5], rows[6:8] = -1, [3, 6]
    kept, paired, missing = pair_images(times, np.array([0, 5, 10]), {"a": (at, rows)})
    assert kept.tolist() == [0, 5, 10] and missing == {"a": 0}
    images = paired["a"]
    assert len(set(images.rows.tolist())) == len(images.rows) and (np.diff(at[images.rows]) > 0).all()
    assert images.rows[images.frames == 5].tolist() == [5]


def test_every_label_has_a_category_of_nuscenes_or_is_of_a_kind_without() -> None:
    for label_class, codes in list_labels().items():
        for name, kind in codes:
            category = find_category(label_class, name, kind, 4.0)
            assert category in CATEGORIES if kind not in UNKNOWN_TO_NUSCENES else category is None, (label_class, name)
    assert find_category("NuPlanBoxDetectionLabel", "VEHICLE", "VEHICLE", 12.0) == "vehicle.bus.rigid"
    assert find_category("AV2SensorBoxDetectionLabel", "BICYCLIST", "PERSON", 0.8) == "human.pedestrian.adult"
    assert find_category("WODMotionBoxDetectionLabel", "TYPE_CYCLIST", "TWO_WHEELER", 1.8) == "vehicle.bicycle"


def test_poses_compose_invert_and_turn_the_shorter_way() -> None:
    rng = np.random.default_rng(0)
    first, second = (np.concatenate([rng.normal(size=3), rng.normal(size=4)]) for _ in range(2))
    back = compose(invert(first), compose(first, second))
    assert np.allclose(np.abs(back[3:]), np.abs(second[3:] / np.linalg.norm(second[3:])))
    assert np.allclose(back[:3], second[:3])
    ends = np.array(
        [[0.0, 0, 0, *quaternion_from_yaw(np.array(0.0))], [2.0, 0, 0, *-quaternion_from_yaw(np.array(1.0))]]
    )
    between = interpolate(ends, np.array([0, 10]), np.array([-5, 0, 5, 10, 20]))
    assert between[:, 0].tolist() == [0, 0, 1, 2, 2]
    assert np.allclose(np.abs(between[2, 3:]), quaternion_from_yaw(np.array(0.5)))
