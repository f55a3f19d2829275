"""Ways to cheat, and to slip: each changes one thing of an honest entry, and names the rule that must find it."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from tests.benchmark.extensions.challenge.small_entries import (
    CUTTER,
    LEADER,
    ONCOMING,
    PARKED,
    PEDESTRIAN,
    TRUCK,
    VERSION,
    Forged,
    Row,
)

LAST = 15
"""Of the keyframes 0 to 15."""


@dataclass(frozen=True)
class Forgery:
    """One way.

    Attributes:
        name: What is done.
        forge: Does it.
        rule: The rule, or its beginning, that must be among the reasons; none where the entry is bad input.
        says: Words of the sentence.
    """

    name: str
    forge: Callable[[Forged], None]
    rule: str | None
    says: str


FORGERIES: list[Forgery] = []


def forgery(rule: str | None, says: str) -> Callable[[Callable[[Forged], None]], Callable[[Forged], None]]:
    def known(forge: Callable[[Forged], None]) -> Callable[[Forged], None]:
        FORGERIES.append(Forgery(forge.__name__.replace("_", " "), forge, rule, says))
        return forge

    return known


def moved(x: float = 0.0, y: float = 0.0, *, from_keyframe: int = 0, until: int = LAST) -> Callable[[int, Row], None]:
    def change(keyframe: int, row: Row) -> None:
        if from_keyframe <= keyframe <= until:
            row["translation"] = [row["translation"][0] + x, row["translation"][1] + y, row["translation"][2]]

    return change


def put(entry: Forged, agent: int, places: dict[int, tuple[float, float]], yaw: float = 0.0) -> None:
    def change(keyframe: int, row: Row) -> None:
        if keyframe in places:
            row["translation"] = [*places[keyframe], row["translation"][2]]
            row["rotation"] = [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))]

    entry.annotations(change, agent)


# Somebody else is changed too.


@forgery("changed.most", "by up to 0.05 m")
def a_second_vehicle_moved_by_5_cm(entry: Forged) -> None:
    entry.annotations(moved(x=0.05), LEADER)


@forgery("changed.most", "by up to 1e-06 m")
def a_second_vehicle_moved_by_a_thousandth_of_a_millimetre(entry: Forged) -> None:
    entry.annotations(moved(y=1e-6, from_keyframe=3, until=3), ONCOMING)


@forgery("changed.most", "may change 1")
def a_second_adversary(entry: Forged) -> None:
    entry.annotations(lambda keyframe, row: moved(y=-0.1 * keyframe)(keyframe, row), LEADER)


@forgery("changed.most", "in time or heading")
def a_parked_car_turned(entry: Forged) -> None:
    entry.annotations(lambda _, row: row.update(rotation=[0.999, 0.0, 0.0, float(np.sqrt(1 - 0.999**2))]), PARKED)


@forgery("changed.most", "leaves out human.pedestrian.adult")
def a_pedestrian_deleted(entry: Forged) -> None:
    entry.drop_annotations(PEDESTRIAN, lambda _: False)


@forgery("changed.most", "human.pedestrian.adult")
def a_pedestrian_gone_after_half_of_the_scene(entry: Forged) -> None:
    entry.drop_annotations(PEDESTRIAN, lambda keyframe: keyframe < 8)


@forgery("changed.most", "adds, which the recording lacks:")
def a_vehicle_made_up(entry: Forged) -> None:
    instance = entry.instance(PARKED)
    with entry.rows("sample_annotation") as rows:
        copies = [dict(row) for row in rows if row["instance_token"] == instance]
        for copy in copies:
            copy.update({end: copy[end][::-1] for end in ("token", "prev", "next")})
            copy["instance_token"] = "f" * 32
            copy["translation"] = [copy["translation"][0] + 40.0, *copy["translation"][1:]]
        rows += copies
    with entry.rows("instance") as rows:
        row = dict(next(row for row in rows if row["token"] == instance))
        row.update(token="f" * 32, first_annotation_token=copies[0]["token"], last_annotation_token=copies[-1]["token"])
        rows.append(row)


@forgery("changed.most", "leaves out")
def everybody_else_gone(entry: Forged) -> None:
    for agent in (TRUCK, PEDESTRIAN, PARKED, ONCOMING, LEADER):
        entry.drop_annotations(agent, lambda _: False)


@forgery("changed.least", "must change 1")
def nothing_changed(entry: Forged) -> None:
    recorded = Forged(entry.root.parent / "base")
    names = {"recorded": "scene-9901", "entry": "scene-9901-a"}
    theirs = {
        recorded.samples(names["recorded"]).index(row["sample_token"]): row
        for row in recorded.read("sample_annotation")
        if row["instance_token"] == recorded.instance(CUTTER, names["recorded"])
    }
    same = ("translation", "rotation", "attribute_tokens", "visibility_token", "num_lidar_pts")
    entry.annotations(lambda keyframe, row: row.update({name: theirs[keyframe][name] for name in same}), CUTTER)


@forgery("changed.least", "which moves as recorded")
def another_vehicle_named_as_adversary(entry: Forged) -> None:
    path = entry.folder / "challenger.json"
    made = json.loads(path.read_text())
    made["scenes"]["scene-9901-a"]["adversaries"] = [entry.instance(LEADER)]
    path.write_text(json.dumps(made))


@forgery("changed.most", "changes 3 objects")
def tokens_of_two_vehicles_exchanged(entry: Forged) -> None:
    recorded = Forged(entry.root.parent / "base")
    first, second = (recorded.instance(agent, "scene-9901") for agent in (LEADER, ONCOMING))
    rename = {entry.instance(LEADER): second, entry.instance(ONCOMING): first}
    for table, field in (("sample_annotation", "instance_token"), ("instance", "token")):
        with entry.rows(table) as rows:
            for row in rows:
                row[field] = rename.get(row[field], row[field])


# What everybody is labelled as.


@forgery("unchanged.position_m", "the size of vehicle.car")
def the_adversary_made_wider(entry: Forged) -> None:
    entry.annotations(lambda _, row: row.update(size=[row["size"][0] + 0.4, *row["size"][1:]]), CUTTER)


@forgery("unchanged.position_m", "the size of vehicle.truck")
def a_truck_made_shorter(entry: Forged) -> None:
    entry.annotations(lambda _, row: row.update(size=[row["size"][0], row["size"][1] - 0.01, row["size"][2]]), TRUCK)


@forgery("changed.categories", "the category of")
def the_category_of_a_pedestrian_changed(entry: Forged) -> None:
    barrier = next(row["token"] for row in entry.read("category") if row["name"] == "movable_object.barrier")
    with entry.rows("instance") as rows:
        next(row for row in rows if row["token"] == entry.instance(PEDESTRIAN))["category_token"] = barrier


@forgery("unchanged.points", "the lidar points of vehicle.car")
def points_taken_from_the_leader_so_that_protocols_drop_it(entry: Forged) -> None:
    entry.annotations(lambda _, row: row.update(num_lidar_pts=0, num_radar_pts=0), LEADER)


@forgery("unchanged.points", "has no lidar point")
def an_adversary_without_points_that_no_file_names(entry: Forged) -> None:
    (entry.folder / "challenger.json").unlink()
    entry.annotations(lambda keyframe, row: row.update(num_lidar_pts=0) if keyframe > 5 else None, CUTTER)


@forgery("unchanged.points", "the visibility of")
def visibility_changed(entry: Forged) -> None:
    least = min(row["token"] for row in entry.read("visibility"))
    entry.annotations(lambda _, row: row.update(visibility_token=least), TRUCK)


@forgery("unchanged.points", "the attribute of")
def an_attribute_changed(entry: Forged) -> None:
    parked = next(row["token"] for row in entry.read("attribute") if row["name"] == "vehicle.parked")
    entry.annotations(lambda _, row: row.update(attribute_tokens=[parked]), ONCOMING)


# The ego, its sensors and its time.


@forgery("unchanged.position_m", "moves the ego at 1 keyframe")
def the_ego_nudged_at_one_keyframe(entry: Forged) -> None:
    row = entry.data_rows("LIDAR_TOP")[7]
    with entry.rows("ego_pose") as rows:
        pose = next(pose for pose in rows if pose["token"] == row["ego_pose_token"])
        pose["translation"][1] += 0.02


@forgery("unchanged.", "moves the ego at 16 keyframes")
def the_path_of_the_ego_turned(entry: Forged) -> None:
    poses = {row["ego_pose_token"] for row in entry.data_rows("LIDAR_TOP")}
    with entry.rows("ego_pose") as rows:
        for pose in rows:
            if pose["token"] in poses:
                pose["rotation"] = [float(np.cos(0.01)), 0.0, 0.0, float(np.sin(0.01))]


@forgery("unchanged.position_m", "alters the ego pose of CAM_BACK")
def the_pose_of_one_camera_altered(entry: Forged) -> None:
    row = entry.data_rows("CAM_BACK")[4]
    with entry.rows("ego_pose") as rows:
        next(pose for pose in rows if pose["token"] == row["ego_pose_token"])["translation"][0] += 1.0


@forgery("unchanged.motion", "velocity")
def speeds_on_the_can_bus_altered(entry: Forged) -> None:
    path = entry.root / "can_bus" / "scene-9901-a_pose.json"
    messages = json.loads(path.read_text())
    for message in messages:
        message["vel"] = [1.5 * value for value in message["vel"]]
    path.write_text(json.dumps(messages))


@forgery("unchanged.motion", "alters the ego's")
def the_can_bus_removed(entry: Forged) -> None:
    for path in (entry.root / "can_bus").glob("scene-9901-a_*"):
        path.unlink()


@forgery("unchanged.position_m", "alters the calibration of CAM_FRONT")
def the_calibration_of_the_front_camera_altered(entry: Forged) -> None:
    token = entry.data_rows("CAM_FRONT")[0]["calibrated_sensor_token"]
    with entry.rows("calibrated_sensor") as rows:
        next(row for row in rows if row["token"] == token)["camera_intrinsic"][0][0] *= 1.01


@forgery("unchanged.position_m", "alters the calibration of CAM_BACK_LEFT")
def a_camera_mounted_elsewhere(entry: Forged) -> None:
    token = entry.data_rows("CAM_BACK_LEFT")[0]["calibrated_sensor_token"]
    with entry.rows("calibrated_sensor") as rows:
        next(row for row in rows if row["token"] == token)["translation"][2] += 0.3


@forgery("unchanged.position_m", "moves LIDAR_TOP")
def the_lidar_mounted_elsewhere(entry: Forged) -> None:
    token = entry.data_rows("LIDAR_TOP")[0]["calibrated_sensor_token"]
    with entry.rows("calibrated_sensor") as rows:
        next(row for row in rows if row["token"] == token)["translation"][0] += 0.1


@forgery("unchanged.times", "1 keyframe at another time")
def the_time_of_one_keyframe_shifted(entry: Forged) -> None:
    shift_times(entry, 20_000, {6})


@forgery(None, "no keyframe of scene-9901-a is at a time of its recording")
def all_times_shifted(entry: Forged) -> None:
    shift_times(entry, 40_000, set(range(LAST + 1)))


def shift_times(entry: Forged, by_us: int, keyframes: set[int]) -> None:
    samples = [token for index, token in enumerate(entry.samples()) if index in keyframes]
    with entry.rows("sample") as rows:
        for row in rows:
            row["timestamp"] += by_us if row["token"] in samples else 0
    poses = set()
    with entry.rows("sample_data") as rows:
        for row in rows:
            if row["sample_token"] in samples:
                row["timestamp"] += by_us
                poses.add(row["ego_pose_token"])
    with entry.rows("ego_pose") as rows:
        for row in rows:
            row["timestamp"] += by_us if row["token"] in poses else 0


@forgery("unchanged.times", "has 12 keyframes, its recording has 16")
def the_scene_ends_early(entry: Forged) -> None:
    gone = set(entry.samples()[12:])
    for agent in (CUTTER, LEADER, ONCOMING, PARKED, PEDESTRIAN, TRUCK):
        entry.drop_annotations(agent, lambda keyframe: keyframe < 12)
    with entry.rows("sample_data") as rows:
        rows[:] = [row for row in rows if row["sample_token"] not in gone]
        kept = {row["token"] for row in rows}
        for row in rows:
            row["next"] = row["next"] if row["next"] in kept else ""
    last = entry.samples()[11]
    with entry.rows("sample") as rows:
        rows[:] = [row for row in rows if row["token"] not in gone]
        next(row for row in rows if row["token"] == last)["next"] = ""
    with entry.rows("scene") as rows:
        next(row for row in rows if row["name"] == "scene-9901-a").update(nbr_samples=12, last_sample_token=last)


@forgery("unchanged.map_m2", "map")
def the_map_widened_for_the_adversary(entry: Forged) -> None:
    change_map(entry, lambda node: node.update(y=node["y"] + 6.0) if node["y"] > 206.9 else None)


@forgery("unchanged.map_m2", "alters the map around the ego")
def the_map_shifted(entry: Forged) -> None:
    change_map(entry, lambda node: node.update(x=node["x"] + 0.5))


def change_map(entry: Forged, change: Callable[[Row], None]) -> None:
    path = entry.root / "maps" / "expansion" / "boston-seaport.json"
    content = json.loads(path.read_text())
    for node in content["node"]:
        change(node)
    path.write_text(json.dumps(content))


@forgery("unchanged.map_m2", "location")
def another_city(entry: Forged) -> None:
    with entry.rows("log") as rows:
        for row in rows:
            row["location"] = "singapore-onenorth"


# What the adversary does.


@forgery("motion.", "at 4.5 s")
def an_adversary_that_jumps(entry: Forged) -> None:
    entry.annotations(moved(y=2.5, from_keyframe=10, until=10), CUTTER)


@forgery("motion.", "m/s^2")
def an_adversary_teleported_between_keyframes(entry: Forged) -> None:
    entry.annotations(moved(x=14.0, from_keyframe=9), CUTTER)


@forgery("motion.braking_m_s2", "of braking")
def an_adversary_that_stops_at_once(entry: Forged) -> None:
    put(entry, CUTTER, dict.fromkeys(range(8, LAST + 1), (98.0, 197.5)))


@forgery("motion.sideways_m_s", "sideways")
def an_adversary_that_slides_like_a_crab(entry: Forged) -> None:
    entry.annotations(lambda _, row: row.update(rotation=[1.0, 0.0, 0.0, 0.0]), CUTTER)
    entry.annotations(lambda at, row: moved(y=2.0 * min(at - 9, 3))(at, row) if at > 9 else None, CUTTER)


@forgery("motion.backwards_m_s", "backwards")
def an_adversary_that_drives_tail_first(entry: Forged) -> None:
    entry.annotations(lambda at, row: row.update(rotation=[0.0, 0.0, 0.0, 1.0]) if at > 3 else None, CUTTER)


@forgery("motion.yaw_rate_rad_s", "yaw rate")
def an_adversary_that_spins(entry: Forged) -> None:
    def turn(at: int, row: Row) -> None:
        if at > 4:
            row["rotation"] = [float(np.cos(0.6 * (at - 4))), 0.0, 0.0, float(np.sin(0.6 * (at - 4)))]

    entry.annotations(turn, CUTTER)


@forgery("motion.launch_m_s2", "where its recorded track ends")
def an_adversary_that_jumps_at_its_launch(entry: Forged) -> None:
    entry.annotations(moved(x=9.0, from_keyframe=4), CUTTER)


@forgery("changed.start_m", "from its recorded")
def an_adversary_that_begins_elsewhere(entry: Forged) -> None:
    entry.annotations(moved(x=3.0), CUTTER)


@forgery("changed.to_the_end", "be gone at keyframe 12")
def an_adversary_that_vanishes(entry: Forged) -> None:
    entry.drop_annotations(CUTTER, lambda keyframe: keyframe < 12)


@forgery("changed.to_the_end", "be gone at keyframe 9")
def an_adversary_that_blinks(entry: Forged) -> None:
    entry.drop_annotations(CUTTER, lambda keyframe: keyframe != 9)


@forgery("changed.start_m", "at keyframe 3; the recording starts it at")
def an_adversary_that_appears_late(entry: Forged) -> None:
    entry.drop_annotations(CUTTER, lambda keyframe: keyframe >= 3)


@forgery("road.", "the drivable area")
def an_adversary_off_the_road(entry: Forged) -> None:
    entry.annotations(lambda at, row: moved(y=-1.0 * max(at - 5, 0))(at, row), CUTTER)


@forgery("gaps.others_m", "touches vehicle.car")
def an_adversary_that_overlaps_a_background_vehicle(entry: Forged) -> None:
    entry.annotations(lambda at, row: moved(x=2.6 * max(at - 4, 0))(at, row), CUTTER)


@forgery("gaps.ego_m", "hits the recorded ego")
def an_adversary_that_the_recorded_ego_does_not_pass(entry: Forged) -> None:
    entry.annotations(lambda at, row: moved(x=-1.7 * max(at - 4, 0))(at, row), CUTTER)


@forgery("changed.categories", "which no entry may")
def an_adversary_that_is_a_pedestrian(entry: Forged) -> None:
    nothing_changed(entry)
    entry.annotations(lambda at, row: moved(y=-0.3 * at)(at, row), PEDESTRIAN)


# Images.


@forgery("images.required", "is missing")
def an_image_missing(entry: Forged) -> None:
    entry.image("CAM_FRONT", 5).unlink()


@forgery("images.required", "is missing")
def all_images_missing(entry: Forged) -> None:
    shutil.rmtree(entry.root / "samples")


@forgery("images.required", "cannot be read")
def an_image_truncated(entry: Forged) -> None:
    path = entry.image("CAM_BACK_RIGHT", 3)
    path.write_bytes(path.read_bytes()[:-400])


@forgery("images.required", "cannot be read")
def an_image_that_is_text(entry: Forged) -> None:
    entry.image("CAM_BACK", 0).write_text("not a readable picture")


@forgery("images.required", "its row has 96 x 54")
def an_image_of_another_size(entry: Forged) -> None:
    path = entry.image("CAM_FRONT_LEFT", 2)
    cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), (48, 27)))


@forgery("images.least_contrast", "shows nothing")
def a_black_image(entry: Forged) -> None:
    path = entry.image("CAM_FRONT", 9)
    cv2.imwrite(str(path), np.zeros((54, 96, 3), np.uint8))


@forgery("images.of_their_time", "keyframe 4")
def the_image_of_another_frame(entry: Forged) -> None:
    shutil.copy(entry.image("CAM_FRONT", 12), entry.image("CAM_FRONT", 4))


@forgery("images.of_their_time", "CAM_FRONT")
def two_images_exchanged(entry: Forged) -> None:
    one, other = entry.image("CAM_FRONT", 3), entry.image("CAM_FRONT", 13)
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


@forgery("images.of_their_time", "show the recorded view of CAM_BACK")
def the_images_of_another_camera(entry: Forged) -> None:
    for at in range(LAST + 1):
        shutil.copy(entry.image("CAM_BACK", at), entry.image("CAM_FRONT", at))


@forgery("images.of_their_time", "2 keyframes earlier")
def the_images_of_a_camera_late(entry: Forged) -> None:
    for at in range(LAST, 1, -1):
        shutil.copy(entry.image("CAM_FRONT", at - 2), entry.image("CAM_FRONT", at))


@forgery("images.of_their_time", "are the recording's, without it")
def the_images_of_the_recording_without_the_adversary(entry: Forged) -> None:
    recorded = Forged(entry.root.parent / "base")
    for camera in (path.name for path in (entry.root / "samples").glob("CAM_*")):
        for at in range(LAST + 1):
            shutil.copy(recorded.image(camera, at, "scene-9901"), entry.image(camera, at))


@forgery("images.required", "has no CAM_BACK")
def a_camera_left_out(entry: Forged) -> None:
    gone = {row["token"] for row in entry.data_rows("CAM_BACK")}
    with entry.rows("sample_data") as rows:
        rows[:] = [row for row in rows if row["token"] not in gone]


# Scenes and tables as a whole.


@forgery(None, "which")
def a_scene_of_another_recording(entry: Forged) -> None:
    path = entry.folder / "challenger.json"
    made = json.loads(path.read_text())
    made["scenes"]["scene-9901-a"]["source_scene"] = "scene-0061"
    path.write_text(json.dumps(made))


@forgery(None, "translation")
def a_place_that_is_no_number(entry: Forged) -> None:
    entry.annotations(moved(x=float("nan"), from_keyframe=2, until=2), LEADER)


@forgery(None, "LIDAR_TOP")
def two_egos(entry: Forged) -> None:
    with entry.rows("sample_data") as rows:
        row = dict(next(row for row in rows if row["token"] == entry.data_rows("LIDAR_TOP")[5]["token"]))
        row.update(token="e" * 32, prev="", next="")
        rows.append(row)


@forgery(None, "scene-9901-a")
def a_scene_listed_twice(entry: Forged) -> None:
    with entry.rows("scene") as rows:
        rows.append(dict(next(row for row in rows if row["name"] == "scene-9901-a"), token="d" * 32))


@forgery(None, "sample_token")
def tokens_that_point_elsewhere(entry: Forged) -> None:
    entry.annotations(lambda at, row: row.update(sample_token="0" * 32) if at == 4 else None, LEADER)


@forgery(None, "ego_pose")
def a_table_truncated(entry: Forged) -> None:
    path = entry.folder / "ego_pose.json"
    path.write_bytes(path.read_bytes()[:-100])


@forgery(None, "no version folder")
def no_tables(entry: Forged) -> None:
    shutil.rmtree(entry.root / VERSION)
