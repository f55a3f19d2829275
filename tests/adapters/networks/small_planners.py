"""All native planners with networks that run in a moment, by the names of their published models."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from adapters.camera_inputs import BGR_MEAN, RGB_MEAN_STD, NetworkImageFormat
from adapters.models import MODELS
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.planner import SparsePlanner
from adapters.networks.uniad.planner import UniADPlanner
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from adapters.networks.vad.planner import VADPlanner
from adapters.planner import NativePlanner
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.geometry import Floats
from benchmark.planning import SceneInfo
from tests.adapters.networks.sparse.miniature import MINIATURE, filled
from tests.adapters.networks.uniad.small_uniad import SMALL, small_network

VAD_CONFIG = replace(
    VADConfig.tiny(),
    bev_rows=10,
    bev_columns=10,
    encoder_layers=1,
    decoder_layers=1,
    channels=32,
    feedforward_channels=32,
    heads=4,
    agents=12,
    map_instances=6,
    backbone_blocks=(1, 1, 1, 1),
    backbone_width=8,
    max_boxes=8,
    max_lines=5,
    image_scale=0.1,
)
UNIAD_CONFIG = replace(SMALL, image_format=NetworkImageFormat.scaled(0.1))
NAMES = ("vad", "uniad", "sparsedrive", "diffusiondrive")


def small_vad(network: type[VAD] = VAD, **settings: Any) -> VADPlanner:
    torch.manual_seed(3)
    given = {"name": "vad", "normalisation": BGR_MEAN, "device": "cpu", **settings}
    return VADPlanner(network(VAD_CONFIG), **given)


def small_uniad(name: str = "uniad", **settings: Any) -> UniADPlanner:
    network = small_network(config=UNIAD_CONFIG)
    network.solver = MODELS[name].net.settings["solver"]
    return UniADPlanner(network, name=name, normalisation=BGR_MEAN, device="cpu", **settings)


def small_sparse(
    name: str = "sparsedrive", *, seed: int = 0, config: SparseConfig = MINIATURE, **settings: Any
) -> SparsePlanner:
    network = filled(name, config, **({"seed": seed} if name == "diffusiondrive" else {}))
    given = {"name": name, "normalisation": RGB_MEAN_STD, "native_protocol": name, "device": "cpu", **settings}
    return SparsePlanner(network, **given)


def small(name: str, **settings: Any) -> NativePlanner[Any]:
    if name == "vad":
        return small_vad(**settings)
    return small_uniad(name, **settings) if name.startswith("uniad") else small_sparse(name, **settings)


def plans(built: NativePlanner[Any], data: NuScenesData, name: str, *, first: int = 0) -> Floats:
    scene = data.scene(name)
    built.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
    return np.stack([built.plan(seen).waypoints for seen in list(data.observations(name))[first:]])
