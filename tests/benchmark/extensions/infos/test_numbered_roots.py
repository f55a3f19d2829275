"""Roots with numbered scenes need neither a second shift nor another reader of the CAN bus."""

import json
from pathlib import Path

import numpy as np

from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.numbering import number_scenes
from generation.nuscenes_writer.scenes import write_scene_if_missing
from tests.benchmark.extensions.infos.info_roots import SECONDS, exported
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, short_scene, with_adversary


def numbered_root(root: Path) -> Path:
    """Two variants of one recording, as `generate` writes them."""
    scene, plan = short_scene(seconds=SECONDS), DataSetPlan(root=root, split="adv", renderer=SolidRenderer())
    names = [f"scene-9901-{letter * 8}" for letter in "ba"]
    span = int(scene.timestamps_us[0]), int(scene.timestamps_us[-1])
    numbers = number_scenes(dict.fromkeys(names, span))
    keys = [
        write_scene_if_missing(
            plan,
            with_adversary(scene, agent),
            name=name,
            source_scene="scene-9901",
            report={},
            number=numbers[name],
        ).key
        for agent, name in enumerate(names)
    ]
    finish_data_set(plan, keys)
    return root


def test_infos_have_the_times_of_the_tables_and_the_motion_of_the_can_bus(tmp_path: Path) -> None:
    root = numbered_root(tmp_path / "root")
    infos = exported(root, tmp_path / "infos", "uniad")
    times = {row["token"]: row["timestamp"] for row in json.loads((root / "v1.0-trainval/sample.json").read_text())}
    assert len(infos) == len(times) and len(set(times.values())) == len(times)
    assert all(info["timestamp"] == times[info["token"]] for info in infos)
    said = json.loads((tmp_path / "infos" / "uniad_departures.json").read_text())["departures"]
    assert not {key for found in said for key in found["keys"]} & {"timestamp", "can_bus"}
    converted = exported(root, tmp_path / "converted", "uniad", as_converted=True)
    for some in (infos, converted):
        assert all(np.abs(info["can_bus"][:16]).any() for info in some)
