"""The table of planners; its miniatures load, drive, look at the images, are small, and say where they come from."""

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from adapters.checkpoints.cache import read_provenance, write_weights
from adapters.checkpoints.checkpoint_import import resolve_checkpoint
from adapters.checkpoints.loading import build_native_planner
from adapters.checkpoints.stand_in import stand_in
from adapters.models import MODELS, baselines, miniature, miniatures, published_as, published_models, resolve
from adapters.registry import build_planner, planner_factory
from benchmark.api import load_planner
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256
from benchmark.machine.workspace import DEMONSTRATED, EMBEDDED
from benchmark.planning import CameraView, Observation, SceneInfo
from generation.sources.mini import TownSettings, build_town_data_set, draw_town_scene
from tests.whole_product import is_installed

MOST_BYTES = 20_000_000
MOST_PARAMETERS = 3_000_000
SAMPLES = 10
SCENES = ("scene-8004", "scene-8005")
"""The ego brakes in one and turns in the other, which its own motion alone does not tell."""


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    """Scenes of mini itself; of `SCENES` there are images, without the frames between the key frames."""
    settings = TownSettings(val_scenes=6, frames="keyframes", pictures="asked")
    root = build_town_data_set(tmp_path_factory.mktemp("town"), settings, workers=1)
    for name in SCENES:
        draw_town_scene(root, name, sweeps=False)
    return NuScenesData.open(root)


@pytest.fixture(autouse=True)
def _no_imported_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    yield


def shown(data: NuScenesData, number: int, images: str) -> Iterator[Observation]:
    """Observations of a scene with its own images, grey ones, or what the same cameras saw in the other scene."""
    own, other = (list(data.observations(SCENES[place])) for place in (number, 1 - number))
    for observation, elsewhere in zip(own, other, strict=True):
        views = {
            "own": observation.views,
            "blank": {key: replace(view, load=partial(grey, view)) for key, view in observation.views.items()},
            "shuffled": {key: replace(view, load=elsewhere.views[key].load) for key, view in observation.views.items()},
        }
        yield replace(observation, views=views[images])


def grey(view: CameraView) -> NDArray[np.uint8]:
    return np.full((view.camera.height, view.camera.width, 3), 128, np.uint8)


def plans(name: str, data: NuScenesData, images: str, samples: int = SAMPLES) -> tuple[Floats, Floats]:
    """Plans for the first samples of each scene, and what was driven, (S, 6, 2)."""
    driver, found, driven = build_planner(name), [], []
    for number, scene_name in enumerate(SCENES):
        scene = data.scene(scene_name)
        driver.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        pairs = zip(shown(data, number, images), data.truth(scene_name), strict=True)
        for observation, truth in pairs:
            if observation.index >= samples:
                break
            found.append(driver.plan(observation).waypoints_in_lidar(truth.lidar_ahead_m))
            driven.append(truth.ego_future[:, :2])
    return np.array(found), np.array(driven)


def references(value: Any) -> Iterator[str]:
    """All that an entry names as ``module:attribute``."""
    if isinstance(value, str) and ":" in value:
        yield value
    elif is_dataclass(value):
        for field in fields(value):
            yield from references(getattr(value, field.name))


@pytest.mark.parametrize("name", MODELS)
def test_everything_that_the_table_names_is_there(name: str) -> None:
    found = [reference for reference in references(MODELS[name]) if is_installed(reference)]
    made = [resolve(reference) for reference in found]
    assert made and all(callable(each) or hasattr(each, "verify") for each in made)


def test_reading_the_table_imports_no_network() -> None:
    program = (
        "import sys, adapters.models; print([name for name in sys.modules if name == 'torch' or "
        "name.startswith('adapters.') and name != 'adapters.models'])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_kinds_of_planners_are_told_apart() -> None:
    kinds = (*baselines(), *published_models(), *miniatures())
    assert len(set(kinds)) == len(kinds)
    assert set(MODELS) - set(kinds) == {"vad", "uniad-unoptimised", "uniad-ipopt"}
    assert MODELS["vad"].name == "vad-base" and published_as("VAD") == "VAD" and published_as("UniAD") == "UniAD"
    assert not any(map(published_as, ("vad-tiny", "uniad-mini", "mine")))
    assert {name for name, model in MODELS.items() if model.blind} == set(baselines())
    assert sum(miniature(name).packaged.stat().st_size for name in miniatures()) <= MOST_BYTES


# Weights change when they are trained anew: one miniature by day, all at night.
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "vad-mini" else pytest.mark.slow) for name in miniatures()]
)
def test_it_drives_and_looks_at_the_images(town: NuScenesData, name: str) -> None:
    own, driven = plans(name, town, "own")
    again, _ = plans(name, town, "own", samples=2)
    np.testing.assert_array_equal(own[[0, 1, SAMPLES, SAMPLES + 1]], again)
    error_m = np.linalg.norm(own - driven, axis=-1)[:, -1].mean()
    assert error_m < 4.0
    for images in ("blank", "shuffled"):
        others, _ = plans(name, town, images)
        moved_m = np.linalg.norm(others - own, axis=-1)[:, -1].mean()
        assert moved_m > 0.3
        assert np.linalg.norm(others - driven, axis=-1)[:, -1].mean() > error_m + 0.1


@pytest.mark.parametrize("name", miniatures())
def test_it_says_what_it_is(name: str) -> None:
    driver, native = build_planner(name), name.removesuffix("-mini")
    assert driver.name == name and driver.native_protocol == native  # type: ignore[attr-defined]
    assert read_provenance(miniature(name).packaged).model == name
    facts = planner_factory(name).facts
    assert facts.miniature and facts.published_as is None and facts.native_protocol == native
    assert facts.name == name and facts.weights_sha256 == file_sha256(miniature(name).packaged)


@pytest.mark.parametrize("name", miniatures())
def test_facts_and_card_are_of_this_file(name: str) -> None:
    path = miniature(name).packaged
    facts, card = json.loads(path.with_suffix(".json").read_text()), path.with_suffix(".md").read_text()
    assert facts["model"] == name and facts["sha256"] == file_sha256(path) and facts["bytes"] == path.stat().st_size
    assert facts["source"]["commit"] and facts["seed"] >= 0 and facts["frames"] > 1000
    steps = {f"{phase['steps']:,} ({label}" for label, phase in facts["phases"].items()}
    assert steps and all(part in card for part in steps)
    figures = facts["figures"]
    for shown_as in ("own", "blank", "shuffled", "constant-velocity"):
        assert f"| {figures[shown_as]['l2_3s_m']:.2f} |" in card
    assert facts["sha256"] in card and "ranks nothing" in card
    # What makes it a planner: it beats going straight on, and it needs its images for that.
    own = figures["own"]
    assert own["l2_3s_m"] < 0.9 * figures["constant-velocity"]["l2_3s_m"]
    assert own["collisions"] < figures["constant-velocity"]["collisions"]
    assert min(figures[other]["l2_3s_m"] for other in ("blank", "shuffled")) > 1.1 * own["l2_3s_m"]
    assert facts["lost"]["shuffled"]["l2_3s_m"]["low"] > 0
    assert facts["parameters"] <= MOST_PARAMETERS


def test_miniatures_stand_in_for_the_full_model_on_the_embedded_data_only(tmp_path: Path) -> None:
    smaller = {"vad": "vad-mini", "vad-tiny": "vad-mini", "vad-base": "vad-mini", "uniad": "uniad-mini"}
    smaller |= {name: f"{name}-mini" for name in ("sparsedrive", "diffusiondrive")}
    for full, small in smaller.items():
        assert stand_in(full, None, EMBEDDED) == small == stand_in(small, None, EMBEDDED)
        assert stand_in(full, None, "nuscenes") == full == stand_in(full, tmp_path / "weights.pth", EMBEDDED)
    assert stand_in("idm", None, EMBEDDED) == "idm"
    # Imported weights of the full model go first: what stands in the cache counts, not whether it could be loaded.
    (tmp_path / "cache" / "weights").mkdir(parents=True)
    provenance = read_provenance(miniature("vad-mini").packaged).model_copy(update={"model": "vad-tiny"})
    write_weights(tmp_path / "cache" / "weights" / "vad-x.safetensors", {}, provenance)
    assert stand_in("vad-tiny", None, EMBEDDED) == "vad-tiny"


def test_a_miniature_without_its_file_and_with_another_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"there are no weights for vad-tiny; .*--model vad-mini"):
        resolve_checkpoint("vad-tiny", None)
    with pytest.raises(InputError, match=r"holds the weights of vad-mini, not of uniad-mini"):
        build_native_planner(miniature("uniad-mini"), miniature("vad-mini").packaged)
    with pytest.raises(InputError, match="'nonsense' is not a miniature; use one of uniad-mini"):
        miniature("nonsense")
    monkeypatch.setattr("adapters.models.PACKAGED", tmp_path)
    with pytest.raises(InputError, match="missing in this installation; train them with"):
        build_native_planner(miniature("vad-mini"))
    assert stand_in("vad", None, EMBEDDED) == "vad"


def test_the_command_says_once_which_model_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmark.api.opening._notified", set())
    assert load_planner("vad", data=EMBEDDED).name == "vad-mini"
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("no weights found for vad: running vad-mini instead")
    for name in ("vad", "vad-mini"):
        assert load_planner(name, data=DEMONSTRATED).name == "vad-mini"
    assert capsys.readouterr().err == ""
