"""Labels beside the tables: what generation writes, statistics read."""

from pathlib import Path

import pytest

from benchmark.datasets.statistics import statistics
from generation.labels.labelling import compute_labels
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.generation.nuscenes_writer.written_roots import short_scene, with_adversary


@pytest.mark.parametrize("layout", ["suffixed", "per-variant"])
def test_statistics_read_what_labels_write(tmp_path: Path, layout: str) -> None:
    plan = DataSetPlan(root=tmp_path, split="adv", layout=layout)  # type: ignore[arg-type]
    keys, found = [], []
    for variant in range(2):
        scene = with_adversary(short_scene(seconds=4.0), variant)
        labels = compute_labels(scene, scene.agents.ids.index(scene.adversaries[0]), 6)
        found.append(labels)
        name = scene.name if layout == "per-variant" else f"{scene.name}-{variant}"
        report = {"kept": True, "labels": labels.as_json()}
        keys.append(write_scene(plan, scene, name=name, variant=variant, source_scene=scene.name, report=report))
    finish_data_set(plan, keys)
    read = statistics(tmp_path, split="adv")
    assert (read.counts.scenes, read.labelled, read.adversaries_per_scene) == (2, 2, {1: 2})
    assert {row.manoeuvre: row.primary for row in read.manoeuvres if row.primary} == {
        labels.manoeuvre: [other.manoeuvre for other in found].count(labels.manoeuvre) for labels in found
    }
    assert read.gap_m is not None
    assert read.gap_m.least == pytest.approx(min(labels.closest_approach.gap_m for labels in found))
    assert set(read.places) == {labels.place for labels in found}
