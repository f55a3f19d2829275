"""Small roots to look at: three scenes on a straight road, with pictures or without."""

from pathlib import Path

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.split_reviews import record_verdicts, scene_tokens
from benchmark.records.review import Verdict
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.render.contract import Renderer
from tests.generation.splits.frozen_files import road

NAMES = ("scene-9901", "scene-9902", "scene-9903")


def three_scenes(root: Path, renderer: Renderer | None = None) -> DataSet:
    plan = DataSetPlan(root=root, split="val", version="v1.0-mini", renderer=renderer, frames="keyframes")
    scenes = [road(name, 4.0 * place) for place, name in enumerate(NAMES)]
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys)
    return open_data(root)


def say(root: Path, **verdicts: str) -> None:
    """Record verdicts: ``scene_9901="accepted"``, or the reason of a rejection."""
    tokens = scene_tokens(root)
    said: dict[str, Verdict | None] = {}
    for key, text in verdicts.items():
        name = key.replace("_", "-")
        decision = "accepted" if text == "accepted" else "rejected"
        said[name] = Verdict.model_validate(
            {"verdict": decision, "reason": "" if text == "accepted" else text, "token": tokens[name]}
        )
    record_verdicts(root, said)
