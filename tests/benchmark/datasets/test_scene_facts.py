"""Where a scene comes from and what is done in it."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import open_data
from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.errors import InputError
from benchmark.records.attempts import list_stored_labels
from benchmark.records.run_schema import LightName, SceneFacts
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.hand_made import scene_on_straight_road

LIGHT: list[LightName] = ["day"]
"""Of the hand-made scene: "Straight road, day"."""


def root_of(folder: Path, *names: str, made: dict[str, Any] | None = None) -> Path:
    """A small root; ``made`` is what its ``challenger.json`` says of the scenes."""
    TinyRoot.of(folder, [scene_on_straight_road(name=name, seconds=2.0) for name in names]).write()
    if made is not None:
        (folder / VERSION / "challenger.json").write_text(json.dumps({"split": "adv", "scenes": made}))
    return folder


def labelled(manoeuvre: str) -> dict[str, Any]:
    return {"kept": True, "labels": {"manoeuvre": manoeuvre, "place": "bend"}}


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("scene-0061", "scene-0061"), ("scene-0061-a1b2", "scene-0061"), ("scene-0061-a1-b2", "scene-0061"),
        ("scene-00610-a", "scene-00610-a"), ("city-7-night", "city-7-night"), ("scene-0061-", "scene-0061-"),
    ],
)  # fmt: skip
def test_a_name_of_the_published_form_names_its_source(name: str, source: str) -> None:
    adversaries = 0 if source == name else None
    assert build_scene_facts(name, {}) == SceneFacts(source=source, manoeuvre=None, adversaries=adversaries)


def test_what_the_data_set_says_goes_before_its_names() -> None:
    made = {"source_scene": "scene-0103", "adversaries": ["a"], "report": labelled("blocking")}
    assert build_scene_facts("scene-0061-a", made) == SceneFacts(
        source="scene-0103", manoeuvre="blocking", adversaries=1
    )


@pytest.mark.parametrize(
    ("description", "light"),
    [
        (None, None),
        ("", []),
        ("Parked truck, construction, intersection, turn left, following a van", []),
        ("Right turn at a junction, day", ["day"]),
        ("Night, after rain, many peds", ["night", "rain"]),
        ("Rainy, train behind a fence", ["rain"]),
        ("Train, brain, knights, Sunday", []),
        ("Leaving a car park at dusk", ["dusk"]),
    ],
)
def test_light_is_what_the_description_names_and_nothing_else(description: str | None, light: list[str] | None) -> None:
    assert build_scene_facts("s", {}, description).light == light


def test_the_first_of_several_adversaries_counts() -> None:
    report = {"challenge": 1.0, "adversaries": [labelled("tailgating"), labelled("blocking")]}
    assert build_scene_facts("s", {"report": report}).manoeuvre == "tailgating"
    assert [found["manoeuvre"] for found in list_stored_labels(report)] == ["tailgating", "blocking"]


@pytest.mark.parametrize(
    "report", [None, {}, [], "kept", {"labels": None}, {"labels": {}}, {"labels": []}, {"labels": {"manoeuvre": 3}}]
)
def test_without_labels_there_is_no_manoeuvre(report: Any) -> None:
    assert build_scene_facts("s", {"report": report}).manoeuvre is None


def test_a_generated_root_says_where_its_scenes_come_from(tmp_path: Path) -> None:
    made = {
        "scene-9901-x": {"adversaries": [], "report": labelled("oncoming"), "source_scene": "scene-9901"},
        "scene-9902": {"adversaries": [], "report": {}, "source_scene": "scene-9907"},
    }
    data = open_data(root_of(tmp_path, "scene-9901-x", "scene-9902", made=made))
    assert data.scene_facts(data.scene_names()) == {
        "scene-9901-x": SceneFacts(source="scene-9901", manoeuvre="oncoming", adversaries=0, light=LIGHT),
        "scene-9902": SceneFacts(source="scene-9907", manoeuvre=None, adversaries=0, light=LIGHT),
    }
    assert data.scene_facts(()) == {}
    with pytest.raises(InputError, match="has no scene 'scene-0001'"):
        data.scene_facts(["scene-0001"])


def test_recordings_are_their_own_source(tmp_path: Path) -> None:
    data = open_data(root_of(tmp_path, "scene-9901", "scene-9902"))
    found = data.scene_facts(data.scene_names())
    assert len(found) == 2 and all(facts.source == name for name, facts in found.items())


def test_variants_of_one_scene_share_their_source(tmp_path: Path) -> None:
    for folder, manoeuvre in (("v0", "oncoming"), ("v1", "blocking")):
        made = {"scene-9901": {"adversaries": [], "report": labelled(manoeuvre), "source_scene": "scene-9901"}}
        root_of(tmp_path / folder, "scene-9901", made=made)
    data = open_data(tmp_path)
    assert data.scene_facts(data.scene_names()) == {
        "v0/scene-9901": SceneFacts(source="scene-9901", manoeuvre="oncoming", adversaries=0, light=LIGHT),
        "v1/scene-9901": SceneFacts(source="scene-9901", manoeuvre="blocking", adversaries=0, light=LIGHT),
    }
    with pytest.raises(InputError, match="v2/scene-9901"):
        data.scene_facts(["v2/scene-9901"])


def test_a_source_that_is_no_name_is_refused(tmp_path: Path) -> None:
    made = {"scene-9901": {"adversaries": [], "report": {}, "source_scene": 7}}
    with pytest.raises(InputError, match="source_scene of scene-9901 must be"):
        open_data(root_of(tmp_path, "scene-9901", made=made))
