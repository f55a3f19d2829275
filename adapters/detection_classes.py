"""Kinds of agents that the networks tell apart: the detection task of nuScenes, in the order of their outputs."""

from typing import Final

AGENT_CLASSES: Final = (
    "car",
    "truck",
    "construction_vehicle",
    "bus",
    "trailer",
    "barrier",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "traffic_cone",
)
