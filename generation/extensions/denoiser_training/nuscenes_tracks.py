"""Tracks from nuScenes-format roots: the recording car and the vehicles around it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.datasets.roots import open_data
from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.extensions.denoiser_training.resampling import RATE_HZ, even_tracks
from generation.extensions.denoiser_training.tracks import ROUGH_SPAN_S, SMOOTHING_SPAN_S, TrackFile, rear_axle_of_box

NUSCENES_LICENCE: Final = "CC BY-NC-SA 4.0 (nuScenes terms of use)"
MADE_LICENCE: Final = "the terms of the recordings that the data set was made from"
RIGID_VEHICLES: Final = (
    "vehicle.bus.rigid",
    "vehicle.car",
    "vehicle.construction",
    "vehicle.emergency.ambulance",
    "vehicle.emergency.police",
    "vehicle.truck",
)
"""Categories with four wheels or more and no joint."""
LONGEST_GAP_S: Final = 0.3


def read_nuscenes(root: Path, version: str, source: str) -> Iterator[TrackFile]:
    """Tracks of a root, scene by scene; generated adversaries are left out.

    Rear-axle tracks at 10 Hz, twice a scene: the recording car (12 Hz where the root has all sweeps), then
    vehicles, which are annotated at 2 Hz and linear in between.
    """
    data = open_data(root, version=version)
    licence = MADE_LICENCE if data.provenance() else NUSCENES_LICENCE
    for name in data.scene_names():
        scene = data.scene(name)
        seconds = (scene.timestamps_us - scene.timestamps_us[0]) * 1e-6
        ego = even_tracks(seconds, scene.ego.pose, LONGEST_GAP_S)
        yield TrackFile(source, licence, ego, RATE_HZ, SMOOTHING_SPAN_S)
        yield TrackFile(source, licence, tuple(_vehicles(scene, seconds)), RATE_HZ, ROUGH_SPAN_S)


def _vehicles(scene: Scene, seconds: Floats) -> Iterator[Floats]:
    agents = scene.agents
    for index, category in enumerate(agents.categories):
        if category not in RIGID_VEHICLES or agents.ids[index] in scene.adversaries:
            continue
        there = agents.valid[index]
        center = np.column_stack([agents.position[index, there, :2], agents.yaw[index, there]])
        for track in even_tracks(seconds[there], center, LONGEST_GAP_S):
            yield rear_axle_of_box(track, float(agents.size[index, 0]))
