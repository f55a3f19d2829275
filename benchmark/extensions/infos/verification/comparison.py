"""Infos compared with official ones, each key as the manifest of the golden set says."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.extensions.infos.exporting import CONVERTED_PREFIX, InfoFiles
from benchmark.extensions.infos.map_lines import PATCH_M
from benchmark.extensions.infos.repositories import REPOSITORIES, Part
from benchmark.extensions.infos.verification.golden_set import GoldenFile, Tolerances
from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison

_MAPS: Final = "map_annos"
_CAMERAS: Final = ("cams",)
_LIMIT: Final = re.compile(r"<= *([0-9.]+e-?[0-9]+)")
_PATHS: Final = frozenset({"lidar_path", "data_path"})
_NUMBERS: Final = "iufb"
_NAMES_SHOWN: Final = 3


class InfoComparison:
    """Gathers the errors of each key over roots.

    Args:
        tolerances: By repository, and by the names of keys between commas; a number is a largest difference, of map
            elements a sentence says it, and all other keys must be equal.
    """

    def __init__(self, comparison: Comparison, tolerances: Tolerances) -> None:
        self._found = comparison
        self._limits = {name: _limits(words) for name, words in tolerances.items()}

    def tables(self, root: str, changed: Mapping[str, bool]) -> None:
        """Note whether a root is the one that the files were made from."""
        wrong = [name for name, differs in changed.items() if differs]
        where = f"{root}: {', '.join(wrong[:_NAMES_SHOWN])}"
        self._found.verdicts("tables of the roots", list(changed.values()), where=where)

    def files(self, root: str, official: GoldenFile, ours: InfoFiles) -> None:
        """Compare the files of one repository for one root, exported as converted."""
        reader, content = REPOSITORIES[official.repository], official.read()
        named: dict[str, Part] = {reader.file_name(ours.version, part): part for part in ours.parts}
        part = named.get(official.official_name)
        self._equal(reader.name, "name of the file", part is not None, root)
        counts = {name: len(infos) for name, infos in ours.parts.items()}
        self._equal(reader.name, "number of infos", counts == dict(official.counts), root)
        top = list(content) == ["infos", "metadata"] and content["metadata"] == {"version": ours.version}
        self._equal(reader.name, "top level", top, root)
        infos, golden = ours.parts.get(part, []) if part else [], content["infos"]
        order = [info["token"] for info in infos] == [info.get("token") for info in golden]
        self._equal(reader.name, "order of infos", order, root)
        for info, expected in zip(infos, golden):
            place = f"{root}, sample {info['token'][:8]}"
            compared = {key: value for key, value in info.items() if key not in official.left_out}
            self._equal(reader.name, "keys of an info", list(compared) == list(expected), place)
            for key in compared:
                if key in expected:
                    self._value(reader.name, (key,), compared[key], expected[key], place)

    def _value(self, reader: str, path: tuple[str, ...], ours: Any, golden: Any, where: str) -> None:
        name = ".".join(path)
        if path == (_MAPS,):
            self._map_elements(reader, ours, golden, where)
        elif isinstance(ours, np.ndarray):
            self._array(reader, name, path[-1], ours, golden, where)
        elif isinstance(ours, dict) and isinstance(golden, dict):
            self._equal(reader, f"keys of {path[0]}", list(ours) == list(golden), where)
            for key in ours:
                if key in golden:
                    # The cameras are one quantity, whichever it is.
                    self._value(reader, (*path, "*" if path == _CAMERAS else key), ours[key], golden[key], where)
        elif isinstance(ours, list) and isinstance(golden, list) and any(isinstance(each, dict) for each in ours):
            self._equal(reader, f"number of {name}", len(ours) == len(golden), where)
            for mine, theirs in zip(ours, golden):
                self._value(reader, path, mine, theirs, where)
        elif path[-1] in _PATHS:
            same = isinstance(golden, str) and _without_prefix(ours) == _without_prefix(golden)
            self._equal(reader, name, same, where)
        else:
            self._equal(reader, name, type(ours) is type(golden) and bool(ours == golden), where)

    def _array(self, reader: str, name: str, key: str, ours: NDArray[Any], golden: Any, where: str) -> None:
        same = isinstance(golden, np.ndarray) and (ours.dtype, ours.shape) == (golden.dtype, golden.shape)
        self._equal(reader, "dtypes and shapes", same, f"{where}, {name}")
        if not same:
            return
        limit = self._limits.get(reader, {}).get(key)
        if limit is None or ours.dtype.kind not in _NUMBERS:
            nan = ours.dtype.kind == "f"
            self._equal(reader, name, bool(np.array_equal(ours, golden, equal_nan=nan)), where)
            return
        known = ~np.isnan(golden.astype(np.float64))
        self._equal(reader, "places of NaN", bool(np.array_equal(known, ~np.isnan(ours.astype(np.float64)))), where)
        self._found.numbers(f"{reader}: {name}", ours[known], golden[known], limit, where=where)

    def _map_elements(self, reader: str, ours: dict[int, list[Floats]], golden: Any, where: str) -> None:
        name = f"{reader}: {_MAPS}"
        same = (
            isinstance(golden, dict)
            and list(ours) == list(golden)
            and all(isinstance(golden[kind], list) for kind in ours)
            and all(map(_is_line, (line for kind in ours for line in golden[kind])))
        )
        self._equal(reader, f"classes of {_MAPS}", same, where)
        if not same:
            return
        limit = self._limits.get(reader, {}).get(_MAPS, 0.0)
        for kind, lines in ours.items():
            self._equal(reader, f"elements of {_MAPS}", len(lines) == len(golden[kind]), f"{where}, class {kind}")
            for mine, theirs in zip(lines, golden[kind]):
                away = np.concatenate([_distances(mine, theirs, limit), _distances(theirs, mine, limit)])
                self._found.errors(name, away, limit, where=f"{where}, class {kind}")

    def _equal(self, reader: str, name: str, same: bool, where: str) -> None:
        self._found.verdicts(f"{reader}: {name}", not same, where=where)


def _limits(words: Mapping[str, Any]) -> dict[str, float]:
    """Largest differences by key."""
    found: dict[str, float] = {}
    for names, limit in words.items():
        said = _LIMIT.search(limit) if isinstance(limit, str) and names == _MAPS else None
        if said is not None or isinstance(limit, int | float):
            found |= dict.fromkeys(map(str.strip, names.split(",")), float(said[1] if said else limit))
    return found


def _without_prefix(path: str) -> str:
    return path.removeprefix(CONVERTED_PREFIX)


def _is_line(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.ndim == 2 and value.shape[1:] == (2,)


def _distances(line: Floats, other: Floats, margin_m: float) -> Floats:
    """How far the vertices of a line, and the middles between them, are from another.

    What lies on the edge of the patch is left out, for its belonging to an element hangs on the last bit. The middles
    are asked because a straight line may begin and end there.
    """
    points = np.concatenate([line, 0.5 * (line[1:] + line[:-1])])
    inside = (np.abs(np.abs(points) - np.array(PATCH_M) / 2) > margin_m).all(axis=1)
    to = shapely.LineString(other) if len(other) > 1 else shapely.multipoints(other)
    return np.asarray(shapely.distance(shapely.points(points[inside]), to))
