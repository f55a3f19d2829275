"""Data sets and frames that many tests of the training read, made once; none of them may be changed."""

import pytest

from adapters.extensions.training.dataset_mixture import FrameStore, build_frames
from benchmark.datasets.nuscenes import NuScenesData
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    """Two scenes of a split ``val``, 5 s long, of an ego that keeps its 8 m/s."""
    root = tmp_path_factory.mktemp("two scenes")
    write_root(root, [short_scene(f"scene-990{k + 1}", seconds=5.0, ego_x=50.0 + 7 * k) for k in range(2)])
    return NuScenesData.open(root)


@pytest.fixture(scope="session")
def store(data: NuScenesData, tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    return build_frames(data.root, "val", tmp_path_factory.mktemp("frames"))
