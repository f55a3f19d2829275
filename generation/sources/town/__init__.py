"""The embedded town: scenes made from a seed, so that everything works without a download."""

from generation.sources.town.scenes import (
    DEFAULT_VAL_SCENES,
    MOST_TRAIN_SCENES,
    build_town_scene,
    build_town_scene_driven,
    build_town_scene_off_path,
    list_town_scene_names,
)
from generation.sources.town.towns import TOWN_VERSION

__all__ = [
    "DEFAULT_VAL_SCENES",
    "MOST_TRAIN_SCENES",
    "TOWN_VERSION",
    "build_town_scene",
    "build_town_scene_driven",
    "build_town_scene_off_path",
    "list_town_scene_names",
]
