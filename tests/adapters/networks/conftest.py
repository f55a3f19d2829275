"""Images of two short scenes, made once for all networks."""

import pytest

from benchmark.datasets.nuscenes import NuScenesData
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene("scene-9901", seconds=4.5), short_scene("scene-9902", ego_speed=3.0)])
    return NuScenesData.open(root)
