"""What a scene is drawn from in words."""

from dataclasses import replace
from pathlib import Path

from benchmark.datasets.scenarionet import read_scenarionet
from generation.extensions.magicdrive.prompt import IMPORTED, build_prompt
from tests.benchmark.datasets.test_scenarionet import recording, write


def test_the_description_of_an_imported_recording_is_its_prompt(tmp_path: Path) -> None:
    scene = read_scenarionet(write(tmp_path, recording()))
    prompt = build_prompt(scene).positive
    assert prompt == f"A driving scene image at {scene.road_map.location}. {scene.description}."
    assert build_prompt(replace(scene, description=IMPORTED)).positive == prompt, (
        "of recordings that were imported before"
    )
