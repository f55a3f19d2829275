"""Ways to cheat, and to slip: each changes one thing of an honest entry, and names the rule that must find it."""

import json
import math
import shutil
from collections.abc import Callable, Container
from functools import partial
from typing import Any, NamedTuple

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
Forge = Callable[[Forged], object]
Change = Callable[[int, Row], object]
"""Of an annotation, at a keyframe."""


class Forgery(NamedTuple):
    """What is done; the rule, or its beginning, among the reasons (none where the entry is bad input); its words."""

    name: str
    rule: str | None
    says: str
    forge: Forge


def each(agent: int, change: Change) -> Forge:
    """Changes every annotation of somebody."""
    return lambda entry: entry.annotations(change, agent)


def with_values(agent: int, **values: Any) -> Forge:
    return each(agent, lambda _, row: row.update(values))


def moved(x: float = 0.0, y: float = 0.0, *, start: int = 0, until: int = LAST) -> Change:
    def change(keyframe: int, row: Row) -> None:
        if start <= keyframe <= until:
            row["translation"] = [row["translation"][0] + x, row["translation"][1] + y, row["translation"][2]]

    return change


def drifting(start: int, x: float = 0.0, y: float = 0.0, most: int = LAST) -> Change:
    """Moved by so much for each keyframe after the first one."""
    return lambda at, row: moved(x * min(max(at - start, 0), most), y * min(max(at - start, 0), most))(at, row)


def turned(angle: float, start: int = 0, each_keyframe: bool = False) -> Change:
    def change(at: int, row: Row) -> None:
        if at > start:
            half = angle / 2 * (at - start if each_keyframe else 1)
            row["rotation"] = [math.cos(half), 0.0, 0.0, math.sin(half)]

    return change


def larger(agent: int, side: int, by_m: float) -> Forge:
    return each(agent, lambda _, row: row["size"].__setitem__(side, row["size"][side] + by_m))


def keeping(agent: int, keep: Callable[[int], bool] = lambda _: False) -> Forge:
    """Leaves out annotations of somebody."""
    return lambda entry: entry.drop_annotations(agent, keep)


def token_of(entry: Forged, table: str, name: str) -> str:
    return str(next(row["token"] for row in entry.read(table) if row["name"] == name))


def in_row(table: str, change: Callable[[Row], object], channel: str, at: int, field: str) -> Forge:
    """Changes the row of a table to which a sensor's data at a keyframe refer."""

    def forge(entry: Forged) -> None:
        token = entry.data_rows(channel)[at][field]
        with entry.rows(table) as rows:
            change(next(row for row in rows if row["token"] == token))

    return forge


def pose(channel: str, at: int, axis: int, by_m: float) -> Forge:
    def change(row: Row) -> None:
        row["translation"][axis] += by_m

    return in_row("ego_pose", change, channel, at, "ego_pose_token")


def mount(channel: str, axis: int, by_m: float) -> Forge:
    def change(row: Row) -> None:
        row["translation"][axis] += by_m

    return in_row("calibrated_sensor", change, channel, 0, "calibrated_sensor_token")


def stretch_lens(row: Row) -> None:
    row["camera_intrinsic"][0][0] *= 1.01


def made_up_vehicle(entry: Forged) -> None:
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


def everybody_else_gone(entry: Forged) -> None:
    for agent in (TRUCK, PEDESTRIAN, PARKED, ONCOMING, LEADER):
        entry.drop_annotations(agent, lambda _: False)


def nothing_changed(entry: Forged) -> None:
    recorded, name = Forged(entry.root.parent / "base"), "scene-9901"
    cutter, samples = recorded.instance(CUTTER, name), recorded.samples(name)
    rows = [row for row in recorded.read("sample_annotation") if row["instance_token"] == cutter]
    theirs = {samples.index(row["sample_token"]): row for row in rows}
    same = ("translation", "rotation", "attribute_tokens", "visibility_token", "num_lidar_pts")
    entry.annotations(lambda keyframe, row: row.update({name: theirs[keyframe][name] for name in same}), CUTTER)


def said_of_the_scene(values: Callable[[Forged], Row]) -> Forge:
    def forge(entry: Forged) -> None:
        path = entry.folder / "challenger.json"
        made = json.loads(path.read_text())
        made["scenes"]["scene-9901-a"] |= values(entry)
        path.write_text(json.dumps(made))

    return forge


def exchanged_tokens(entry: Forged) -> None:
    recorded = Forged(entry.root.parent / "base")
    first, second = (recorded.instance(agent, "scene-9901") for agent in (LEADER, ONCOMING))
    rename = {entry.instance(LEADER): second, entry.instance(ONCOMING): first}
    for table, field in (("sample_annotation", "instance_token"), ("instance", "token")):
        with entry.rows(table) as rows:
            for row in rows:
                row[field] = rename.get(row[field], row[field])


def pedestrian_as_barrier(entry: Forged) -> None:
    barrier, pedestrian = token_of(entry, "category", "movable_object.barrier"), entry.instance(PEDESTRIAN)
    with entry.rows("instance") as rows:
        next(row for row in rows if row["token"] == pedestrian)["category_token"] = barrier


def no_points_and_no_file(entry: Forged) -> None:
    (entry.folder / "challenger.json").unlink()
    entry.annotations(lambda keyframe, row: row.update(num_lidar_pts=0) if keyframe > 5 else None, CUTTER)


def least_visible(entry: Forged) -> None:
    least = min(row["token"] for row in entry.read("visibility"))
    entry.annotations(lambda _, row: row.update(visibility_token=least), TRUCK)


def parked_oncoming(entry: Forged) -> None:
    parked = token_of(entry, "attribute", "vehicle.parked")
    entry.annotations(lambda _, row: row.update(attribute_tokens=[parked]), ONCOMING)


def turned_path(entry: Forged) -> None:
    poses = {row["ego_pose_token"] for row in entry.data_rows("LIDAR_TOP")}
    with entry.rows("ego_pose") as rows:
        for row in rows:
            if row["token"] in poses:
                row["rotation"] = [math.cos(0.01), 0.0, 0.0, math.sin(0.01)]


def faster_on_the_can_bus(entry: Forged) -> None:
    path = entry.root / "can_bus" / "scene-9901-a_pose.json"
    messages = [{**each, "vel": [1.5 * value for value in each["vel"]]} for each in json.loads(path.read_text())]
    path.write_text(json.dumps(messages))


def no_can_bus(entry: Forged) -> None:
    for path in (entry.root / "can_bus").glob("scene-9901-a_*"):
        path.unlink()


def shift_times(by_us: int, keyframes: Container[int], entry: Forged) -> None:
    samples = [token for index, token in enumerate(entry.samples()) if index in keyframes]
    with entry.rows("sample_data") as rows:
        data = [row for row in rows if row["sample_token"] in samples]
        for row in data:
            row["timestamp"] += by_us
    for table, tokens in (("sample", samples), ("ego_pose", {row["ego_pose_token"] for row in data})):
        with entry.rows(table) as rows:
            for row in rows:
                row["timestamp"] += by_us if row["token"] in tokens else 0


def early_end(entry: Forged) -> None:
    gone, last = set(entry.samples()[12:]), entry.samples()[11]
    for agent in (CUTTER, LEADER, ONCOMING, PARKED, PEDESTRIAN, TRUCK):
        entry.drop_annotations(agent, lambda keyframe: keyframe < 12)
    with entry.rows("sample_data") as rows:
        rows[:] = [row for row in rows if row["sample_token"] not in gone]
        kept = {row["token"] for row in rows}
        for row in rows:
            row["next"] = row["next"] if row["next"] in kept else ""
    with entry.rows("sample") as rows:
        rows[:] = [row for row in rows if row["token"] not in gone]
        next(row for row in rows if row["token"] == last)["next"] = ""
    with entry.rows("scene") as rows:
        next(row for row in rows if row["name"] == "scene-9901-a").update(nbr_samples=12, last_sample_token=last)


def change_map(change: Callable[[Row], object], entry: Forged) -> None:
    path = entry.root / "maps" / "expansion" / "boston-seaport.json"
    content = json.loads(path.read_text())
    for node in content["node"]:
        change(node)
    path.write_text(json.dumps(content))


def another_city(entry: Forged) -> None:
    with entry.rows("log") as rows:
        for row in rows:
            row["location"] = "singapore-onenorth"


def stopped(keyframe: int, row: Row) -> None:
    if keyframe >= 8:
        row.update(translation=[98.0, 197.5, row["translation"][2]], rotation=[1.0, 0.0, 0.0, 0.0])


def crab(entry: Forged) -> None:
    entry.annotations(turned(0.0, -1), CUTTER)
    entry.annotations(drifting(9, y=2.0, most=3), CUTTER)


def pedestrian_adversary(entry: Forged) -> None:
    nothing_changed(entry)
    entry.annotations(drifting(0, y=-0.3), PEDESTRIAN)


def truncated_image(entry: Forged) -> None:
    path = entry.image("CAM_BACK_RIGHT", 3)
    path.write_bytes(path.read_bytes()[:-400])


def small_image(entry: Forged) -> None:
    path = str(entry.image("CAM_FRONT_LEFT", 2))
    cv2.imwrite(path, cv2.resize(cv2.imread(path), (48, 27)))


def black_image(entry: Forged) -> None:
    cv2.imwrite(str(entry.image("CAM_FRONT", 9)), np.zeros((54, 96, 3), np.uint8))


def exchanged_images(entry: Forged) -> None:
    one, other = entry.image("CAM_FRONT", 3), entry.image("CAM_FRONT", 13)
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


def images_of_another_camera(entry: Forged) -> None:
    for at in range(LAST + 1):
        shutil.copy(entry.image("CAM_BACK", at), entry.image("CAM_FRONT", at))


def late_images(entry: Forged) -> None:
    for at in range(LAST, 1, -1):
        shutil.copy(entry.image("CAM_FRONT", at - 2), entry.image("CAM_FRONT", at))


def recorded_images(entry: Forged) -> None:
    recorded = Forged(entry.root.parent / "base")
    for camera in (path.name for path in (entry.root / "samples").glob("CAM_*")):
        for at in range(LAST + 1):
            shutil.copy(recorded.image(camera, at, "scene-9901"), entry.image(camera, at))


def no_back_camera(entry: Forged) -> None:
    gone = {row["token"] for row in entry.data_rows("CAM_BACK")}
    with entry.rows("sample_data") as rows:
        rows[:] = [row for row in rows if row["token"] not in gone]


def two_egos(entry: Forged) -> None:
    token = entry.data_rows("LIDAR_TOP")[5]["token"]
    with entry.rows("sample_data") as rows:
        row = next(row for row in rows if row["token"] == token)
        rows.append({**row, "token": "e" * 32, "prev": "", "next": ""})


def listed_twice(entry: Forged) -> None:
    with entry.rows("scene") as rows:
        rows.append(dict(next(row for row in rows if row["name"] == "scene-9901-a"), token="d" * 32))


def truncated_table(entry: Forged) -> None:
    path = entry.folder / "ego_pose.json"
    path.write_bytes(path.read_bytes()[:-100])


SIDEWAYS = {"rotation": [0.999, 0.0, 0.0, math.sqrt(1 - 0.999**2)]}
FORGERIES = [Forgery._make(row) for row in (
    # Somebody else is changed too.
    ("a second vehicle moved by 5 cm", "changed.most", "by up to 0.05 m", each(LEADER, moved(x=0.05))),
    ("one moved by a micrometre", "changed.most", "by up to 1e-06 m", each(ONCOMING, moved(y=1e-6, start=3, until=3))),
    ("a second adversary", "changed.most", "may change 1", each(LEADER, drifting(0, y=-0.1))),
    ("a parked car turned", "changed.most", "in time or heading", with_values(PARKED, **SIDEWAYS)),
    ("a pedestrian deleted", "changed.most", "leaves out human.pedestrian.adult", keeping(PEDESTRIAN)),
    ("a pedestrian gone half way", "changed.most", "human.pedestrian.adult", keeping(PEDESTRIAN, lambda at: at < 8)),
    ("a vehicle made up", "changed.most", "adds, which the recording lacks:", made_up_vehicle),
    ("everybody else gone", "changed.most", "leaves out", everybody_else_gone),
    ("nothing changed", "changed.least", "must change 1", nothing_changed),
    ("another vehicle named as adversary", "changed.least", "which moves as recorded",
     said_of_the_scene(lambda entry: {"adversaries": [entry.instance(LEADER)]})),
    ("tokens of two vehicles exchanged", "changed.most", "changes 3 objects", exchanged_tokens),
    # What everybody is labelled as.
    ("the adversary made wider", "unchanged.position_m", "the size of vehicle.car", larger(CUTTER, 0, 0.4)),
    ("a truck made shorter", "unchanged.position_m", "the size of vehicle.truck", larger(TRUCK, 1, -0.01)),
    ("the category of a pedestrian changed", "changed.categories", "the category of", pedestrian_as_barrier),
    ("points taken from the leader so that protocols drop it", "unchanged.points", "the lidar points of vehicle.car",
     with_values(LEADER, num_lidar_pts=0, num_radar_pts=0)),
    ("an adversary without points that no file names", "unchanged.points", "has no lidar point", no_points_and_no_file),
    ("visibility changed", "unchanged.points", "the visibility of", least_visible),
    ("an attribute changed", "unchanged.points", "the attribute of", parked_oncoming),
    # The ego, its sensors and its time.
    ("the ego nudged", "unchanged.position_m", "moves the ego at 1 keyframe", pose("LIDAR_TOP", 7, 1, 0.02)),
    ("the path of the ego turned", "unchanged.", "moves the ego at 16 keyframes", turned_path),
    ("the pose of a camera", "unchanged.position_m", "alters the ego pose of CAM_BACK", pose("CAM_BACK", 4, 0, 1.0)),
    ("speeds on the CAN bus altered", "unchanged.motion", "velocity", faster_on_the_can_bus),
    ("the CAN bus removed", "unchanged.motion", "alters the ego's", no_can_bus),
    ("the front camera stretched", "unchanged.position_m", "alters the calibration of CAM_FRONT",
     in_row("calibrated_sensor", stretch_lens, "CAM_FRONT", 0, "calibrated_sensor_token")),
    ("a camera mounted elsewhere", "unchanged.position_m", "alters the calibration of CAM_BACK_LEFT",
     mount("CAM_BACK_LEFT", 2, 0.3)),
    ("the lidar mounted elsewhere", "unchanged.position_m", "moves LIDAR_TOP", mount("LIDAR_TOP", 0, 0.1)),
    ("the time of a keyframe", "unchanged.times", "1 keyframe at another time", partial(shift_times, 20_000, {6})),
    ("all times shifted", None, "no keyframe of scene-9901-a is at a time of its recording",
     partial(shift_times, 40_000, range(LAST + 1))),
    ("the scene ends early", "unchanged.times", "has 12 keyframes, its recording has 16", early_end),
    ("the map widened for the adversary", "unchanged.map_m2", "map",
     partial(change_map, lambda node: node.update(y=node["y"] + 6.0) if node["y"] > 206.9 else None)),
    ("the map shifted", "unchanged.map_m2", "alters the map around the ego",
     partial(change_map, lambda node: node.update(x=node["x"] + 0.5))),
    ("another city", "unchanged.map_m2", "location", another_city),
    # What the adversary does.
    ("it jumps", "motion.", "at 4.5 s", each(CUTTER, moved(y=2.5, start=10, until=10))),
    ("it is teleported between keyframes", "motion.", "m/s^2", each(CUTTER, moved(x=14.0, start=9))),
    ("it stops at once", "motion.braking_m_s2", "of braking", each(CUTTER, stopped)),
    ("it slides like a crab", "motion.sideways_m_s", "sideways", crab),
    ("it drives tail first", "motion.backwards_m_s", "backwards", each(CUTTER, turned(math.pi, 3))),
    ("it spins", "motion.yaw_rate_rad_s", "yaw rate", each(CUTTER, turned(1.2, 4, each_keyframe=True))),
    ("its launch jumps", "motion.launch_m_s2", "where its recorded track ends", each(CUTTER, moved(x=9.0, start=4))),
    ("it begins elsewhere", "changed.start_m", "from its recorded", each(CUTTER, moved(x=3.0))),
    ("it vanishes", "changed.to_the_end", "be gone at keyframe 12", keeping(CUTTER, lambda at: at < 12)),
    ("it blinks", "changed.to_the_end", "be gone at keyframe 9", keeping(CUTTER, lambda at: at != 9)),
    ("it appears late", "changed.start_m", "at keyframe 3; the recording starts it at",
     keeping(CUTTER, lambda at: at >= 3)),
    ("it leaves the road", "road.", "the drivable area", each(CUTTER, drifting(5, y=-1.0))),
    ("it overlaps another vehicle", "gaps.others_m", "touches vehicle.car", each(CUTTER, drifting(4, x=2.6))),
    ("the recorded ego does not pass it", "gaps.ego_m", "hits the recorded ego", each(CUTTER, drifting(4, x=-1.7))),
    ("it is a pedestrian", "changed.categories", "which no entry may", pedestrian_adversary),
    # Images.
    ("an image missing", "images.required", "is missing", lambda entry: entry.image("CAM_FRONT", 5).unlink()),
    ("all images missing", "images.required", "is missing", lambda entry: shutil.rmtree(entry.root / "samples")),
    ("an image truncated", "images.required", "cannot be read", truncated_image),
    ("an image that is text", "images.required", "cannot be read",
     lambda entry: entry.image("CAM_BACK", 0).write_text("not a readable picture")),
    ("an image of another size", "images.required", "its row has 96 x 54", small_image),
    ("a black image", "images.least_contrast", "shows nothing", black_image),
    ("the image of another frame", "images.of_their_time", "keyframe 4",
     lambda entry: shutil.copy(entry.image("CAM_FRONT", 12), entry.image("CAM_FRONT", 4))),
    ("two images exchanged", "images.of_their_time", "CAM_FRONT", exchanged_images),
    ("another camera's", "images.of_their_time", "show the recorded view of CAM_BACK", images_of_another_camera),
    ("the images of a camera late", "images.of_their_time", "2 keyframes earlier", late_images),
    ("the recording's", "images.of_their_time", "are the recording's, without it", recorded_images),
    ("a camera left out", "images.required", "has no CAM_BACK", no_back_camera),
    # Scenes and tables as a whole.
    ("another recording's scene", None, "which", said_of_the_scene(lambda _: {"source_scene": "scene-0061"})),
    ("a place that is no number", None, "translation", each(LEADER, moved(x=math.nan, start=2, until=2))),
    ("two egos", None, "LIDAR_TOP", two_egos),
    ("a scene listed twice", None, "scene-9901-a", listed_twice),
    ("tokens that point elsewhere", None, "sample_token",
     each(LEADER, lambda at, row: row.update(sample_token="0" * 32) if at == 4 else None)),
    ("a table truncated", None, "ego_pose", truncated_table),
    ("no tables", None, "no version folder", lambda entry: shutil.rmtree(entry.root / VERSION)),
)]  # fmt: skip
