"""Infos compared with official ones, key by key as the golden set's manifest says, and archived roots of the set."""

import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.extensions.infos.exporting import CONVERTED_PREFIX, InfoFiles
from benchmark.extensions.infos.map_lines import PATCH_M
from benchmark.extensions.infos.repositories import REPOSITORIES, Part, RepositoryName
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256
from benchmark.untrusted.compressed import read_compressed_pickle, unpack_archive
from benchmark.untrusted.files import PROGRAM, read_file, to_one_line
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder

MANIFEST: Final = "manifest.json"
_ODD: Final = "make_odd.py"
_ODD_SHA256: Final = "4c47273b5acc593454cf60b25121388e358de834c286dd3e4ecedf99dc84dbfd"
_ARCHIVE: Final = re.compile(r"tables/[\w.-]+\.tar\.xz")
_OF_ANOTHER: Final = re.compile(r"those of ([\w.-]+?)\b")
_SEED: Final = re.compile(r"make_odd\.py \S+ \S+ (\d+)")
_LONGEST_RUN_S: Final = 120.0

Tolerances = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class GoldenFile:
    """One file of a converter, a compressed pickle; `counts` are infos of train and val.

    Keys `left_out` were taken out of its infos to save room.
    """

    repository: RepositoryName
    path: Path
    official_name: str
    counts: Mapping[str, int]
    left_out: frozenset[str]

    def read(self) -> dict[str, Any]:
        """Its content."""
        content: dict[str, Any] = read_compressed_pickle(self.path)
        if not all(isinstance(info, dict) for info in content["infos"]):
            raise ValueError(f"{self.path.name} does not hold a list of infos")
        return content


@dataclass(frozen=True, slots=True)
class GoldenRoot:
    """A root that files were made from; `sha256` is of its tables, by name, `tables` how they are to be had."""

    version: str
    tables: str
    recipe: str
    sha256: Mapping[str, str]
    files: tuple[GoldenFile, ...]

    def changed_tables(self, root: Path) -> dict[str, bool]:
        """Which tables of a root differ from those that the files were made from, by name."""
        folder = root / self.version
        return {name: file_sha256(folder / f"{name}.json") != value for name, value in self.sha256.items()}


@dataclass(frozen=True, slots=True)
class GoldenInfos:
    """A golden set: roots by name, tolerances by repository and keys."""

    folder: Path
    tolerances: Tolerances
    roots: Mapping[str, GoldenRoot]

    @classmethod
    def read(cls, golden: GoldenFolder) -> Self:
        """The set of a folder, as its manifest says."""
        manifest = golden.facts(MANIFEST)
        tolerances = {str(name): dict(limits) for name, limits in manifest["tolerance"].items()}
        roots = {str(name): _parse_root(golden.path, row) for name, row in manifest["roots"].items()}
        if not roots:
            raise ValueError(f"{MANIFEST} names no roots")
        return cls(golden.path, tolerances, roots)

    def unpack(self, name: str, folder: Path) -> Path:
        """Make a root from the set; one that is there already is taken as it is."""
        root = folder / name
        if root.exists():
            return root
        here = self.folder / "tables" / name
        if here.is_dir():
            return here
        words = self.roots[name].tables
        other, archive = _OF_ANOTHER.search(words), _ARCHIVE.match(words)
        if archive is not None:
            unpack_archive(self.folder / archive[0], folder)
            if not root.is_dir():
                raise ValueError(f"{archive[0]} holds no folder {name}")
            if other is not None and not (root / "maps").exists():
                (root / "maps").symlink_to((self.unpack(other[1], folder) / "maps").resolve())
            return root
        seed = _SEED.search(self.roots[name].recipe)
        if other is None or seed is None:
            raise ValueError(f"{MANIFEST} does not locate the tables of {name}")
        self._make_odd(self.unpack(other[1], folder), root, seed[1])
        return root

    def _make_odd(self, source: Path, root: Path, seed: str) -> None:
        path = self.folder / _ODD
        program = read_file(path, PROGRAM)
        if sha256(program).hexdigest() != _ODD_SHA256:
            raise InputError(
                f"{path} differs from the known program and is not run; review it, run it yourself, and put "
                f"its output into {self.folder / 'tables' / root.name}"
            )
        command = [sys.executable, "-I", "-", str(source.resolve()), str(root.resolve()), seed]
        try:
            subprocess.run(
                command, input=program, capture_output=True, check=True, timeout=_LONGEST_RUN_S, cwd=root.parent
            )
        except (subprocess.SubprocessError, OSError) as error:
            raise InputError(
                f"{path} fails on the tables of {source.name} ({to_one_line(error)}); fetch the set again"
            ) from error


def _parse_root(golden: Path, row: Mapping[str, Any]) -> GoldenRoot:
    files = tuple(
        GoldenFile(
            repository=REPOSITORIES[name].name,
            path=golden / _require_inside(file_row["path"]),
            official_name=str(file_row["official_name"]),
            counts={str(part): int(count) for part, count in file_row["infos_in"].items()},
            left_out=frozenset(map(str, file_row["left_out"])),
        )
        for name, file_row in row["files"].items()
    )
    hashes = {_require_inside(name): str(value) for name, value in row["fingerprint"]["sha256"].items()}
    return GoldenRoot(_require_inside(row["version"]), str(row["tables"]), str(row["recipe"]), hashes, files)


def _require_inside(name: Any) -> str:
    """A path below a folder; raises `ValueError` for any other."""
    path = Path(str(name))
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"{name} points outside the set")
    return str(name)


_MAPS: Final = "map_annos"
_CAMERAS: Final = ("cams",)
_LIMIT: Final = re.compile(r"<= *([0-9.]+e-?[0-9]+)")
_PATHS: Final = frozenset({"lidar_path", "data_path"})
_NUMBERS: Final = "iufb"
_NAMES_SHOWN: Final = 3


class InfoComparison:
    """Gathers the errors of each key over roots.

    ``tolerances`` are by repository and names of keys between commas: a number is a largest difference, of map elements
    a sentence says it, and all other keys must be equal.
    """

    def __init__(self, comparison: Comparison, tolerances: Tolerances) -> None:
        self._found = comparison
        self._limits = {name: _parse_limits(words) for name, words in tolerances.items()}

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
        self._compare_equal(reader.name, "name of the file", part is not None, root)
        counts = {name: len(infos) for name, infos in ours.parts.items()}
        self._compare_equal(reader.name, "number of infos", counts == dict(official.counts), root)
        top = list(content) == ["infos", "metadata"] and content["metadata"] == {"version": ours.version}
        self._compare_equal(reader.name, "top level", top, root)
        infos, golden = ours.parts.get(part, []) if part else [], content["infos"]
        order = [info["token"] for info in infos] == [info.get("token") for info in golden]
        self._compare_equal(reader.name, "order of infos", order, root)
        for info, expected in zip(infos, golden):
            place = f"{root}, sample {info['token'][:8]}"
            compared = {key: value for key, value in info.items() if key not in official.left_out}
            self._compare_equal(reader.name, "keys of an info", list(compared) == list(expected), place)
            for key in compared:
                if key in expected:
                    self._compare_value(reader.name, (key,), compared[key], expected[key], place)

    def _compare_value(self, reader: str, path: tuple[str, ...], ours: Any, golden: Any, where: str) -> None:
        name = ".".join(path)
        if path == (_MAPS,):
            self._compare_map_elements(reader, ours, golden, where)
        elif isinstance(ours, np.ndarray):
            self._array(reader, name, path[-1], ours, golden, where)
        elif isinstance(ours, dict) and isinstance(golden, dict):
            self._compare_equal(reader, f"keys of {path[0]}", list(ours) == list(golden), where)
            for key in ours:
                if key in golden:
                    # The cameras are one quantity, whichever it is.
                    self._compare_value(
                        reader, (*path, "*" if path == _CAMERAS else key), ours[key], golden[key], where
                    )
        elif isinstance(ours, list) and isinstance(golden, list) and any(isinstance(item, dict) for item in ours):
            self._compare_equal(reader, f"number of {name}", len(ours) == len(golden), where)
            for mine, theirs in zip(ours, golden):
                self._compare_value(reader, path, mine, theirs, where)
        elif path[-1] in _PATHS:
            same = isinstance(golden, str) and _strip_prefix(ours) == _strip_prefix(golden)
            self._compare_equal(reader, name, same, where)
        else:
            self._compare_equal(reader, name, type(ours) is type(golden) and bool(ours == golden), where)

    def _array(self, reader: str, name: str, key: str, ours: NDArray[Any], golden: Any, where: str) -> None:
        same = isinstance(golden, np.ndarray) and (ours.dtype, ours.shape) == (golden.dtype, golden.shape)
        self._compare_equal(reader, "dtypes and shapes", same, f"{where}, {name}")
        if not same:
            return
        limit = self._limits.get(reader, {}).get(key)
        if limit is None or ours.dtype.kind not in _NUMBERS:
            nan = ours.dtype.kind == "f"
            self._compare_equal(reader, name, bool(np.array_equal(ours, golden, equal_nan=nan)), where)
            return
        known = ~np.isnan(golden.astype(np.float64))
        self._compare_equal(
            reader, "places of NaN", bool(np.array_equal(known, ~np.isnan(ours.astype(np.float64)))), where
        )
        self._found.numbers(f"{reader}: {name}", ours[known], golden[known], limit, where=where)

    def _compare_map_elements(self, reader: str, ours: dict[int, list[Floats]], golden: Any, where: str) -> None:
        name = f"{reader}: {_MAPS}"
        same = (
            isinstance(golden, dict)
            and list(ours) == list(golden)
            and all(isinstance(golden[kind], list) for kind in ours)
            and all(map(_is_line, (line for kind in ours for line in golden[kind])))
        )
        self._compare_equal(reader, f"classes of {_MAPS}", same, where)
        if not same:
            return
        limit = self._limits.get(reader, {}).get(_MAPS, 0.0)
        for kind, lines in ours.items():
            self._compare_equal(
                reader, f"elements of {_MAPS}", len(lines) == len(golden[kind]), f"{where}, class {kind}"
            )
            for mine, theirs in zip(lines, golden[kind]):
                away = np.concatenate(
                    [_compute_distances(mine, theirs, limit), _compute_distances(theirs, mine, limit)]
                )
                self._found.errors(name, away, limit, where=f"{where}, class {kind}")

    def _compare_equal(self, reader: str, name: str, same: bool, where: str) -> None:
        self._found.verdicts(f"{reader}: {name}", not same, where=where)


def _parse_limits(words: Mapping[str, Any]) -> dict[str, float]:
    """Largest differences by key."""
    limits: dict[str, float] = {}
    for names, limit in words.items():
        map_limit = _LIMIT.search(limit) if isinstance(limit, str) and names == _MAPS else None
        if map_limit is not None or isinstance(limit, int | float):
            limits |= dict.fromkeys(map(str.strip, names.split(",")), float(map_limit[1] if map_limit else limit))
    return limits


def _strip_prefix(path: str) -> str:
    return path.removeprefix(CONVERTED_PREFIX)


def _is_line(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.ndim == 2 and value.shape[1:] == (2,)


def _compute_distances(line: Floats, other: Floats, margin_m: float) -> Floats:
    """How far the vertices of a line, and the middles between them, are from another.

    Points on the edge of the patch are left out: the last bit decides their element. Middles are asked because a
    straight line may begin and end there.
    """
    points = np.concatenate([line, 0.5 * (line[1:] + line[:-1])])
    inside = (np.abs(np.abs(points) - np.array(PATCH_M) / 2) > margin_m).all(axis=1)
    to = shapely.LineString(other) if len(other) > 1 else shapely.multipoints(other)
    return np.asarray(shapely.distance(shapely.points(points[inside]), to))
