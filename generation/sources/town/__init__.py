"""The embedded town: scenes made from a seed, so that everything works without a download."""

from generation.sources.town.scenes import (
    DEFAULT_VAL_SCENES,
    MOST_TRAIN_SCENES,
    town_scene,
    town_scene_driven,
    town_scene_names,
    town_scene_off_path,
)
from generation.sources.town.towns import TOWN_VERSION

__all__ = [
    "DEFAULT_VAL_SCENES",
    "MOST_TRAIN_SCENES",
    "TOWN_VERSION",
    "town_scene",
    "town_scene_driven",
    "town_scene_names",
    "town_scene_off_path",
]
