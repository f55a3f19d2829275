"""MCAP files read back: every message decoded and compared with the scene, and shown as a viewer would."""

import io
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.errors import InputError
from benchmark.extensions.mcap.camera_images import find_images
from benchmark.extensions.mcap.exporting import McapContents, encode_mcap, estimate_bytes, export_mcap
from benchmark.extensions.mcap.scene_messages import compute_speeds
from benchmark.geometry import Floats, to_global, transform_matrix, yaw_of_quaternion
from benchmark.planning import CameraView
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.row_schema import PlanCollision, PlanSeverityRow, SampleRow
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import SceneFacts
from benchmark.scene import Agents, Scene
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.records.hand_made_records import CLEAN, hand_made
from tests.benchmark.records.test_run import row

DRIVES = Path(__file__).resolve().parents[3] / "promise" / "kept" / "formats" / "drives-1"
NAME, RECORDED = "scene-9902", "scene-0007"
FAILS = 3
"""Sample on which the planner fails."""


def test_without_the_package_one_sentence_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(InputError, match=r"install it with: pip install 'challenger-bench\[mcap\]'"):
        export_mcap(town_of_two(), [NAME], tmp_path / "to")
    assert not list(tmp_path.iterdir())


pytest.importorskip("foxglove", reason="the extra mcap is not installed")
reader = pytest.importorskip("mcap.reader")
protobuf = pytest.importorskip("mcap_protobuf.decoder")


class Town(FakeData):
    """With images at key frames, and an adversary whose launch is known."""

    pictures: Mapping[str, Sequence[CameraView]] = {}

    def videos(self, name: str, *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
        return {camera: tuple(views) for camera, views in self.pictures.items()}

    def provenance(self) -> dict[str, Any]:
        report = {"launch_frame": 30, "labels": {"manoeuvre": "cut-in-left"}}
        made = {"adversaries": ["x"], "report": report, "source_scene": RECORDED}
        return {"scenes": {NAME: made}, "frozen": {"name": "road-adv-1"}}

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        return {name: build_scene_facts(name, self.provenance()["scenes"][name]) for name in names}


def changed_scene() -> Scene:
    """The first car is an adversary, the second leaves and comes back, and the ego stands on a hill and turns."""
    scene = town_of_two().scenes[NAME].with_adversary(0, slice(30, 50), np.tile([70.0, 196.0, 0.3], (20, 1)))
    valid = scene.agents.valid.copy()
    valid[1, 20:40] = False
    turned = np.array([np.cos(0.1), 0.0, 0.0, np.sin(0.1)])
    ego = replace(
        scene.ego, position=scene.ego.position + [0, 0, 4.5], rotation=np.tile(turned, (len(scene.timestamps_us), 1))
    )
    return replace(scene, agents=replace(scene.agents, valid=valid), ego=ego)


@pytest.fixture
def town(tmp_path: Path) -> Town:
    scene, data = changed_scene(), Town({})
    pictures: dict[str, list[CameraView]] = {}
    for number, camera in enumerate(scene.cameras[:2]):
        for index, frame in enumerate(scene.keyframes[:4]):
            path = tmp_path / f"{camera.name}-{index}.jpg"
            cv2.imwrite(str(path), np.full((8, 16, 3), 40 * index + number, np.uint8))
            # The first exposure lies before the first frame, as on nuScenes' cars.
            view = CameraView(camera, path, int(scene.timestamps_us[frame]) - 40_000, np.eye(4), lambda: None)  # type: ignore[arg-type,return-value]
            pictures.setdefault(camera.name, []).append(view)
    data.scenes, data.pictures = {NAME: scene}, pictures
    return data


def plans(scene: Scene, planner: str = "mine") -> RunRecord:
    rows = []
    for index, frame in enumerate(scene.keyframes):
        made = row(NAME, index, collides=index == 1, status="failed" if index == FAILS else "ok")
        severity = PlanSeverityRow()
        if index == 1:
            severity = PlanSeverityRow(
                contact=PlanCollision(
                    time_s=0.4, kind="front", at_fault=True, impact_speed_m_s=5.0, delta_v_ego_m_s=2.0,
                    delta_v_other_m_s=2.0, fatal_probability=0.1, agent=scene.agents.ids[0], adversary=True,
                )
            )  # fmt: skip
        rows.append(made.model_copy(update={"timestamp_us": int(scene.timestamps_us[frame]), "severity": severity}))
    return replace(hand_made(planner, {NAME: [CLEAN]}), rows=rows)


def driven(scene: Scene) -> DriveRecord:
    record = load_drives(DRIVES)
    (one,) = record.rows
    late = int(scene.timestamps_us[0]) - one.ticks.time_us[0]
    ticks = one.ticks.model_copy(update={"time_us": [late + time for time in one.ticks.time_us]})
    return replace(record, rows=(one.model_copy(update={"scene": NAME, "ticks": ticks}),))


def decoded(data: bytes) -> dict[str, list[tuple[int, Any]]]:
    """Time in nanoseconds and message, by topic; JSON messages are checked against their own schema."""
    jsonschema = pytest.importorskip("jsonschema")
    found: dict[str, list[tuple[int, Any]]] = {}
    opened = reader.make_reader(io.BytesIO(data), decoder_factories=[protobuf.DecoderFactory()], validate_crcs=True)
    last = 0
    for schema, channel, message in opened.iter_messages():
        assert message.log_time >= last
        last = message.log_time
        if channel.message_encoding == "json":
            value = json.loads(message.data)
            jsonschema.validate(value, json.loads(schema.data))
            found.setdefault(channel.topic, []).append((message.log_time, value))
    protobufs = reader.make_reader(io.BytesIO(data), decoder_factories=[protobuf.DecoderFactory()])
    topics = [channel.topic for channel in opened.get_summary().channels.values() if channel.message_encoding != "json"]
    for schema, channel, message, value in protobufs.iter_decoded_messages(topics=topics):
        assert schema.name.startswith("foxglove.") and schema.encoding == "protobuf"
        found.setdefault(channel.topic, []).append((message.log_time, value))
    return found


def picked(agents: Agents, rows: list[int]) -> Agents:
    categories = tuple(agents.categories[row] for row in rows)
    arrays = {name: getattr(agents, name)[rows] for name in ("position", "yaw", "size", "valid")}
    return Agents(ids=tuple(f"recorded-{row}" for row in rows), categories=categories, **arrays)


def points_of(line: Any) -> Floats:
    return np.array([[point.x, point.y, point.z] for point in line.points])


def as_matrix(transform: Any) -> Floats:
    where, turned = transform.translation, transform.rotation
    return transform_matrix(np.array([turned.w, turned.x, turned.y, turned.z]), np.array([where.x, where.y, where.z]))


@pytest.mark.path
def test_a_viewer_shows_the_boxes_of_each_frame_and_no_others(town: Town) -> None:
    scene = town.scenes[NAME]
    said = decoded(encode_mcap(town, NAME, McapContents(images="none"))[0])
    speeds = compute_speeds(scene.agents.position[..., :2], scene.agents.valid, scene.seconds)
    shown: dict[str, Any] = {}
    assert [time for time, _ in said["/annotations"]] == [1000 * int(time) for time in scene.timestamps_us]
    for frame, (_, update) in enumerate(said["/annotations"]):
        shown.update({entity.id: entity for entity in update.entities})
        for deletion in update.deletions:
            del shown[deletion.id]
        there = np.flatnonzero(scene.agents.valid[:, frame])
        assert set(shown) == {scene.agents.ids[each] for each in there}
        for each in there:
            entity = shown[scene.agents.ids[each]]
            (cube,), facts = entity.cubes, {pair.key: pair.value for pair in entity.metadata}
            where, turned = cube.pose.position, cube.pose.orientation
            assert np.allclose([where.x, where.y, where.z], scene.agents.position[each, frame], atol=1e-6)
            assert np.allclose([cube.size.x, cube.size.y, cube.size.z], scene.agents.size[each], atol=1e-6)
            yaw = yaw_of_quaternion(np.array([turned.w, turned.x, turned.y, turned.z]))
            assert np.isclose(np.cos(yaw - scene.agents.yaw[each, frame]), 1.0, atol=1e-6)
            assert facts["adversary"] == ("true" if scene.agents.ids[each] in scene.adversaries else "false")
            assert float(facts["speed"]) == pytest.approx(speeds[each, frame], abs=0.05001)
            assert entity.frame_id == "map"


def test_frames_lead_from_each_camera_to_the_map_and_images_are_the_files_bytes(town: Town) -> None:
    scene = town.scenes[NAME]
    said = decoded(encode_mcap(town, NAME, McapContents())[0])
    known: dict[tuple[str, str], list[tuple[int, Floats]]] = {}
    for time, message in said["/tf"]:
        for each in message.transforms:
            known.setdefault((each.parent_frame_id, each.child_frame_id), []).append((time, as_matrix(each)))
    first = min(time for messages in said.values() for time, _ in messages)
    for camera in scene.cameras:
        (time, in_ego), *_ = known["base_link", camera.name.lower()]
        assert time == first
        assert np.allclose(in_ego, transform_matrix(camera.rotation, camera.translation), atol=1e-6)
    moved = dict(known["map", "base_link"])
    for frame in (0, 40, len(scene.timestamps_us) - 1):
        expected = transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame])
        assert np.allclose(moved[1000 * int(scene.timestamps_us[frame])], expected, atol=1e-6)
    for name, views in town.pictures.items():
        images = said[f"/{name.lower()}/image_rect_compressed"]
        assert [message.data for _, message in images] == [view.path.read_bytes() for view in views]
        assert {message.format for _, message in images} == {"jpeg"} and images[0][1].frame_id == name.lower()
        _, calibration = said[f"/{name.lower()}/camera_info"][0]
        assert list(calibration.K) == views[0].camera.intrinsic.ravel().tolist() and list(calibration.P)[3] == 0.0
    assert len(said["/map"]) == 1 and len(said["/map"][0][1].entities[0].lines) >= 2


def test_the_adversary_is_marked_and_takes_over(town: Town) -> None:
    scene = town.scenes[NAME]
    said = decoded(encode_mcap(town, NAME, McapContents(images="none"))[0])
    tracks = said["/adversary/track"]
    assert [time for time, _ in tracks] == [1000 * int(scene.timestamps_us[frame]) for frame in (0, 30)]
    (line,) = tracks[0][1].entities[0].lines
    assert np.allclose(points_of(line), scene.agents.position[0], atol=1e-6)
    ((time, event),) = said["/log"]
    assert "adversary: cut-in-left takes over" in event.message and time == tracks[1][0]


@pytest.mark.path
def test_where_the_adversary_went_in_the_recording_is_a_second_line_or_a_note(town: Town) -> None:
    recorded = town_of_two().scenes[NAME]
    # Objects of recordings have identifiers and an order of their own.
    with_it = FakeData({RECORDED: replace(recorded, agents=picked(recorded.agents, [1, 0]))}, Path("recordings"))
    without = FakeData({RECORDED: replace(recorded, agents=picked(recorded.agents, [1]))}, Path("recordings"))
    for recordings, lines, note in (
        (with_it, 2, "the thin line"),
        (without, 1, "none: it is not in the recording"),
        (town, 1, "not shown: the recording is not at hand"),
        (None, 1, "not shown: the recording is not at hand"),
    ):
        contents = McapContents(images="none", recordings=recordings)
        for _, update in decoded(encode_mcap(town, NAME, contents)[0])["/adversary/track"]:
            (entity,) = update.entities
            assert len(entity.lines) == lines
            assert [(pair.key, pair.value) for pair in entity.metadata] == [("recorded track", note)]
            if lines == 2:
                assert np.allclose(points_of(entity.lines[1]), recorded.agents.position[0], atol=1e-6)
                assert entity.lines[1].thickness < entity.lines[0].thickness
                assert not np.allclose(points_of(entity.lines[1])[40], points_of(entity.lines[0])[40], atol=1.0)


def test_images_are_encoded_anew_when_asked(town: Town) -> None:
    drawn = (np.random.default_rng(0).integers(0, 256, (64, 96, 3)) * [1.0, 0.5, 0.0]).astype(np.uint8)
    for camera, views in town.pictures.items():
        town.pictures = {**town.pictures, camera: [replace(each, load=lambda: drawn) for each in views]}
    topic, sizes = f"/{next(iter(town.pictures)).lower()}/image_rect_compressed", []
    for quality in (90, 40):
        data, _ = encode_mcap(town, NAME, McapContents(image_quality=quality))
        _, message = decoded(data)[topic][0]
        again = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        assert again.shape == drawn.shape and message.format == "webp"
        assert np.allclose(again.mean((0, 1))[::-1], drawn.mean((0, 1)), atol=15)
        assert find_images(town, NAME, "keyframes", quality).count_bytes() == 8 * len(message.data)
        (record,) = reader.make_reader(io.BytesIO(data)).iter_metadata()
        assert record.metadata["images"] == f"encoded anew as WebP of quality {quality}"
        sizes.append(len(message.data))
    assert sizes[1] < sizes[0]


@pytest.mark.path
def test_plans_verdicts_and_drives_stand_where_they_were(town: Town) -> None:
    scene = town.scenes[NAME]
    odd = "fähre/../\n1"
    drive = driven(scene)
    contents = McapContents((plans(scene), plans(scene, odd)), (drive,), "none", "adv")
    data, count = encode_mcap(town, NAME, contents)
    said = decoded(data)
    assert sum(map(len, said.values())) == count
    assert len(said["/plan/mine"]) == len(scene.keyframes) - 1 and len(said["/verdict/mine"]) == len(scene.keyframes)
    _, poses = said["/plan/mine"][0]
    places = np.array([[pose.position.x, pose.position.y, pose.position.z] for pose in poses.poses])
    x, y, yaw = scene.ego.pose[0]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    assert len(places) == 7 and np.allclose(places[0, :2], [x, y] + 0.94 * ahead, atol=1e-6)
    assert np.allclose(places[1, :2], [x, y] + 1.94 * ahead, atol=1e-6) and set(places[:, 2]) == {4.5}
    _, hit = said["/verdict/mine"][1]
    assert hit["collision"] == [True] * 3 and hit["gap_m"] == 0.0 and not hit["failed"] and hit["l2"] == [1.0] * 3
    _, failed = said["/verdict/mine"][FAILS]
    assert failed["failed"] and failed["collision"] == [None] * 3
    texts = [text.text for _, update in said["/plan/mine/marks"] for text in update.entities[0].texts]
    assert texts == ["mine: collides in 0.5 s", "mine: failed"]
    assert all(update.entities[0].lifetime.nanos == 500_000_000 for _, update in said["/plan/mine/marks"])
    events = [event.message for _, event in said["/log"] if event.message.startswith("mine")]
    assert events[0].startswith("mine: plan touches the adversary in 0.4 s (front, at fault") and "failed" in events[1]
    assert "/plan/f%C3%A4hre%2F..%2F%0A1" in said and all(topic.isascii() for topic in said)
    ticks = drive.rows[0].ticks
    assert [time for time, _ in said["/drive/straight"]] == [1000 * time for time in ticks.time_us]
    assert said["/drive/straight/state"][0][1]["speed"] == ticks.ego[0][3]
    assert np.isclose(said["/drive/straight"][-1][1].pose.position.x, ticks.ego[-1][0])
    ahead_m = scene.lidar.translation[0]
    driven_plans, (planned,) = said["/drive/straight/plan"], drive.rows
    assert [time for time, _ in driven_plans] == [1000 * time for time in ticks.time_us[: len(planned.plans)]]
    for (_, message), state, plan in zip(driven_plans, ticks.ego, planned.plans, strict=False):
        assert plan.frame == "ego"
        points = to_global(np.array([[0.0, 0.0], *plan.waypoints]) + [ahead_m, 0.0], np.array(state[:3]))
        assert np.allclose([[pose.position.x, pose.position.y] for pose in message.poses], points, atol=1e-6)
    children = {each.child_frame_id for _, message in said["/tf"] for each in message.transforms}
    assert "ego/straight" in children


def test_a_drive_with_broken_or_short_plans_is_refused_or_has_fewer(town: Town) -> None:
    drive = driven(town.scenes[NAME])
    (one,) = drive.rows
    for waypoints, left in (([[1.0, 0.0]] * 5, len(one.plans) - 1), ([], len(one.plans) - 1), ([[1.0]] * 6, None)):
        plans = [one.plans[0].model_copy(update={"waypoints": waypoints}), *one.plans[1:]]
        broken = replace(drive, rows=(one.model_copy(update={"plans": plans}),))
        contents = McapContents(drives=(broken,), images="none")
        if left is None:
            with pytest.raises(InputError, match=r"plan 0 of a drive of scene-9902 by 'straight' is no list"):
                encode_mcap(town, NAME, contents)
        else:
            assert len(decoded(encode_mcap(town, NAME, contents)[0])["/drive/straight/plan"]) == left


def test_schemas_are_those_that_foxglove_ships(town: Town) -> None:
    from foxglove import messages

    drive = driven(town.scenes[NAME])
    contents = McapContents((plans(town.scenes[NAME]),), (drive,))
    summary = reader.make_reader(io.BytesIO(encode_mcap(town, NAME, contents)[0])).get_summary()
    seen = 0
    for schema in summary.schemas.values():
        if schema.encoding != "protobuf":
            assert schema.name.startswith("challenger.")
            continue
        kind = schema.name.removeprefix("foxglove.")
        assert schema.data == getattr(messages, kind).get_schema().data
        _compare_with_shipped(schema.data)
        seen += 1
    assert seen >= 7


def _compare_with_shipped(data: bytes) -> None:
    """Every file of a schema, byte for byte as Foxglove's package of schemas has it, but for names of fields in JSON.

    The compiler writes those into the schemas of one package only: they are the names themselves in camel case.
    """
    pytest.importorskip("foxglove_schemas_protobuf")
    from importlib import import_module

    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    for file in FileDescriptorSet.FromString(data).file:
        module = file.name.removesuffix(".proto").replace("foxglove/", "foxglove_schemas_protobuf/").replace("/", ".")
        shipped = FileDescriptorProto.FromString(import_module(f"{module}_pb2").DESCRIPTOR.serialized_pb)
        for message in (*file.message_type, *shipped.message_type):
            for field in message.field:
                field.ClearField("json_name")
        assert file.SerializeToString() == shipped.SerializeToString()


def test_files_say_what_they_are_are_written_again_and_carry_a_layout(town: Town, tmp_path: Path) -> None:
    contents = McapContents((plans(town.scenes[NAME]),), (), "keyframes", "adv")
    (written,) = export_mcap(town, [NAME], tmp_path / "to", contents)
    assert written.path == tmp_path / "to" / f"{NAME}.mcap" and written.size == written.path.stat().st_size
    with written.path.open("rb") as stream:
        (record,) = list(reader.make_reader(stream).iter_metadata())
    assert record.name == "scene-info" and record.metadata["frozen_split"] == "road-adv-1"
    assert record.metadata["adversaries"] == town.scenes[NAME].adversaries[0] and record.metadata["split"] == "adv"
    assert not any(str(tmp_path) in value for value in record.metadata.values())
    before = written.path.read_bytes()
    export_mcap(town, [NAME], tmp_path / "to", contents)
    assert decoded(written.path.read_bytes()).keys() == decoded(before).keys()
    layout = json.loads((tmp_path / "to" / "layout.json").read_text())
    topics = layout["configById"]["3D!scene"]["topics"]
    assert set(topics) - {"/ego"} <= set(decoded(before)) and "Plot!gap" in json.dumps(layout["layout"])
    assert 0.5 < estimate_bytes(town, NAME, contents) / written.size < 2.0


def test_what_cannot_be_shown_is_one_sentence_and_no_file(town: Town, tmp_path: Path) -> None:
    scene = town.scenes[NAME]
    late = replace(plans(scene), rows=[_later(each) for each in plans(scene).rows])
    with pytest.raises(InputError, match="at another time than the data set"):
        export_mcap(town, [NAME], tmp_path / "to", McapContents((late,)))
    drive = driven(scene)
    with pytest.raises(InputError, match="two records of 'straight'"):
        export_mcap(town, [NAME], tmp_path / "to", McapContents((), (drive, drive)))
    first = next(iter(town.pictures.values()))[0].path
    first.unlink()
    with pytest.raises(InputError, match=r"is missing; complete the data set"):
        export_mcap(town, [NAME], tmp_path / "to")
    for views in town.pictures.values():
        for view in views:
            view.path.unlink(missing_ok=True)
    assert not list((tmp_path / "to").glob("*"))
    export_mcap(town, [NAME], tmp_path / "to")
    with pytest.raises(InputError, match="no scene to export"):
        export_mcap(town, [], tmp_path / "to")


def _later(sample: SampleRow) -> SampleRow:
    return sample.model_copy(update={"timestamp_us": sample.timestamp_us + 1})


def test_the_command_refuses_in_one_sentence(tmp_path: Path) -> None:
    for wrong, says in (
        (("--models", "idm"), "--models needs --split"),
        (("--split", "val", "--models", "imd"), "there is no record of 'imd'"),
        (("--drives", tmp_path / "no"), "does not exist"),
    ):
        done = run_here("data", "export", "mcap", "mini", "--to", tmp_path / "to", "--out", tmp_path / "out", *wrong)
        assert done.code == 2 and says in done.err and not (tmp_path / "to").exists()
