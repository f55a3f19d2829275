"""Import of 123D logs: what lands in the root, what a log lacks, and the pitfalls of the format."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import open_data
from benchmark.datasets.schema.check import check_tables
from benchmark.errors import InputError
from benchmark.geometry import transform_matrix
from benchmark.road_map import DividerKind, Handedness
from generation.extensions.logs123d.importing import ImportedLog, LogImport, import_123d, summarise_lacks
from tests.benchmark.cli.cli_runs import run_main
from tests.generation.extensions.logs123d.made_logs import (
    CAMERA_DELAY_US,
    SPEED,
    STEP_US,
    MadeLog,
    picture,
    renamed,
)

VERSION = "v1.0-trainval"


def rows(root: Path, table: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((root / VERSION / f"{table}.json").read_text())
    return found


def imported(made: MadeLog, folder: Path, settings: LogImport | None = None) -> tuple[ImportedLog, Path]:
    made.write(folder)
    (log,) = import_123d(folder / "logs", folder / "root", settings)
    return log, folder / "root"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[ImportedLog, Path]:
    """A log without a calendar, with everything but a camera that looks back."""
    return imported(MadeLog(), tmp_path_factory.mktemp("plain"))


@pytest.mark.path
def test_a_root_is_sound_and_is_opened_under_the_name_of_the_log(plain: tuple[ImportedLog, Path]) -> None:
    log, root = plain
    assert not check_tables(root)
    data = open_data(root)
    assert data.scene_names("train") == ("drive-1",) and log.split == "train"
    scene = data.scene("drive-1")
    assert scene.agents.categories == ("vehicle.car", "vehicle.truck")
    assert len(scene.keyframes) == 5 and [camera.name for camera in scene.cameras] == ["front", "left"]
    # Sweeps are between key frames, where the log has frames.
    kinds = Counter((row["is_key_frame"], row["filename"].split("/")[1]) for row in rows(root, "sample_data"))
    assert kinds[True, "front"] == 5 and kinds[False, "front"] == 16 and kinds[False, "LIDAR_TOP"] == 16


def test_times_without_a_calendar_move_to_years_and_keep_their_differences(plain: tuple[ImportedLog, Path]) -> None:
    log, root = plain
    times = sorted(row["timestamp"] for row in rows(root, "sample"))
    assert np.diff(times).tolist() == [5 * STEP_US] * 4
    assert 946_684_800_000_000 < times[0] < 4_102_444_800_000_000
    assert times[0] == log.facts["later_us"] and log.facts["later_us"] % 1_000_000 == 0
    assert rows(root, "log")[0]["date_captured"] == "1970-01-01"


def test_times_of_a_calendar_stay(tmp_path: Path) -> None:
    log, root = imported(MadeLog(first_us=1_700_000_000_000_000, frames=6), tmp_path)
    assert log.facts["later_us"] == 0 and min(row["timestamp"] for row in rows(root, "sample")) == 1_700_000_000_000_000
    assert rows(root, "log")[0]["date_captured"] == "2023-11-14"


def test_the_world_moves_to_where_all_of_it_is_positive_by_whole_metres(plain: tuple[ImportedLog, Path]) -> None:
    log, root = plain
    moved = np.array(log.facts["moved_m"])
    assert (moved == np.round(moved)).all() and moved[0] > 0 and moved[2] == 0
    road_map = open_data(root).scene("drive-1").road_map
    assert min(road_map.drivable_area.bounds) >= 0
    boxes = sorted(row["translation"] for row in rows(root, "sample_annotation"))
    assert np.allclose(boxes[0], np.array([-270.0, -1.75, 10.5]) + moved)
    # The ego is the rear axle on the ground, half a body lower than its centre, which is 0.45 m above the axle.
    ego = [row["translation"] for row in rows(root, "ego_pose")]
    assert np.allclose({round(one[2], 9) for one in ego}.pop(), 10.0 - (0.75 - 0.45))


@pytest.mark.parametrize("null_poses", [False, True])
def test_images_are_seen_from_where_the_ego_was_at_their_own_time(tmp_path: Path, null_poses: bool) -> None:
    made = MadeLog(null_poses=null_poses, frames=11)
    log, root = imported(made, tmp_path)
    poses = {row["token"]: row for row in rows(root, "ego_pose")}
    mounts = {row["token"]: row for row in rows(root, "calibrated_sensor")}
    fronts = [row for row in rows(root, "sample_data") if "/front/" in row["filename"]]
    assert len(fronts) == 11
    for row in fronts:
        ego, mount = poses[row["ego_pose_token"]], mounts[row["calibrated_sensor_token"]]
        seconds = (row["timestamp"] - log.facts["later_us"]) * 1e-6
        assert round(seconds * 1e6) % STEP_US == CAMERA_DELAY_US
        camera = transform_matrix(ego["rotation"], ego["translation"]) @ transform_matrix(
            mount["rotation"], mount["translation"]
        )
        # Where a row of the ego lies after the image; the last image is later than all of them.
        known = min(seconds, 1.0) if null_poses else seconds
        expected = np.array([-300.0 + SPEED * known + 1.5, -1.75, 11.2]) + log.facts["moved_m"]
        assert np.allclose(camera[:3, 3], expected, atol=1e-9)
        assert np.allclose(camera[:3, 2], [1, 0, 0], atol=1e-12)


def test_surfaces_keep_their_holes_which_outlines_do_not_have(plain: tuple[ImportedLog, Path]) -> None:
    road_map = open_data(plain[1]).scene("drive-1").road_map
    assert sum(len(part.interiors) for part in road_map.drivable_area.geoms) == 1


def test_a_neighbour_may_drive_the_other_way_and_the_line_between_parts_directions(
    plain: tuple[ImportedLog, Path],
) -> None:
    log, root = plain
    road_map = open_data(root).scene("drive-1").road_map
    ahead = sorted(float(lane.centerline[-1, 0] - lane.centerline[0, 0]) for lane in road_map.lanes.values())
    # Two lanes, not the bicycle's; one leads west.
    assert len(ahead) == 2 and ahead[0] < 0 < ahead[1]
    assert "1 bicycle lanes" in log.facts["left_out"]
    lines = {round(float(one.line[0, 1] - log.facts["moved_m"][1]), 3): one for one in road_map.dividers}
    assert lines[0.0].between_directions and not lines[-3.5].between_directions
    # What is no successor within the map is none.
    assert not any(lane.successors for lane in road_map.lanes.values())
    assert lines[-3.5].kind is DividerKind.SOLID_WHITE


def test_what_a_log_lacks_is_named(plain: tuple[ImportedLog, Path]) -> None:
    log, _ = plain
    lacks = "\n".join(log.facts["lacks"])
    assert "camera that looks back" in lacks and "camera that looks to the right" in lacks and "lidar" in lacks
    assert "looks ahead" not in lacks and "looks to the left" not in lacks and "map" not in log.facts["lacks"]
    assert "left out: 21 boxes TRAFFIC_SIGN (1 of 1)" in summarise_lacks([log])


def test_a_log_without_map_boxes_or_cameras_is_a_root_without_them(tmp_path: Path) -> None:
    MadeLog(own_map=False, boxes=False, cameras={}, frames=11).write(tmp_path)
    (log,) = import_123d(tmp_path / "logs", tmp_path / "root")
    assert {"cameras", "boxes", "map"} <= {*log.facts["lacks"]}
    data, annotations = open_data(tmp_path / "root"), rows(tmp_path / "root", "sample_annotation")
    assert not data.has_map("drive-1") and not data.scene("drive-1").cameras and not annotations
    assert not [fault for fault in check_tables(tmp_path / "root") if fault.severity == "error"]


def test_a_missing_image_is_the_nearest_within_a_tenth_of_a_second_or_costs_the_key_frame(tmp_path: Path) -> None:
    made = MadeLog(frames=16, lacking={"pcam_f0": (5,), "pcam_l0": (9, 10, 11)})
    log, root = imported(made, tmp_path)
    times = sorted(row["timestamp"] - log.facts["later_us"] for row in rows(root, "sample"))
    assert times == [0, 5 * STEP_US, 15 * STEP_US]
    assert log.facts["key_frames_without_image"] == {"left": 1}
    taken = [
        row["timestamp"] - log.facts["later_us"] for row in rows(root, "sample_data") if "/front/" in row["filename"]
    ]
    # The image of frame 4, 0.07 s before the key frame, is taken once.
    assert 4 * STEP_US + CAMERA_DELAY_US in taken and len(set(taken)) == len(taken) == 15


def test_images_are_the_bytes_of_the_log(plain: tuple[ImportedLog, Path]) -> None:
    files = sorted((plain[1] / "samples" / "front").iterdir())
    assert [file.read_bytes() for file in files] == [picture(row) for row in (0, 5, 10, 15, 20)]


def test_places_say_on_which_side_traffic_keeps_where_that_is_known(tmp_path: Path) -> None:
    for number, (dataset, place, side) in enumerate(
        [("av2-sensor", "PIT", "right"), ("nuplan", "sg-one-north", "left"), ("physical-ai-av", None, None)]
    ):
        made = MadeLog(dataset=dataset, split=f"{dataset}_val", location=place, frames=6, cameras={})
        _, root = imported(made, tmp_path / str(number))
        location = rows(root, "log")[0]["location"]
        assert Handedness.of_location(location) == (None if side is None else Handedness(side)), location


def test_one_worker_and_two_give_the_same_bytes_and_the_same_command_resumes(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        renamed(MadeLog(frames=6), number).write(tmp_path)
    roots = [tmp_path / f"root{workers}" for workers in (1, 2)]
    import_123d(tmp_path / "logs", roots[0], LogImport(limit=1))
    (first, *others) = import_123d(tmp_path / "logs", roots[0])
    assert first.kept and not any(log.kept for log in others)
    import_123d(tmp_path / "logs", roots[1], workers=2)
    contents = [
        {path.relative_to(root): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}
        for root in roots
    ]
    assert contents[0] == contents[1] and len(contents[0]) > 60
    assert all(log.kept for log in import_123d(tmp_path / "logs", roots[0]))


def test_scenes_are_chosen_by_name_and_splits_are_the_logs_own(tmp_path: Path) -> None:
    first = MadeLog(frames=6, cameras={})
    for made in (
        first,
        renamed(first, 2),
        replace(first, split="carla_val"),
        replace(first, split="carla_test", name="t"),
    ):
        made.write(tmp_path)
    with pytest.raises(InputError, match="more than one log drive-1"):
        import_123d(tmp_path / "logs", tmp_path / "root")
    import_123d(tmp_path / "logs", tmp_path / "root", LogImport(scenes=("carla_val/drive-1", "drive-2", "t")))
    splits = json.loads((tmp_path / "root" / VERSION / "splits.json").read_text())
    assert {split: len(names) for split, names in splits.items()} == {"test": 1, "train": 1, "val": 1}
    with pytest.raises(InputError, match="there is no log drive-3"):
        import_123d(tmp_path / "logs", tmp_path / "root", LogImport(scenes=("drive-3",)))


def test_the_command_says_what_it_wrote(tmp_path: Path) -> None:
    MadeLog(frames=6, cameras={}).write(tmp_path)
    line = ("data", "import", "123d", tmp_path / "logs", "--out", tmp_path / "root", "--workers", "1", "--json")
    done = run_main(*line)
    assert done.code == 0 and [scene["name"] for scene in done.json["scenes"]] == ["drive-1"]
    assert done.json["scenes"][0]["split"] == "train" and "cameras" in done.json["scenes"][0]["lacks"]
