"""``data stats``: what is said of scenes beside what is counted."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.scene_assessments import ASSESSMENTS_FILE, format_assessments
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.made_judgements import made_judgement
from tests.generation.labels.recorded_roads import recorded
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One scene with an adversary that stays where it was recorded, judged by hand, and its recording."""
    root = tmp_path_factory.mktemp("stats") / "root"
    scene = recorded("scene-0001", (Car(90.0, 198.25, 8.0),), seconds=4.0)
    track = np.column_stack([scene.agents.position[0, :, :2], scene.agents.yaw[0]])
    made = scene.with_adversary(0, slice(0, len(track)), track)
    plan = DataSetPlan(root=root, split="adv", version="v1.0-mini")
    keys = [
        write_scene(plan, made, name="scene-0001-aa", source_scene="scene-0001", report={"kept": True}),
        write_scene(plan, recorded("scene-0002"), name="scene-0002", source_scene="scene-0002", report={}),
    ]
    finish_data_set(plan, keys)
    judged = made_judgement(adversary="of-the-recording", unsolvable=True)
    (root / "v1.0-mini" / ASSESSMENTS_FILE).write_text(format_assessments({"scene-0001-aa": (judged,)}))
    return root


def test_scenes_with_adversaries_are_judged_and_recordings_when_asked(root: Path) -> None:
    said = run_here("data", "stats", root, "--workers", "1")
    assert said.code == 0 and "Reference drivers by scene" in said.out and "scene-0002" not in said.out
    assert "Unavoidable scenes (1): scene-0001-aa." in said.out and "Realism: not compared" in said.out
    everything = json.loads(run_here("data", "stats", root, "--judge", "--json", "--workers", "1").out)["judgement"]
    assert set(everything["scenes"]) == {"scene-0001-aa", "scene-0002"}
    assert {row["of"] for row in everything["ladder"]} == {2} and everything["unsolvable"] == ["scene-0001-aa"]
    assert everything["scenes"]["scene-0001-aa"][0]["adversary"] == "of-the-recording"


def test_nothing_is_judged_where_nobody_wants_it_or_nobody_is_adversarial(root: Path, tmp_path: Path) -> None:
    counted = json.loads(run_here("data", "stats", root, "--no-judge", "--json").out)
    assert counted["judgement"] is None and counted["counts"]["scenes"] == 2
    plan = write_root(tmp_path / "val", [recorded("scene-0002")], version="v1.0-mini", renderer=None)
    said = run_here("data", "stats", plan.root)
    assert said.code == 0 and "Who survives" not in said.out


def test_recordings_that_are_given_stand_beside(root: Path, tmp_path: Path) -> None:
    scene = recorded("scene-0001", (Car(90.0, 198.25, 8.0),), seconds=4.0)
    plan = write_root(tmp_path / "val", [scene], version="v1.0-mini", renderer=None)
    said = json.loads(run_here("data", "stats", root, "--recordings", plan.root, "--json").out)["judgement"]
    assert {row["of"] for row in said["ladder_of_recordings"]} == {1}


def test_traffic_is_measured_when_asked_and_the_adversary_counted(root: Path) -> None:
    said = run_here("data", "stats", root, "--no-judge", "--traffic", "--workers", "1")
    assert said.code == 0 and "Traffic by sample" in said.out and "adversary within 5 m, %" in said.out
    assert "noisy-log-published" in said.out and all(len(line) <= 80 for line in said.out.splitlines()[2:])
    found = json.loads(run_here("data", "stats", root, "--no-judge", "--traffic", "--json", "--workers", "1").out)
    figures, planners = found["traffic"]["figures"], found["traffic"]["planners"]
    assert set(figures["speed_m_s"]["scenes"]) == {"scene-0001-aa", "scene-0002"}
    assert set(figures["adversary_within_2_m"]["scenes"]) == {"scene-0001-aa"}
    assert planners["noisy-log"]["draws"] == 40 and planners["stop"]["collision"]["3s"]["value"] is not None
    split = ("--split", "adv", "--no-judge", "--traffic", "--json", "--workers", "1")
    assert set(json.loads(run_here("data", "stats", root, *split).out)["traffic"]["figures"]) == set(figures)
    assert json.loads(run_here("data", "stats", root, "--no-judge", "--json").out)["traffic"] is None
