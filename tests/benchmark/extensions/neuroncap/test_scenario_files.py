"""Scenario files of NeuroNCAP are read as they are, driven, kept in records, and refused in a sentence; and targets."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmark.closed_loop.engines import make_backend, restore_backend
from benchmark.closed_loop.episodes import run_episode
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.scenarios import OFFICIAL_FILE, Scenario, ScenarioFile, read_official_scenarios
from benchmark.records.drives import load_drives
from benchmark.runs.driving import DriveSettings
from benchmark.runs.rescoring_drives import rescore_drives
from tests.benchmark.cli import test_drive_trouble as any_command
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Straight
from tests.benchmark.runs.test_driving import driven
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road

LONG = scene_on_straight_road(seconds=13.0)
CARS = LONG.agents.ids
GENERAL = """
general:
  start-pose: "original"
  start-velo: "original"
  start-frame: 3
  time-step: 0.5
  priming-steps: 2
  duration: 8.0
  smooth-actors: true
  start-jitter: 1
"""
FILES = {
    "stationary": f"""# a car that stands in the way
{GENERAL}
actors:
  - uuids:
      - {CARS[0]}  # white
      - {CARS[1]}  # black
    flip-uuids:
      - {CARS[1]}
    mode: "override"
    times: [0.0, 20.0]
    is_target_actor: true
    initial-yaw: -0.1
    positions:
      - [100., 198.25, 0.85]
      - [100., 198.25, 0.85]
    jitter:
      longitudinal: 3.0
      lateral: 0.5
      long-lat-angle: 0.0
      yaw-jitter: 0.2
""",
    "frontal": f"""{GENERAL}
actors:
  - mode: "override"
    uuids:
      - {CARS[2]}
    times: [-1.0, 6.0, 15.0]
    is_target_actor: true
    positions:
      - [180.0, 198.25, 0.0]
      - [110.0, 198.25, 0.0]
      - [20.0, 198.25, 0.0]
    jitter:
      times: [0.0, 2.0, 0.0]
      longitudinal: 2.0
      lateral: 0.25
      long-lat-angle: 3.14
""",
    "side": f"""{GENERAL.replace("  start-jitter: 1", "  start-jitter: 0")}
actors:
  - mode: "override"
    exclusive_group: "1"
    uuid: {CARS[0]}
    times: [-5.0, 8.0, 19.0]
    is_target_actor: true
    positions:
      - [100.0, 267.5, 0.0]
      - [100.0, 187.5, 0.0]
      - [100.0, 120.0, 0.0]
""",
}


def written(folder: Path, family: str, text: str = "") -> Path:
    path = folder / family / "0099.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text or FILES[family])
    return path


def settings(path: Path, **changes: Any) -> DriveSettings:
    made = DriveSettings("neuroncap@code", make_backend("neuroncap@code", scenarios=str(path)), scenarios="file")
    return replace(made, **changes)


@pytest.mark.path
@pytest.mark.parametrize("family", FILES)
def test_a_file_of_each_type_is_driven_and_its_record_is_whole(family: str, tmp_path: Path) -> None:
    file, data = written(tmp_path, family), FakeData({LONG.name: LONG})
    record = driven(tmp_path / "out", Straight(), settings(file, runs=3), data)
    # What draws nothing is driven once.
    assert [(row.family, row.run) for row in record.rows] == [
        (family, run) for run in range(1 if family == "side" else 3)
    ]
    assert all(row.contact is not None and row.contact.agent in CARS for row in record.rows)
    measured = record.facts.measured
    name = f"{family}/0099.yaml"
    assert measured.scenarios == "file" and measured.scenario_facts["file"] == name
    assert re.fullmatch(rf"neuroncap@code, scenario {name} \([0-9a-f]{{8}}\)", measured.world)
    assert record.summary.published is not None and family in record.summary.published.nns_by_family
    # Without the file: from what the record keeps.
    file.unlink()
    before = bytes_below(tmp_path / "out")
    assert load_drives(record.directory) == record == rescore_drives(record.directory, data)
    assert bytes_below(tmp_path / "out") == before
    assert restore_backend(measured).scenario_facts == measured.scenario_facts  # type: ignore[attr-defined]


def test_official_scenarios_in_their_notation_are_the_packaged_ones(tmp_path: Path) -> None:
    def in_notation(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                name if name == "is_target_actor" else name.replace("_", "-"): in_notation(v)
                for name, v in value.items()
            }
        return [in_notation(each) for each in value] if isinstance(value, list) else value

    for ours, facts in zip(read_official_scenarios(), json.loads(OFFICIAL_FILE.read_text())["scenarios"], strict=True):
        path = tmp_path / ours.family / f"{ours.sequence}.yaml"
        path.parent.mkdir(exist_ok=True)
        content = in_notation({name: facts[name] for name in ("general", "actors")})
        content["general"] |= {"start-pose": "original", "start-velo": "original", "smooth-actors": True}
        path.write_text(yaml.safe_dump(content))
        read = ScenarioFile.read(path)
        # Arrays have no single truth value; all that is in them is printed.
        assert repr(read.scenario) == repr(ours.scenario) and read.family == ours.family
        assert repr(ScenarioFile.of(read.name, json.loads(json.dumps(read.content))).scenario) == repr(ours.scenario)


def damaged(old: str, new: str, family: str = "stationary") -> str:
    assert FILES[family].count(old) >= 1
    return FILES[family].replace(old, new)


DAMAGED: list[tuple[str, str, str]] = [
    ("empty", " ", "is not a table of names and values"),
    ("a list", "- 1\n- 2\n", "is not a table of names and values"),
    ("no YAML", "general: [1\n", "is not valid YAML"),
    (
        "no general",
        FILES["side"].replace(GENERAL.replace("  start-jitter: 1", "  start-jitter: 0"), ""),
        "general is not a table",
    ),
    ("no actors", GENERAL, "lists no actors"),
    ("actors that are a table", f"{GENERAL}\nactors:\n  a: 1\n", "actors is not a list"),
    ("an actor that is text", f"{GENERAL}\nactors: [car]\n", "actor 0 is not a table"),
    ("many actors", f"{GENERAL}\nactors: [{'{}, ' * 300}]\n", "not a list of at most 200"),
    ("no uuid", FILES["side"].replace(f"    uuid: {CARS[0]}\n", ""), "names no actor"),
    ("uuid of digits", damaged(f"uuid: {CARS[0]}", "uuid: 123", "side"), "uuid is not a list of names"),
    ("no times", damaged("    times: [0.0, 20.0]\n", ""), "times is missing"),
    ("NaN", damaged("[100., 198.25, 0.85]", "[.nan, 198.25, 0.85]"), "positions is missing, or not"),
    ("infinity", damaged("duration: 8.0", "duration: .inf"), "duration is not a finite number"),
    ("text in positions", damaged("[100., 198.25, 0.85]", "['100', 198.25, 0.85]"), "positions is missing, or not"),
    ("a date", damaged("initial-yaw: -0.1", "initial-yaw: 2001-01-01"), "initial_yaw is not a finite number"),
    ("a truth", damaged("duration: 8.0", "duration: true"), "duration is not a finite number"),
    ("a number as a truth", damaged("is_target_actor: true", "is_target_actor: 1"), "neither true nor false"),
    ("off the world", damaged("[100., 198.25, 0.85]", "[1.0e+300, 198.25, 0.85]"), "positions is missing, or not"),
    ("endless", damaged("duration: 8.0", "duration: 1.0e+9"), "duration is not a number from 0.5 to 600"),
    ("no time at all", damaged("duration: 8.0", "duration: 0"), "duration is not a number from 0.5 to 600"),
    ("beyond all frames", damaged("start-frame: 3", f"start-frame: {10**150}"), "start_frame is not a number from"),
    ("less than nothing", damaged("longitudinal: 3.0", "longitudinal: -3.0"), "longitudinal is not a number from 0"),
    ("a size of nothing", damaged("initial-yaw: -0.1", "dims: [0.0, 4.0, 1.0]"), "dims is not width, length"),
    ("other steps", damaged("time-step: 0.5", "time-step: 0.1"), "sets steps of 0.1 s"),
    ("other poses", damaged("time-step: 0.5", "actor-framerate: 4"), "actor_framerate of 4.0"),
    ("a slip", damaged("is_target_actor", "is_target_actr"), "did you mean is_target_actor?"),
    ("a slip of jitter", damaged("yaw-jitter", "yaw"), "names 'yaw', which NeuroNCAP does not read"),
    ("another mode", damaged('"override"', "overide"), "did you mean override"),
    ("two targets", FILES["stationary"] + FILES["side"].split("actors:\n")[1], "more than one target"),
    ("an alias", damaged("start-frame: 3", "start-frame: &a 3\n  dim-jitter: *a"), "it has an alias"),
    ("an alias bomb", "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "it has an alias"),
    ("Python", damaged("8.0", "!!python/object/apply:os.system [ls]"), "it has the tag"),
    ("another tag", damaged("8.0", "!!set {a}"), "it has the tag"),
    ("deep", "[" * 200, "more than 64 deep"),
    ("a long number", f"general: {{duration: {'9' * 5000}}}", "a number of 5000 characters"),
    ("huge", "# " + "x" * (1 << 20), "at most"),
    ("two documents", f"{FILES['side']}\n---\na: 1\n", "is not valid YAML"),
    ("zeros", "\0" * 100, "is not valid YAML"),
]


@pytest.mark.parametrize(("_", "text", "says"), DAMAGED, ids=[name for name, _, _ in DAMAGED])
def test_a_damaged_file_is_one_sentence(_: str, text: str, says: str, tmp_path: Path) -> None:
    path = written(tmp_path, "stationary", text)
    with pytest.raises(InputError) as refused:
        make_backend("neuroncap@code", scenarios=str(path))
    said = str(refused.value)
    assert str(path) in said and says in said and "\n" not in said and len(said) < 400


def test_a_scene_without_the_actors_has_no_such_scenario(tmp_path: Path) -> None:
    other = scene_on_straight_road(seconds=13.0, name="scene-9905")
    path = written(tmp_path, "side")
    record = driven(tmp_path, Straight(), settings(path), FakeData({LONG.name: LONG, other.name: other}))
    assert [row.scene for row in record.rows] == [LONG.name]
    with pytest.raises(InputError, match=r"scene-9905 has all road users that side/0099\.yaml names"):
        driven(tmp_path / "none", Straight(), settings(path), FakeData({other.name: other}))


def test_a_file_anywhere_else_has_no_family_and_other_content_is_another_record(tmp_path: Path) -> None:
    data, records = FakeData({LONG.name: LONG}), []
    for y in ("187.5", "188.5"):
        path = tmp_path / "mine.yml"
        path.write_text(damaged("[100.0, 187.5, 0.0]", f"[100.0, {y}, 0.0]", "side"))
        records.append(driven(tmp_path / "out", Straight(), settings(path), data))
    assert (
        len({record.directory for record in records}) == len({record.facts.measured.world for record in records}) == 2
    )
    assert all(row.family == "" for record in records for row in record.rows)
    assert all(record.summary.published is None for record in records)


def test_the_command_reads_a_file_and_repeats_it_from_its_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write_root(tmp_path / "road", [LONG], version="v1.0-mini", renderer=None).root
    tokens = [row["token"] for row in json.loads((root / "v1.0-mini" / "instance.json").read_text())]
    assert CARS[0] in tokens
    written(tmp_path, "frontal")
    monkeypatch.chdir(tmp_path)
    asked = ("--engine", "neuroncap@code", "--model", "stop", "--no-baselines", "--runs", "2")
    done = any_command.driving(root, tmp_path / "out", *asked, "--scenarios", "frontal/0099.yaml")
    assert done.code == 0 and "scenario frontal/0099.yaml (" in " ".join(done.out.split()), done.err
    (record,) = (tmp_path / "out").rglob("drive.json")
    before = bytes_below(tmp_path / "out")
    again = run_here("drive", "--config", record, "--data", root, "--out", tmp_path / "out", "--workers", "1")
    assert again.code == 0 and bytes_below(tmp_path / "out") == before, again.err
    (tmp_path / "frontal" / "0099.yaml").unlink()
    gone = run_here("drive", "--config", record, "--data", root, "--out", tmp_path / "out")
    assert gone.code == 2 and "cannot read frontal/0099.yaml" in gone.err


def test_the_command_drives_without_a_target_and_again_from_its_record(tmp_path: Path) -> None:
    source, out = any_command.road(tmp_path / "road"), tmp_path / "out"
    asked = ("--engine", "neuroncap@code", "--model", "stop", "--no-baselines", "--target", "none")
    done = any_command.driving(source, out, *asked)
    assert done.code == 0 and "neuroncap@code, target none" in done.out, done.err
    (record,) = out.rglob("drive.json")
    assert json.loads(record.read_text())["measured"]["scenario_facts"] == {"target": "none"}
    before = bytes_below(out)
    again = run_here("drive", "--config", record, "--data", source, "--out", out, "--workers", "1")
    assert again.code == 0 and bytes_below(out) == before, again.err


def test_refusals_of_the_command() -> None:
    for words, says in (
        ("--scenarios x.yaml", "needs NeuroNCAP's engine"),
        ("--target none", "--target none needs NeuroNCAP's engine"),
        ("--engine neuroncap@code --scenarios nowhere.yaml", "cannot read nowhere.yaml"),
        ("--engine neuroncap@code --scenarios offical", "did you mean official?"),
        ("--engine neuroncap@code --scenarios file", "unknown scenarios 'file'"),
        ("--engine neuroncap@paper --scenarios own --target none", "for recorded scenes"),
    ):
        done = run_here("drive", *words.split())
        assert done.code == 2 and says in done.err and len(done.err.splitlines()) == 1


def test_without_a_target_the_reference_speed_is_neuroncaps_own(tmp_path: Path) -> None:
    fleeing = scene_on_straight_road((Car(60.0, 198.25, 7.5), Car(80.0, 198.25, 0.0)), ego_speed=8.0, seconds=10.0)
    fleeing = replace(fleeing, adversaries=(fleeing.agents.ids[0],))
    found = {}
    for target in ("adversary", "none"):
        facts = {} if target == "adversary" else {"target": target}
        maker = make_backend("neuroncap@code", scenario_facts=facts)
        found[target] = run_episode(staged(fleeing, maker), Watching(speed=8.0))
        measured = DriveSettings("neuroncap@code", maker).measured
        # What is usual is not written, so that the keys of earlier drives stay.
        assert measured.model_dump(mode="json").get("scenario_facts", {}) == facts
        assert measured.world == "neuroncap@code" + ("" if target == "adversary" else ", target none")
        assert restore_backend(measured) == maker
    scores = {target: episode.neuroncap for target, episode in found.items()}
    assert scores["adversary"] is not None and scores["none"] is not None
    assert scores["adversary"].reference_speed == pytest.approx(0.5, abs=0.01)
    assert scores["none"].reference_speed == pytest.approx(8.0, abs=0.01)
    # It drives the same, and is only scored differently.
    assert scores["adversary"].impact_speed == scores["none"].impact_speed > 0.0
    assert np.array_equal(found["adversary"].motion.ego, found["none"].motion.ego)
    with pytest.raises(InputError, match="unknown target 'nobody'"):
        make_backend("neuroncap@code", scenario_facts={"target": "nobody"})
    assert Scenario() == Scenario.of({"general": {}}, "nothing")
