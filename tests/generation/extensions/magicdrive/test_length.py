"""How long a scene is drawn: the lengths of the published clips, and data sets that end with them."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.published import ADV_NUSC
from generation.extensions.magicdrive import clip as clip_module
from generation.extensions.magicdrive.clip import compute_published_length
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.scenes import write_scene
from tests.generation.extensions.magicdrive.moved_worlds import busy_scene
from tests.generation.extensions.magicdrive.small_weights import small_renderer, write_weights


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_weights(tmp_path_factory.mktemp("published") / "weights")


@pytest.mark.parametrize(
    ("recorded", "written"),
    [
        (7, 7),
        (186, 186),
        (187, 185),
        (229, 225),
        (233, 233),
        (235, 233),
        (240, 240),
        (241, 241),
        (247, 241),
        (361, 241),
    ],
)
def test_recordings_are_cut_to_the_published_lengths(recorded: int, written: int) -> None:
    assert compute_published_length(recorded) == written


def test_the_counts_of_adv_nusc_are_those_of_cut_recordings() -> None:
    """Recordings have 6 (K - 1) + 1 frames for K samples; one solution gives both counts of the paper."""
    frames, samples = ADV_NUSC["sample_data"] // 7, ADV_NUSC["samples"]
    lengths = [compute_published_length(6 * (keyframes - 1) + 1) for keyframes in (39, 40, 41)]
    assert lengths == [225, 233, 241]
    solutions = [
        (few, middle, many)
        for few in range(157)
        for many in range(157 - few)
        for middle in [156 - few - many]
        if np.dot((few, middle, many), lengths) == frames
        and np.dot((few, middle, many), [(length + 5) // 6 for length in lengths]) == samples
    ]
    assert solutions == [(31, 94, 31)]


def test_a_cut_scene_ends_with_its_frames() -> None:
    scene = busy_scene(20 / 12)
    cut = scene.first_frames(13)
    assert len(cut.timestamps_us) == len(cut.ego.position) == cut.agents.yaw.shape[1] == 13
    assert cut.keyframes.tolist() == [0, 6, 12] and cut.annotations.valid.shape[1] == 3
    assert cut.agents.ids == scene.agents.ids and cut.annotations.position.shape[1:] == (3, 3)


def test_what_is_written_ends_where_the_published_clips_do(
    weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 20 frames as long as whole recordings, 17 are drawn, and their keyframes are the samples."""
    monkeypatch.setattr(clip_module, "SHORTEST_WHOLE", 20)
    renderer, scene = small_renderer(weights, tmp_path / "work", steps=1), busy_scene(20 / 12)
    assert renderer.estimate(scene).frames == 17
    plan = DataSetPlan(tmp_path / "root", "val-r", renderer=renderer)
    key = write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={})
    finish_data_set(plan, [key])
    read = NuScenesData.open(tmp_path / "root").scene(scene.name)
    assert read.keyframes.tolist() == [0, 6, 12]
    sweeps = list((tmp_path / "root").glob("s*s/CAM_FRONT/*.jpg"))
    assert len(sweeps) == 17
