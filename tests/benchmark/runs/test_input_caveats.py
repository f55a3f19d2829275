"""What planners and engines want of a data set and do not get is said of those that want it, in runs and in drives."""

import json
import shutil
from pathlib import Path

import pytest

from adapters.models import MODELS
from adapters.registry import planner_factory
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.datasets.roots import open_data
from benchmark.evaluation import EvalSettings, evaluate, evaluate_together
from benchmark.records.caveats import Caveat
from benchmark.records.rows import SampleRows
from benchmark.runs.caveats import list_planner_caveats
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.runs.rescoring_drives import rescore_drives
from tests.benchmark.edited_roots import copy_of, edit, small_town, table_of

STRAIGHT_ON, NO_SCORES = "drives straight instead of following a lane", "driving scores (pdm)"


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town") / "root", scenes=2)


@pytest.fixture
def root(town: Path, tmp_path: Path) -> Path:
    return copy_of(town, tmp_path / "data" / "root")


def caveats_of(root: Path, out: Path, *names: str, limit: int | None = None) -> dict[str, dict[str, str]]:
    """Sentences by kind, by planner."""
    planners = [(planner_factory(name), EvalSettings(("exact",), limit=limit)) for name in names]
    records = evaluate_together(open_data(root), "val", planners, out)
    return {record.planner: {each.kind: each.sentence for each in record.run.caveats} for record in records}


def test_without_a_map_idm_goes_straight_on_and_nobody_has_driving_scores(root: Path, tmp_path: Path) -> None:
    shutil.rmtree(root / "maps" / "expansion")
    found = caveats_of(root, tmp_path / "runs", "idm", "log-replay", limit=1)
    assert found["idm"].keys() == found["log-replay"].keys() == {"map"}
    assert STRAIGHT_ON in found["idm"]["map"] and NO_SCORES in found["idm"]["map"]
    assert STRAIGHT_ON not in found["log-replay"]["map"] and NO_SCORES in found["log-replay"]["map"]


def test_a_map_without_lanes_is_none(root: Path, tmp_path: Path) -> None:
    for path in (root / "maps" / "expansion").glob("*.json"):
        layers = json.loads(path.read_text())
        path.write_text(json.dumps({**layers, "arcline_path_3": {}}))
    assert STRAIGHT_ON in caveats_of(root, tmp_path / "runs", "idm", limit=1)["idm"]["map"]


def test_without_can_bus_it_is_said_of_planners_that_use_motion(root: Path, tmp_path: Path) -> None:
    shutil.rmtree(root / "can_bus")
    using = {name for name, model in MODELS.items() if "motion" in model.wants}
    names = ("idm", "ego-status", "constant-velocity", "constant-velocity-on-path", "stop", "log-replay")
    found = caveats_of(root, tmp_path / "runs", *names)
    assert {name for name, said in found.items() if said} == using & set(names) == set(names) - {"stop", "log-replay"}
    assert found["idm"] == {
        "motion": "2 of 2 scenes have no CAN bus: the ego motion that it plans from is derived from poses"
    }


def test_a_scene_without_can_bus_is_named(root: Path, tmp_path: Path) -> None:
    name = open_data(root).scene_names("val")[1]
    for path in (root / "can_bus").glob(f"{name}_*"):
        path.unlink()
    assert caveats_of(root, tmp_path / "runs", "idm")["idm"]["motion"].startswith(f"{name} has no CAN bus")


def test_without_a_lidar_its_place_is_assumed(tmp_path: Path) -> None:
    root = copy_of(small_town(tmp_path / "town", images=True), tmp_path / "data" / "root")
    sensors = {row["token"]: row["channel"] for row in json.loads(table_of(root, "sensor").read_text())}
    mounts = {
        row["token"]
        for row in json.loads(table_of(root, "calibrated_sensor").read_text())
        if sensors[row["sensor_token"]] == "LIDAR_TOP"
    }
    edit(root, "sample_data", lambda rows: [row for row in rows if row["calibrated_sensor_token"] not in mounts])
    assert "has no LIDAR_TOP: the lidar" in caveats_of(root, tmp_path / "runs", "stop")["stop"]["lidar"]


def test_planners_that_want_images_say_where_there_is_no_camera(town: Path, tmp_path: Path) -> None:
    record = evaluate(open_data(town), "val", planner_factory("stop"), tmp_path / "runs", EvalSettings(("exact",)))
    seeing = record.run.planner.model_copy(update={"wants": ["images"]})
    found = list(list_planner_caveats(seeing, record.run.scene_facts, SampleRows.of(record.rows)))
    assert [(each.kind, "2 of 2 scenes have no camera" in each.sentence) for each in found] == [("images", True)]


def test_forecasts_are_missed_where_the_planner_has_some(town: Path, tmp_path: Path) -> None:
    record = evaluate(
        open_data(town), "val", planner_factory("idm"), tmp_path / "runs", EvalSettings(("exact",), limit=1)
    )

    def said(without: int) -> list[Caveat]:
        rows = [
            row.model_copy(update={"plan": row.plan.model_copy(update={"forecasts": None})}) if at < without else row
            for at, row in enumerate(record.rows)
            if row.plan is not None
        ]
        return list(list_planner_caveats(record.run.planner, record.run.scene_facts, SampleRows.of(rows)))

    assert said(0) == said(len(record.rows)) == []
    assert [each.sentence.split(",")[0] for each in said(3)] == ["3 of 40 plans have no forecasts"]


@pytest.mark.parametrize("agents", ["replay", "idm"])
def test_a_drive_without_a_map_says_what_goes_on_without_it(agents: str, root: Path, tmp_path: Path) -> None:
    shutil.rmtree(root / "maps" / "expansion")
    data = open_data(root)
    settings = DriveSettings("default", DefaultBackend(agents), agents, limit=1)
    record = drive_split(data, "val", planner_factory("idm"), tmp_path / "drives", settings)
    (caveat,) = record.facts.caveats
    assert caveat.kind == "map" and STRAIGHT_ON in caveat.sentence and "nuPlan terms " in caveat.sentence
    assert ("agents continue straight" in caveat.sentence) is (agents == "idm")
    assert rescore_drives(record.directory, data).facts.caveats == [caveat]
