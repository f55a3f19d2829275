"""The tables of nuScenes: what each field of a row must be, and which rows of other tables it names.

Only fields are described that somebody reads, here or in software for this format; a row may have others.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from benchmark.datasets.schema.kinds import (
    COUNT,
    FILE,
    FLAG,
    LINK,
    LINK_OR_NONE,
    LINKS_OF_LIST,
    MATRIX,
    MOUNTING,
    NAME,
    POSITION,
    ROTATION,
    SIZE,
    TEXT,
    TIME,
    TOKEN,
    Kind,
)


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a row.

    Attributes:
        target: Table whose rows it names by their token; empty where it names none.
        unique: Whether no two rows may have the same.
    """

    kind: Kind
    target: str = ""
    unique: bool = False


@dataclass(frozen=True, slots=True)
class Link:
    """A field that names rows of a table.

    Attributes:
        target: Table that has the rows.
        may_be_empty: Whether it may name none.
    """

    table: str
    field: str
    target: str
    may_be_empty: bool


def _chain(table: str) -> dict[str, Field]:
    return {"prev": Field(LINK_OR_NONE, table), "next": Field(LINK_OR_NONE, table)}


_TOKEN: Final = {"token": Field(TOKEN, unique=True)}

SCHEMA: Final[Mapping[str, Mapping[str, Field]]] = {
    "attribute": {**_TOKEN, "name": Field(TEXT, unique=True)},
    "calibrated_sensor": {
        **_TOKEN,
        "sensor_token": Field(LINK, "sensor"),
        "translation": Field(MOUNTING),
        "rotation": Field(ROTATION),
        "camera_intrinsic": Field(MATRIX),
    },
    "category": {**_TOKEN, "name": Field(TEXT, unique=True)},
    "ego_pose": {
        **_TOKEN,
        "timestamp": Field(TIME),
        "translation": Field(POSITION),
        "rotation": Field(ROTATION),
    },
    "instance": {
        **_TOKEN,
        "category_token": Field(LINK, "category"),
        "nbr_annotations": Field(COUNT),
        "first_annotation_token": Field(LINK_OR_NONE, "sample_annotation"),
        "last_annotation_token": Field(LINK_OR_NONE, "sample_annotation"),
    },
    "log": {
        **_TOKEN,
        "logfile": Field(TEXT),
        "vehicle": Field(TEXT),
        "date_captured": Field(TEXT),
        "location": Field(NAME),
    },
    # The logs that a map lists may be missing: the maps of the official v1.0-mini list logs that only trainval has.
    "map": {**_TOKEN, "category": Field(TEXT), "filename": Field(FILE), "log_tokens": Field(LINKS_OF_LIST)},
    "sample": {**_TOKEN, "timestamp": Field(TIME), "scene_token": Field(LINK, "scene"), **_chain("sample")},
    "sample_annotation": {
        **_TOKEN,
        "sample_token": Field(LINK, "sample"),
        "instance_token": Field(LINK, "instance"),
        "visibility_token": Field(LINK_OR_NONE, "visibility"),
        "attribute_tokens": Field(LINKS_OF_LIST, "attribute"),
        "translation": Field(POSITION),
        "size": Field(SIZE),
        "rotation": Field(ROTATION),
        "num_lidar_pts": Field(COUNT),
        "num_radar_pts": Field(COUNT),
        **_chain("sample_annotation"),
    },
    "sample_data": {
        **_TOKEN,
        "sample_token": Field(LINK, "sample"),
        "ego_pose_token": Field(LINK, "ego_pose"),
        "calibrated_sensor_token": Field(LINK, "calibrated_sensor"),
        "timestamp": Field(TIME),
        "fileformat": Field(TEXT),
        "is_key_frame": Field(FLAG),
        "height": Field(COUNT),
        "width": Field(COUNT),
        "filename": Field(FILE),
        **_chain("sample_data"),
    },
    "scene": {
        **_TOKEN,
        "name": Field(NAME, unique=True),
        "description": Field(TEXT),
        "log_token": Field(LINK, "log"),
        "nbr_samples": Field(COUNT),
        "first_sample_token": Field(LINK, "sample"),
        "last_sample_token": Field(LINK, "sample"),
    },
    "sensor": {**_TOKEN, "channel": Field(NAME, unique=True), "modality": Field(TEXT)},
    "visibility": {**_TOKEN, "level": Field(TEXT)},
}
"""Fields by table and name. What lies beside the tables has its own readers: masks and map expansion, CAN bus."""

LINKS: Final = tuple(
    Link(table, name, field.target, field.kind is LINK_OR_NONE)
    for table, fields in SCHEMA.items()
    for name, field in fields.items()
    if field.target
)
