"""Categories, attributes, visibility levels, logs and sensors: the rows that scenes share."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.constants import CAMERA_NAMES, LIDAR_NAME, NUMBERED_CATEGORIES
from benchmark.datasets.tables import find_version_folders
from benchmark.errors import InputError
from benchmark.machine.storage import make_token, read_json
from benchmark.scene import Scene
from generation.nuscenes_writer.plan import SourceInfo

Row = dict[str, Any]

_CATEGORY_WORDS: Final = {
    "animal": "Any animal, for example a cat, dog or bird.",
    "human.pedestrian.adult": "A grown-up on foot.",
    "human.pedestrian.child": "A child on foot.",
    "human.pedestrian.construction_worker": "A person who works on the road.",
    "human.pedestrian.personal_mobility": "A person on a small vehicle such as a skateboard or scooter.",
    "human.pedestrian.police_officer": "A police officer on foot.",
    "human.pedestrian.stroller": "A pram or pushchair.",
    "human.pedestrian.wheelchair": "A wheelchair and whoever sits in it.",
    "movable_object.barrier": "A temporary barrier.",
    "movable_object.debris": "An object left on the road that is too large to drive over.",
    "movable_object.pushable_pullable": "Something that a person pushes or pulls, for example a bin or a trolley.",
    "movable_object.trafficcone": "A traffic cone.",
    "static_object.bicycle_rack": "A place to park bicycles, with the bicycles in it.",
    "vehicle.bicycle": "A bicycle.",
    "vehicle.bus.bendy": "One section of an articulated bus.",
    "vehicle.bus.rigid": "A bus in one piece.",
    "vehicle.car": "A passenger car, van or pick-up.",
    "vehicle.construction": "A vehicle made for construction work.",
    "vehicle.emergency.ambulance": "An ambulance.",
    "vehicle.emergency.police": "A police vehicle.",
    "vehicle.motorcycle": "A motorcycle or motor scooter.",
    "vehicle.trailer": "A trailer of any kind, without what pulls it.",
    "vehicle.truck": "A vehicle made to carry goods.",
    # Only points of a lidar are of these kinds, never boxes; the rows are there for the numbers of those above.
    "noise": "A point that belongs to nothing.",
    "flat.driveable_surface": "Ground that cars may drive on.",
    "flat.other": "Any other flat ground, or water.",
    "flat.sidewalk": "Ground for those on foot.",
    "flat.terrain": "Grass, earth and sand.",
    "static.manmade": "A building, a wall, a post or anything else that is built.",
    "static.other": "Anything that stands and is of no other kind.",
    "static.vegetation": "A plant that is higher than grass.",
    "vehicle.ego": "The car that records.",
}
_ATTRIBUTE_WORDS: Final = {
    "cycle.with_rider": "Somebody rides the cycle.",
    "cycle.without_rider": "Nobody is on the cycle.",
    "pedestrian.moving": "The person walks or runs.",
    "pedestrian.sitting_lying_down": "The person sits or lies.",
    "pedestrian.standing": "The person stands.",
    "vehicle.moving": "The vehicle moves.",
    "vehicle.parked": "The vehicle is parked.",
    "vehicle.stopped": "The vehicle stands but means to go on.",
}
_VISIBILITY_LEVELS: Final = ("v0-40", "v40-60", "v60-80", "v80-100")


@dataclass(frozen=True, slots=True)
class LabelVocabulary:
    """Label rows of a data set: the source's own where it has them; visibility in order of level.

    Categories are in the order of nuScenes' table of 32, whose row numbers official code knows them by; those of the
    source alone come behind.
    """

    category: dict[str, Row]
    attribute: dict[str, Row]
    visibility: tuple[Row, ...]
    log: tuple[Row, ...]
    map: tuple[Row, ...]

    @classmethod
    def of(cls, source: SourceInfo | None) -> "LabelVocabulary":
        """Labels of a data set that derives from ``source``."""
        folder = _find_table_folder(source)
        tables = {name: _read_rows(folder, name) for name in ("category", "attribute", "visibility", "log", "map")}
        return cls(
            category=_number_categories({row["name"]: row for row in tables["category"]}),
            attribute={row["name"]: row for row in tables["attribute"] or _build_rows("attribute", _ATTRIBUTE_WORDS)},
            visibility=_complete_visibility(tables["visibility"]),
            log=tuple(tables["log"]),
            map=tuple(tables["map"]),
        )

    def get_category_row(self, name: str) -> Row:
        """Row of a category; one that the table lacks is made up."""
        return self.category.get(name) or _build_rows("category", {name: ""})[0]

    def get_attribute_row(self, name: str) -> Row:
        """Row of an attribute; one that the table lacks is made up."""
        return self.attribute.get(name) or _build_rows("attribute", {name: ""})[0]

    def get_visibility_token(self, level: int) -> str:
        """Token of a level 1..4; 0 (nothing known) counts as fully visible, because official code parses it."""
        wanted = _VISIBILITY_LEVELS[(level or 4) - 1]
        named = (row["token"] for row in self.visibility if row.get("level") == wanted)
        return str(next(named, str(level or 4)))

    def get_log_row(self, scene: Scene) -> Row:
        """Row of the scene's log: the source's, if it has that log."""
        own = {
            "logfile": scene.log,
            "vehicle": scene.vehicle,
            "date_captured": scene.date,
            "location": scene.road_map.location,
        }
        for row in self.log:
            if scene.log and (row.get("logfile"), row.get("location")) == (scene.log, scene.road_map.location):
                return row
        return {"token": make_token("log", own), **own}


def build_sensor_row(channel: str) -> Row:
    """Row of a sensor; the same in every data set."""
    modality = "lidar" if channel == LIDAR_NAME else "camera"
    return {"token": make_token("sensor", channel), "channel": channel, "modality": modality}


def build_sensor_rows(channels: Collection[str]) -> list[Row]:
    """Rows of the six cameras and the lidar, and of other channels that there are."""
    usual = (*CAMERA_NAMES, LIDAR_NAME)
    return [build_sensor_row(channel) for channel in (*usual, *sorted(set(channels) - set(usual)))]


def _build_rows(table: str, words: Mapping[str, str]) -> list[Row]:
    return [{"token": make_token(table, name), "name": name, "description": text} for name, text in words.items()]


def _number_categories(own: Mapping[str, Row]) -> dict[str, Row]:
    """Categories in nuScenes' order: the source's rows where it has them."""
    numbered = {name: _build_rows("category", {name: _CATEGORY_WORDS[name]})[0] for name in NUMBERED_CATEGORIES}
    return {**numbered, **own}


def _build_visibility_rows() -> list[Row]:
    bounds = (level.removeprefix("v").split("-") for level in _VISIBILITY_LEVELS)
    return [
        {"token": str(number), "level": level, "description": f"{low} to {high} % of the object can be seen"}
        for number, (level, (low, high)) in enumerate(zip(_VISIBILITY_LEVELS, bounds), start=1)
    ]


def _complete_visibility(own: Sequence[Row]) -> tuple[Row, ...]:
    """Rows of a data set and of those levels of nuScenes that it lacks."""
    levels, tokens = {row.get("level") for row in own}, {row["token"] for row in own}
    missing = [row for row in _build_visibility_rows() if row["level"] not in levels]
    return (*own, *({**row, "token": make_token(row)} if row["token"] in tokens else row for row in missing))


def _find_table_folder(source: SourceInfo | None) -> Path | None:
    if source is None or source.root is None:
        return None
    if source.version is not None:
        return source.root / source.version
    versions = find_version_folders(source.root)
    if len(versions) > 1:
        raise InputError(
            f"{source.root} has several versions ({', '.join(versions)}); name the one to use as the source"
        )
    return source.root / versions[0] if versions else None


def _read_rows(folder: Path | None, table: str) -> list[Row]:
    if folder is None or not (folder / f"{table}.json").is_file():
        return []
    rows: list[Row] = read_json(folder / f"{table}.json")
    return rows


if set(_CATEGORY_WORDS) != set(NUMBERED_CATEGORIES):
    raise AssertionError("the descriptions and benchmark.constants.NUMBERED_CATEGORIES name different categories")
