"""Scenarios and recordings are all there, driven and refused in a sentence; golden numbers are met, changes found."""

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.loop import Engine, NeuroncapWorld, begin, finish_run, is_running, step
from benchmark.extensions.neuroncap.recording import NeuroncapRecording, build_own_scenarios, read_recording
from benchmark.extensions.neuroncap.scenarios import Scenario, read_official_scenarios
from benchmark.extensions.neuroncap.staging import RenderableActors, stage_run
from benchmark.extensions.neuroncap.verification import BUILT_IN, GOLDEN
from benchmark.geometry import Floats, to_local
from benchmark.records.neuroncap_aggregate import CODE, PAPER, NeuroncapSwitches
from benchmark.scene import Scene
from tests.benchmark.extensions.golden_sets.altered import Change, altered, filled, load, put, shifted
from tests.benchmark.extensions.neuroncap.golden_neuroncap import (
    SCENARIO,
    SHARED,
    cast_of,
    made_inputs,
    made_loops,
    recording_of,
)
from tests.benchmark.extensions.neuroncap.made import KNOWN, straight
from tests.benchmark.verification.damaged import notices, said
from tests.hand_made import Car, scene_on_straight_road

EVALUATED = {
    "stationary": "0099 0101 0103 0106 0108 0278 0331 0783 0796 0966",
    "frontal": "0103 0106 0110 0346 0923",
    "side": "0103 0108 0110 0278 0921",
}


def test_the_official_scenarios_are_all_there() -> None:
    known = read_official_scenarios()
    for family, sequences in EVALUATED.items():
        assert [each.sequence for each in known if each.family == family and each.evaluated] == sequences.split()
    assert Counter(each.evaluated for each in known) == {True: 20, False: 1}
    assert all(sum(actor.is_target for actor in each.scenario.actors) == each.evaluated for each in known)
    assert all(each.scenario.draws for each in known)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not here")
def test_the_packaged_numbers_are_those_of_the_golden_set() -> None:
    golden = json.loads((SHARED / "scenarios.json").read_text())["official"]
    for ours, theirs in zip(read_official_scenarios(), golden, strict=True):
        assert (ours.family, ours.sequence) == (theirs["type"], theirs["sequence"])
        facts = json.loads(json.dumps(theirs["scenario"]).replace("times_without_effect", "times"))
        expected = Scenario.of(facts, "golden")
        for actor, other in zip(ours.scenario.actors, expected.actors, strict=True):
            assert (actor.uuids, actor.flipped, actor.jitter) == (other.uuids, other.flipped, other.jitter)
            assert actor.initial_yaw == other.initial_yaw and actor.is_target == other.is_target
            assert np.array_equal(actor.times, other.times) and np.array_equal(actor.positions, other.positions)  # type: ignore[arg-type]
        assert (ours.scenario.start_frame, ours.scenario.duration_s) == (expected.start_frame, expected.duration_s)


def changed(actor: dict[str, Any] | None = None, **general: Any) -> dict[str, Any]:
    target = {**SCENARIO["actors"][0], **(actor or {})}
    return {"general": {**SCENARIO["general"], **general}, "actors": [target]}


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({"actors": []}, "general"),
        (changed(time_step=0.1), "steps of 0.1 s"),
        (changed(duration="long"), "duration is not a finite number"),
        (changed(start_jitter=-1), "not a whole number of at least 0"),
        (changed({"mode": "overide"}), "did you mean override"),
        (changed({"uuids": []}), "names no actor"),
        (changed({"positions": [[0.0, 0.0, 0.0]]}), "positions is missing"),
        (changed({"times": [5.0, 1.0]}), "must be two or more in ascending order"),
        (changed({"dims": [1.0, None, 1.0]}), "dims"),
        (changed({"jitter": 3}), "not a table"),
        ({"general": {}, "actors": [SCENARIO["actors"][0]] * 2}, "more than one target"),
    ],
)
def test_a_wrong_scenario_is_refused(facts: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Scenario.of(facts, "scenario.json")


def test_actors_that_nobody_knows_and_short_recordings_are_refused() -> None:
    recording = recording_of(made_inputs())
    with pytest.raises(InputError, match="needs more than the 30 frames"):
        stage_run(Scenario.of(changed(start_frame=29), "made"), 0, recording.times, cast_of(recording), CODE)
    for actor, says in (
        ({"uuids": ["nobody"]}, "not an instance"),
        ({"mode": "optimized", "uuids": ["made-3"]}, "track"),
    ):
        cast = cast_of(recording)
        tracks = {uuid: track for uuid, track in cast.tracks.items() if uuid != "made-3"}
        with pytest.raises(InputError, match=says):
            scenario = Scenario.of(changed(actor), "made")
            stage_run(scenario, 0, recording.times, type(cast)(cast.kinds, cast.sizes, tracks), CODE)


def test_a_run_is_its_index_and_nothing_else_and_what_draws_nothing_says_so() -> None:
    recording, scenario = recording_of(made_inputs()), Scenario.of(SCENARIO, "made")
    runs = [stage_run(scenario, run, recording.times, cast_of(recording), CODE) for run in (4, 5, 4)]
    assert runs[0].draws == runs[2].draws != runs[1].draws
    assert all(np.array_equal(a.poses, b.poses) for a, b in zip(runs[0].actors, runs[2].actors))
    fixed = {**SCENARIO["actors"][1], "is_target_actor": True}
    still = Scenario.of({"general": {"start_frame": 3, "duration": 7.0}, "actors": [fixed]}, "made")
    assert not still.draws and not Scenario().draws and Scenario.of(SCENARIO, "made").draws


@pytest.fixture(scope="module")
def recording() -> NeuroncapRecording:
    return recording_of(made_inputs())


def recorded_plan(recording: NeuroncapRecording, world: NeuroncapWorld) -> Floats:
    path, seconds = recording.path, (recording.times - recording.times[0]) / 1e6
    asked = (world.state.time_us - int(recording.times[0])) / 1e6 + 0.5 * np.arange(1, 7)
    places = np.column_stack([np.interp(asked, seconds, path[:, axis]) for axis in range(2)])
    pose = world.state.pose
    return to_local(places, np.array([pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])]))


def driven(recording: NeuroncapRecording, scenario: Scenario, run: int, *, stops: bool) -> NeuroncapWorld:
    stage = stage_run(scenario, run, recording.times, RenderableActors.of(recording.actors), PAPER)
    made = Engine.of(recording, stage, priming_steps=scenario.priming_steps, renderer_knows=KNOWN, switches=PAPER)
    world = begin(made)
    while is_running(made, world):
        world = step(made, world, np.zeros((6, 2)) if stops else recorded_plan(recording, world))
    return finish_run(made, world)


@pytest.mark.parametrize("family", ["stationary", "frontal", "side"])
def test_the_recorded_drive_meets_the_target(recording: NeuroncapRecording, family: str) -> None:
    scenario = build_own_scenarios(recording)[family]
    assert scenario.draws and [actor.is_target for actor in scenario.actors] == [True]
    worlds = [driven(recording, scenario, run, stops=False) for run in range(6)]
    hits = [world.contact for world in worlds if world.contact is not None]
    assert len(hits) >= 5 and all(hit.is_target for hit in hits)
    expected = int(recording.times[16])
    assert all(abs(hit.time_us - expected) < 1_800_000 for hit in hits)
    assert len({hit.time_us for hit in hits}) > 1


def test_who_stops_does_not_hit_what_stands(recording: NeuroncapRecording) -> None:
    scenario = build_own_scenarios(recording)["stationary"]
    assert all(driven(recording, scenario, run, stops=True).contact is None for run in range(6))


def test_a_recording_that_meets_nobody_has_none(recording: NeuroncapRecording) -> None:
    assert build_own_scenarios(straight(np.full(30, 0.5), recording.actors)) == {}
    assert build_own_scenarios(straight(np.full(12, 8.0), recording.actors)) == {}
    assert build_own_scenarios(replace(recording, actors=())) == {}


@pytest.fixture
def scene() -> Scene:
    digger = Car(200.0, 205.25, 0.0, 0.3, "vehicle.construction", (6.0, 2.5, 3.0))
    walker = Car(90.0, 190.0, 0.0, 0.0, "human.pedestrian.adult", (0.7, 0.6, 1.8))
    made = scene_on_straight_road((Car(110.0, 198.25), digger, walker), seconds=12.0)
    valid = made.annotations.valid.copy()
    valid[0, :2] = False
    return replace(made, annotations=replace(made.annotations, valid=valid))


@pytest.fixture
def root(tmp_path: Path, scene: Scene) -> Path:
    start = int(scene.timestamps_us[0])
    rows = [
        {
            "utime": start - 7_000 + 20_000 * number,
            "pos": [50.0 + 0.16 * number, 198.25, 0.0],
            "orientation": [1.0, 0.0, 0.0, 0.0],
            "accel": [0.1, 0.2, 9.8],
            "rotation_rate": [0.0, 0.0, 0.01],
            "vel": [8.0 + 0.001 * number, 0.0, 0.0],
        }
        for number in range(600)
    ]
    wheel = [{"utime": start + 40_000 * number, "steer_corrected": 3.0 + number} for number in range(250)]
    folder = tmp_path / "can_bus"
    folder.mkdir()
    (folder / f"{scene.name}_pose.json").write_text(json.dumps(rows))
    (folder / f"{scene.name}_zoe_veh_info.json").write_text(json.dumps(wheel))
    return tmp_path


def test_frames_have_the_first_message_at_or_after_them(scene: Scene, root: Path) -> None:
    recording = read_recording(scene, root, CODE)
    assert np.array_equal(recording.times, scene.timestamps_us[scene.keyframes])
    # The second message is 13 ms after the first frame; the 26th is 7 ms before the second one.
    assert recording.canbus[:2, 13] == pytest.approx([8.001, 8.026])
    assert recording.canbus[0, 7:10] == pytest.approx([0.1, 0.2, 9.8]) and recording.canbus.dtype == np.float32
    assert recording.steering_wheel[:2] == pytest.approx(np.radians([3.0, 16.0]))
    assert recording.path[:, 0] == pytest.approx(50.0 + 4.0 * np.arange(24)) and len(recording.times) == 24


def test_actors_are_those_of_the_engine_s_classes(scene: Scene, root: Path) -> None:
    for switches, kinds in ((CODE, ["pedestrian", "car"]), (PAPER, ["construction", "pedestrian", "car"])):
        actors = read_recording(scene, root, switches).actors
        # Who appears later stands later in the list.
        assert [actor.kind for actor in actors] == kinds
        car = actors[-1]
        assert car.size == pytest.approx([1.9, 4.6, 1.7]) and len(car.times) == 22
        assert car.poses[0, :3, 3] == pytest.approx([110.0, 198.25, 0.85])


def test_a_scene_without_can_bus_is_refused(scene: Scene, root: Path) -> None:
    for message in ("zoe_veh_info", "pose"):
        path = root / "can_bus" / f"{scene.name}_{message}.json"
        for spoil in (lambda path: path.write_text("[]"), Path.unlink):
            spoil(path)
            with pytest.raises(InputError, match=f"{message}.json holds nothing; get the CAN bus"):
                read_recording(scene, root, NeuroncapSwitches())


MADE = "loops/made.json"


def failed(folder: Path | None) -> set[str]:
    return {check.quantity for check in GOLDEN.verify(folder) if not check.ok}


@pytest.mark.path
def test_the_built_in_set_agrees() -> None:
    assert failed(None) == set()


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not here")
def test_every_golden_number_is_met() -> None:
    checks = GOLDEN.verify(SHARED)
    assert [check.quantity for check in checks if not check.ok] == []
    assert sum(check.count for check in checks) > 200_000


def test_what_is_made_up_in_the_set_is_what_the_program_makes_up() -> None:
    arrays, facts = made_loops()
    for name, expected in arrays.items():
        assert set(load(BUILT_IN / f"{name}.npz")) == set(expected), name
    stored, made = json.loads((BUILT_IN / MADE).read_text())["runs"], facts["loops/made"]["runs"]
    assert [run["n_infer_calls"] for run in stored] == [run["n_infer_calls"] for run in made]
    assert {run["collision"] is None for run in stored} == {True, False}


CHANGES: dict[str, list[tuple[str, Change, str]]] = {
    "numbers": [
        ("vehicle.npz", shifted("code_substep_state", 1e-5), "car as code: states of sub-steps"),
        ("vehicle.npz", shifted("float64_substep_command", 1e-8), "car in double precision: commands"),
        ("vehicle.npz", shifted("code_step_time"), "car as code: times"),
        ("contact.npz", shifted("hit"), "contact: who is touched"),
        ("contact.npz", shifted("hit_alt"), "contact with the other box: who is touched"),
        ("command.npz", shifted("command", -1), "command"),
        ("loops/made.npz", shifted("r001_state_time"), "loops: times"),
        ("loops/made.npz", shifted("r001_check"), "loops: instants and verdicts of checks"),
        ("loops/made.npz", shifted("r002_command", -1), "loops: commands"),
        ("loops/made_inputs.npz", shifted("canbus_at_frame", 1e-3), "loops: CAN rows at frames"),
    ],
    "facts": [
        ("scenarios.json", lambda f: f["synthetic"]["scenarios"][0]["runs"][0]["draws"].pop(), "scenarios: draws"),
        (
            "scenarios.json",
            lambda f: f["official"][0]["runs"][1]["actors"][0].update(uuid="other"),
            "scenarios: who is there, in order",
        ),
        ("aggregate.json", lambda f: f["cases"][0]["overall"].update(ncap_score=1.0), "aggregate: overall"),
        ("aggregate.json", lambda f: f["cases"][2].update(check_validity="passes"), "aggregate: is it complete"),
        (MADE, lambda f: f["runs"][1].update(nns_code=1.0), "loops: score, code"),
        (MADE, lambda f: f["runs"][1].update(collision=None), "loops: contact"),
        (MADE, lambda f: f["runs"][1]["metrics"].pop("any_collide@1.0s"), "loops: rates in the file"),
    ],
    "no number": [(MADE, lambda f: f["runs"][3].update(nns_code="nan"), "loops: score, code")],
}


@pytest.mark.parametrize("changes", CHANGES.values(), ids=CHANGES)
def test_each_change_is_found(changes: list[tuple[str, Change, str]], tmp_path: Path) -> None:
    folder = altered(BUILT_IN, tmp_path / "set", [(file, change) for file, change, _ in changes])
    assert {found for _, _, found in changes} <= failed(folder)


@pytest.mark.parametrize("file", [*GOLDEN.files, MADE, "loops/made.npz", "loops/made_inputs.npz"])
def test_a_missing_or_cut_file_is_one_sentence(file: str, tmp_path: Path) -> None:
    path = Path(shutil.copytree(BUILT_IN, tmp_path / "neuroncap")) / file
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert path.name in said(GOLDEN.verify, tmp_path / "neuroncap")
    path.unlink()
    assert path.name in said(GOLDEN.verify, tmp_path / "neuroncap")


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("vehicle.npz", put(plan=None)),
        ("vehicle.npz", filled("plan_waypoints", 9)),
        ("vehicle.npz", filled("step_case", 99)),
        ("vehicle.npz", filled("plan", np.nan)),
        ("vehicle.npz", filled("code_step_pose", np.nan)),
        ("contact.npz", filled("actor_case", 9999)),
        ("command.npz", lambda arrays: arrays.update(path=arrays["path"] + 99)),
        ("loops/made.npz", put(r001_plan=None)),
        ("loops/made.npz", lambda arrays: arrays.update(r001_substep_state=arrays["r001_substep_state"][1:])),
        ("loops/made_inputs.npz", filled("timestamps", 0)),
        ("loops/made_inputs.npz", filled("ann_instance", 99)),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(file: str, change: Change, tmp_path: Path) -> None:
    notices(GOLDEN.verify, altered(BUILT_IN, tmp_path / "set", [(file, change)]))


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("scenarios.json", put(synthetic=None)),
        ("scenarios.json", lambda facts: facts["official"][0]["scenario"].pop("general")),
        ("scenarios.json", lambda facts: facts["official"][0]["runs"][0].pop("draws")),
        ("aggregate.json", lambda facts: facts["cases"][0]["runs"].update(side=3)),
        ("loops/index.json", lambda facts: facts[0].update(file="../made.json")),
        (MADE, lambda facts: facts["runs"][0].pop("n_infer_calls")),
        (MADE, put(scenario=3)),
    ],
)
def test_facts_that_cannot_be_used_are_refused(file: str, change: Change, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        GOLDEN.verify(altered(BUILT_IN, tmp_path / "set", [(file, change)]))
    assert "\n" not in str(error.value)
