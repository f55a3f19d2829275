"""Map expansions: there, in their place, whole, and of the place where the ego drove."""

from collections import defaultdict
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.constants import MAP_LAYERS, OFFICIAL_LOCATIONS
from benchmark.datasets.implausible import MISFIT_SHARE
from benchmark.datasets.map_layers import expansion_file, read_road_map
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.motion import EgoAtSamples
from benchmark.datasets.schema.table_checks import CheckedTables
from benchmark.errors import InputError
from benchmark.machine.storage import read_json
from benchmark.road_map import RoadMap

_EXPANSION_KEYS: Final = (*MAP_LAYERS, "canvas_edge", "connectivity", "arcline_path_3")
_ELSEWHERE: Final = ("../maps/expansion", "maps", "../maps", "expansion", "../expansion")
"""Folders in which expansions are found that were unpacked in the wrong one."""


def check_maps(root: Path, tables: CheckedTables, ego: EgoAtSamples, faults: FaultList) -> None:
    """Note map expansions that are missing, lie in another folder, are broken or of another place."""
    logs: defaultdict[str, set[str]] = defaultdict(set)
    for row in tables.having("log", "location"):
        logs[row["location"]].add(row["token"])
    for location in sorted(logs):
        path = expansion_file(root, location)
        if path is None:
            _note_missing(root, location, faults)
            continue
        road_map = _checked(path, location, faults)
        if road_map is not None and not road_map.drivable_area.is_empty:
            _check_fit(road_map, ego, logs[location], faults)


def _note_missing(root: Path, location: str, faults: FaultList) -> None:
    """Note a missing expansion, and where it lies if it lies near."""
    name = f"maps/expansion/{location}.json"
    folders = _ELSEWHERE if Path(location).name == location else ()
    near = next(
        (f"{folder}/{location}.json" for folder in folders if (root / folder / f"{location}.json").is_file()), None
    )
    what = "planners and generation that need the vector map cannot use the data set"
    if near is not None:
        what = f"it lies at {near}: move or link it, for without it {what}"
    elif location not in OFFICIAL_LOCATIONS:
        return
    faults.add("missing map expansions", name, "", f"{name} is missing; {what}", severity="warning")


def _checked(path: Path, location: str, faults: FaultList) -> RoadMap | None:
    """The map of a location, unless it cannot be read."""
    name = f"maps/expansion/{location}.json"
    try:
        road_map = read_road_map(path)
    except InputError as error:
        faults.add("broken map expansions", name, "", str(error))
        return None
    missing = [layer for layer in _EXPANSION_KEYS if layer not in read_json(path)]
    if missing and location in OFFICIAL_LOCATIONS:
        sentence = f"{name} lacks {', '.join(missing)}, which other readers of map expansions need"
        faults.add("incomplete map expansions", name, "", sentence, severity="warning")
    return road_map


def _check_fit(road_map: RoadMap, ego: EgoAtSamples, logs: set[str], faults: FaultList) -> None:
    """Note logs whose ego drives beside the roads of their map."""
    off = ~road_map.is_drivable(ego.position[:, :2])
    for log in sorted(logs):
        mine = np.array([each == log for each in ego.logs], np.bool_)
        share = float(off[mine].mean()) if mine.any() else 0.0
        if share > MISFIT_SHARE:
            sentence = (
                f"the recorded ego is off the drivable area of {road_map.location} in {100 * share:.0f} % of the "
                f"{np.count_nonzero(mine)} samples of this log: the map or the location is of another place"
            )
            faults.add("maps that do not fit", "log", log, sentence, severity="warning")
