"""Consistency of rows across tables: calibration, images, times of sensors, maps of logs, intervals of keyframes.

Official protocols take these intervals for steps of half a second at any rate of the data.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

from benchmark.constants import LIDAR_NAME
from benchmark.datasets.scene_names import is_devkit_name
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.datasets.steps import LONGEST_KNOWN_US, STEP_US, find_irregular_interval_us, is_step
from benchmark.report.words import pluralise


def check_rates(tables: CheckedTables, faults: FaultList) -> None:
    """Warn of scenes whose median keyframe interval is not that of nuScenes; samples of all scenes are needed."""
    for scene, times_us in _times_of_scenes(tables):
        usual_us = find_irregular_interval_us(times_us)
        if usual_us is None:
            continue
        explanation = (
            "nothing is known at steps" if usual_us > LONGEST_KNOWN_US else "exact and driving scores interpolate steps"
        )
        sentence = (
            f"the keyframes of {scene['name']} are {usual_us * 1e-6:.3g} s apart (median): {explanation} of "
            f"{STEP_US * 1e-6:g} s, and official protocols, whose steps are keyframes, do not count its samples"
        )
        faults.add("scenes with another keyframe rate", "scene", scene["token"], sentence, severity="warning")


def check_gaps(tables: CheckedTables, faults: FaultList) -> None:
    """Warn of keyframes nearer or farther apart than steps at 2 Hz, else only of gaps across which nothing is known."""
    for scene, times_us in _times_of_scenes(tables):
        usual_us = find_irregular_interval_us(times_us)
        if usual_us is not None and usual_us > LONGEST_KNOWN_US:
            continue
        for number, (time_us, next_time_us) in enumerate(pairwise(times_us)):
            gap_us = next_time_us - time_us
            if gap_us <= LONGEST_KNOWN_US if usual_us is not None else is_step(gap_us):
                continue
            effect = (
                "exact and driving scores treat steps in or after the gap as unknown"
                if gap_us > LONGEST_KNOWN_US
                else f"exact and driving scores interpolate steps of {STEP_US * 1e-6:g} s there"
            )
            sentence = (
                f"keyframes {number} and {number + 1} of {scene['name']} are {gap_us * 1e-6:.3g} s apart: {effect}, "
                "and official protocols take the k-th following keyframe for step k"
            )
            faults.add("gaps between keyframes", "scene", scene["token"], sentence, severity="warning")


def check_tutorial(tables: CheckedTables, faults: FaultList) -> None:
    """Warn, once of each, of what calls of the devkit's tutorial fail at; nothing else needs it."""
    names: defaultdict[int, list[str]] = defaultdict(list)
    for scene, times_us in _times_of_scenes(tables):
        for time_us in times_us[:1]:
            names[time_us].append(scene["name"])
    together = [scenes for scenes in names.values() if len(scenes) > 1]
    if together:
        sentence = (
            f"{pluralise(sum(map(len, together)), 'scene')} begin at the same time as another, such as "
            f"{' and '.join(sorted(together[0])[:2])}: the devkit's list_scenes() ends in a TypeError; scenes made "
            "anew into another folder have times of their own"
        )
        faults.add("scenes that begin together", "scene", "", sentence, severity="warning")
    odd = [row["name"] for row in tables.having("scene", "name") if not is_devkit_name(row["name"])]
    if odd:
        sentence = (
            f"{pluralise(len(odd), 'name')} such as {odd[0]} {'is' if len(odd) == 1 else 'are'} not scene- and four "
            "digits: the devkit's NuScenesCanBus and render_egoposes_on_fancy_map() fail there; scenes generated anew "
            "into another folder have such names"
        )
        faults.add("scenes without a number", "scene", "", sentence, severity="warning")


def _times_of_scenes(tables: CheckedTables) -> Iterator[tuple[Row, list[int]]]:
    """Scenes with the times of their samples, increasing."""
    times_us: defaultdict[str, list[int]] = defaultdict(list)
    for row in tables.having("sample", "scene_token", "timestamp"):
        times_us[row["scene_token"]].append(row["timestamp"])
    for scene in tables.having("scene", "name"):
        yield scene, sorted(times_us[scene["token"]])


KEYFRAME_TOLERANCE_S: Final = 0.1
"""Farthest in time that a keyframe's sensor rows may be from their sample; in nuScenes it is about 50 ms."""


def check_shared(tables: CheckedTables, faults: FaultList) -> None:
    """Note cameras and logs that cannot be, in the tables that do not grow with the scenes."""
    for row in tables.having("calibrated_sensor", "sensor_token", "camera_intrinsic"):
        sensor = tables.get("sensor", row["sensor_token"], "modality", "channel")
        if sensor is None or sensor["modality"] != "camera":
            continue
        problem = _intrinsic_problem(row["camera_intrinsic"])
        if problem:
            sentence = f"camera_intrinsic of {sensor['channel']} {problem}"
            faults.add("wrong camera_intrinsic", "calibrated_sensor", row["token"], sentence)
    if "scene" not in tables.unreadable and not tables.rows["scene"]:
        faults.add("no scenes", "scene", "", "scene.json is empty; a data set needs at least one scene")
    _check_logs(tables, faults)


def check_images(tables: CheckedTables, faults: FaultList) -> None:
    """Note camera images without pixels."""
    for row in tables.having("sample_data", "width", "height", "calibrated_sensor_token"):
        calibration = tables.get("calibrated_sensor", row["calibrated_sensor_token"], "sensor_token")
        sensor = None if calibration is None else tables.get("sensor", calibration["sensor_token"], "modality")
        if sensor is not None and sensor["modality"] == "camera" and min(row["width"], row["height"]) <= 0:
            sentence = f"the image is {row['width']} x {row['height']} pixels"
            faults.add("images without pixels", "sample_data", row["token"], sentence)


def check_sensors(tables: CheckedTables, faults: FaultList, *, lidar_is_placed: bool = False) -> None:
    """Note samples that lack a keyframe row of a sensor, have two, or rows of another time, and scenes without lidar.

    ``lidar_is_placed`` where it is said in which place plans are given.
    """
    channels: defaultdict[str, set[str]] = defaultdict(set)
    keyframes: defaultdict[str, list[tuple[str, Row]]] = defaultdict(list)
    for row in tables.having("sample_data", "sample_token", "calibrated_sensor_token", "is_key_frame"):
        sample = tables.get("sample", row["sample_token"], "scene_token")
        channel = _channel(tables, row)
        if sample is None or channel is None:
            continue
        channels[sample["scene_token"]].add(channel)
        if row["is_key_frame"]:
            keyframes[row["sample_token"]].append((channel, row))
        _check_pose_time(tables, row, faults)
    if tables.unreadable & {"sample_data", "calibrated_sensor", "sensor"}:
        return
    for sample in tables.having("sample", "scene_token"):
        row_counts = Counter(channel for channel, _ in keyframes[sample["token"]])
        expected = channels[sample["scene_token"]]
        missing = sorted(expected - set(row_counts))
        if missing:
            sentence = f"the sample has no keyframe row of {', '.join(missing)}"
            faults.add("samples without all sensors", "sample", sample["token"], sentence)
        if not expected:
            faults.add(
                "samples without sensors", "sample", sample["token"], "no sensor row leads to the sample's scene"
            )
        for channel in sorted(name for name, count in row_counts.items() if count > 1):
            sentence = f"{row_counts[channel]} keyframe rows of {channel} refer to this sample"
            faults.add("samples with a sensor twice", "sample", sample["token"], sentence)
        for channel, row in keyframes[sample["token"]]:
            seconds_apart = _seconds_apart(tables, ("sample_data", row["token"]), ("sample", sample["token"]))
            if seconds_apart > KEYFRAME_TOLERANCE_S:
                sentence = f"this keyframe row of {channel} is {seconds_apart:.3g} s away from its sample"
                faults.add("keyframe rows of another time", "sample_data", row["token"], sentence)
    for scene in tables.having("scene", "name"):
        if channels[scene["token"]] and not lidar_is_placed and LIDAR_NAME not in channels[scene["token"]]:
            sentence = f"{scene['name']} has no {LIDAR_NAME}: its place is taken to be that on nuScenes' cars"
            faults.add("scenes without lidar", "scene", scene["token"], sentence, severity="warning")


def _check_pose_time(tables: CheckedTables, row: Row, faults: FaultList) -> None:
    seconds_apart = _seconds_apart(tables, ("sample_data", row["token"]), ("ego_pose", str(row.get("ego_pose_token"))))
    if seconds_apart > KEYFRAME_TOLERANCE_S:
        faults.add(
            "ego poses of another time", "sample_data", row["token"], f"its ego pose is from {seconds_apart:.3g} s away"
        )


def _seconds_apart(tables: CheckedTables, first: tuple[str, str], second: tuple[str, str]) -> float:
    """Time between two rows; zero where one has none that can be relied on."""
    rows = [tables.get(table, token, "timestamp") for table, token in (first, second)]
    if rows[0] is None or rows[1] is None:
        return 0.0
    return float(abs(rows[0]["timestamp"] - rows[1]["timestamp"]) * 1e-6)


def _channel(tables: CheckedTables, row: Row) -> str | None:
    calibration = tables.get("calibrated_sensor", row["calibrated_sensor_token"], "sensor_token")
    sensor = None if calibration is None else tables.get("sensor", calibration["sensor_token"], "channel")
    return None if sensor is None else str(sensor["channel"])


def _intrinsic_problem(intrinsic: Any) -> str:
    if not intrinsic:
        return "is not a 3 x 3 matrix"
    if intrinsic[0][0] <= 0 or intrinsic[1][1] <= 0:
        return "has a focal length that is not positive"
    return "" if intrinsic[2] == [0, 0, 1] else f"ends with the row {intrinsic[2]}, not 0, 0, 1"


def check_copied_intrinsics(tables: CheckedTables, faults: FaultList) -> None:
    """Warn where CAM_BACK has the matrix of CAM_FRONT, whose lens is narrower; so it is in the published Adv-nuSc."""
    front_and_back: defaultdict[str, dict[str, Row]] = defaultdict(dict)
    for row in tables.having("sample_data", "sample_token", "calibrated_sensor_token"):
        channel = _channel(tables, row)
        sample = tables.get("sample", row["sample_token"], "scene_token")
        if sample is not None and channel in ("CAM_FRONT", "CAM_BACK"):
            calibration = tables.get("calibrated_sensor", row["calibrated_sensor_token"], "camera_intrinsic")
            if calibration is not None:
                front_and_back[sample["scene_token"]].setdefault(channel, calibration)
    for scene_token, pair in front_and_back.items():
        if len(pair) == 2 and pair["CAM_FRONT"]["camera_intrinsic"] == pair["CAM_BACK"]["camera_intrinsic"]:
            sentence = f"CAM_BACK has the intrinsic matrix of CAM_FRONT in scene {scene_token}, as if it were copied"
            token = pair["CAM_BACK"]["token"]
            faults.add("copied intrinsics", "calibrated_sensor", token, sentence, severity="warning")


def _check_logs(tables: CheckedTables, faults: FaultList) -> None:
    if tables.unreadable & {"log", "map"}:
        return
    listed = {token for row in tables.having("map", "log_tokens") for token in row["log_tokens"]}
    for row in tables.rows["log"]:
        if row["token"] not in listed:
            sentence = "no map has this log among its log_tokens; the devkit cannot open such a data set"
            faults.add("logs without map", "log", row["token"], sentence)
