"""Scenes (and the pictures a renderer makes of them) written as a nuScenes-format root that the devkit opens."""

from generation.nuscenes_writer.finish import finish_data_set
from generation.nuscenes_writer.plan import DataSetPlan, SourceInfo
from generation.nuscenes_writer.scenes import write_scene

__all__ = ["DataSetPlan", "SourceInfo", "finish_data_set", "write_scene"]
