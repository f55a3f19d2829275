"""Export of info files: scenes of a split, their infos, repairs, files; nothing is written before all is computed."""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import shapely

from benchmark.datasets.drawn_later import Artist
from benchmark.datasets.map_layers import find_expansion_file, read_road_map
from benchmark.datasets.scene_names import PROVENANCE, find_table_name_below, is_devkit_name
from benchmark.datasets.schema import FaultList, StrictFaultList
from benchmark.datasets.split_names import compute_shifts_us, find_default_split, read_splits, select_scenes
from benchmark.datasets.tables import find_variant_folders, find_version
from benchmark.errors import InputError
from benchmark.extensions.infos import repairs
from benchmark.extensions.infos.boxes import SceneBoxes
from benchmark.extensions.infos.ego_trajectory import (
    ConverterCanMessages,
    EgoTrajectory,
    has_can_bus,
)
from benchmark.extensions.infos.map_lines import MapLines
from benchmark.extensions.infos.repositories import (
    TEST,
    Part,
    Repository,
    find_repository,
    list_official_training_scenes,
    require_version,
)
from benchmark.extensions.infos.scene_infos import Info, SceneSources, build_scene_infos, has_cameras, is_level
from benchmark.extensions.infos.scene_rows import InfoTables, SceneTableRows
from benchmark.extensions.infos.stand_in_root import StandInRoot, find_missing_cities
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import read_cached_json, read_json, write_bytes, write_json
from benchmark.report.words import pluralise

CONVERTED_PREFIX: Final = "./data/nuscenes/"
"""Prefix of the converters' file names when called as documented."""
PROTOCOL: Final = 2
"""Of pickles, as the official converters write them."""


@dataclass(frozen=True, slots=True)
class InfoSettings:
    """Settings of an export of info files.

    Attributes:
        repository: ``uniad``, ``vad`` or ``sparsedrive`` (DiffusionDrive reads the same).
        version: Version folder; needed only where a root has several.
        split: Split; where none is named ``val`` if the root has it, else its only one.
        as_converted: Exactly what the converter would write of the whole root: nothing is cured, and of what it accepts
            only scenes that have the same time are refused.
        root_as: Where the root is for the code that will read the files, if not where it is here.
        planning_only: No network will open images: nothing is asked or said of them.
    """

    repository: str
    version: str | None = None
    split: str | None = None
    as_converted: bool = False
    root_as: str | None = None
    planning_only: bool = False


@dataclass(frozen=True, slots=True)
class ExportedInfos:
    """Written files with the number of infos in each, departures from the converter's, and faults that stay."""

    files: dict[Path, int]
    differences: tuple[repairs.ConverterDifference, ...] = ()
    unrepaired: tuple[str, ...] = ()


@dataclass
class InfoFiles:
    """Infos of a root by file, before they are written; `scene_names` by token."""

    version: str
    scene_names: dict[str, str]
    parts: dict[Part, list[Info]] = field(default_factory=dict)
    differences: list[repairs.ConverterDifference] = field(default_factory=list)
    unrepaired: list[str] = field(default_factory=list)


def export_infos(root: Path, to: Path, settings: InfoSettings) -> ExportedInfos:
    """Write info files, and beside them what official code needs and what is departed from.

    Args:
        root: Root of a data set, or a folder of variant roots, each of which gets a folder of its own.
        to: Folder to write to.
        settings: Settings of the export.

    Returns:
        The written files.

    Raises:
        InputError: If there is no such data set or split, or it holds something that official code would fail at or
            see nothing of; `repairs.SameTimeError` if, ``as_converted``, scenes of the val file have the same time.
    """
    reader = find_repository(settings.repository)
    variants = find_variant_folders(root)
    roots = {to / name: root / name for name in variants} or {to: root}
    settings_by_target = {target: _narrow_settings(target.name, settings) if variants else settings for target in roots}
    infos_by_target = {
        target: build_info_files(source, reader, settings_by_target[target]) for target, source in roots.items()
    }
    if settings.as_converted:
        for infos in infos_by_target.values():
            repairs.require_apart(infos.parts.get("val", []), infos.scene_names)
    folders = {
        target: _build_stand_in_root(reader, roots[target], target, infos, settings_by_target[target])
        for target, infos in infos_by_target.items()
    }
    files: dict[Path, int] = {}
    for target, infos in infos_by_target.items():
        files |= _write(target, reader, infos)
    for target, folder in folders.items():
        folder.write()
        _write_differences(target, reader, infos_by_target[target], as_converted=settings.as_converted)
    differences = tuple(difference for infos in infos_by_target.values() for difference in infos.differences)
    return ExportedInfos(
        files,
        differences,
        tuple(dict.fromkeys(sentence for infos in infos_by_target.values() for sentence in infos.unrepaired)),
    )


def build_info_files(root: Path, reader: Repository, settings: InfoSettings) -> InfoFiles:
    """Infos of one root; arguments and errors as in `export_infos`, which writes them."""
    version = find_version(root, settings.version)
    require_version(version, str(root))
    if settings.as_converted:
        return _InfoConverter(root, version, reader, settings).files()
    return _RepairingInfoConverter(root, version, reader, settings).files()


class _InfoConverter:
    """A root as a converter writes it."""

    def __init__(self, root: Path, version: str, reader: Repository, settings: InfoSettings) -> None:
        self.root, self.reader, self.settings = root, reader, settings
        cured = not settings.as_converted
        self.tables = InfoTables(root, version, StrictFaultList(folder=root / version) if cured else FaultList())
        self.found = InfoFiles(version, {row["token"]: row["name"] for row in self.tables.scenes})
        self.prefix = CONVERTED_PREFIX if settings.root_as is None else f"{settings.root_as.rstrip('/')}/"
        self._maps: dict[str, MapLines] = {}

    def files(self) -> InfoFiles:
        """All infos."""
        training = list_official_training_scenes(self.found.version)
        names = [row["name"] for row in self.tables.scenes]
        if self.settings.split is not None and set(self._split()[1]) != set(names):
            raise InputError(
                f"--as-converted takes the whole root, as the converters do, and {self.root} has other scenes than "
                f"those of split {self.settings.split}; leave --split or --as-converted out"
            )
        self._put(names, lambda name: "train" if name in training else "val")
        trained = training & set(names)
        self.found.unrepaired = [f"as converted: {found.why}" for found in self._list_value_differences(names)]
        if trained and self.found.version != TEST:
            self.found.unrepaired.append(
                f"as converted: {pluralise(len(trained), 'scene')} of nuScenes' training scenes are in the train file, "
                "and official configurations evaluate only the val file"
            )
        if self.found.version == TEST:
            self.found.parts = {"test": self.found.parts["train"]}
        return self.found

    def _split(self) -> tuple[str, tuple[str, ...]]:
        """The split that is exported, and its scenes."""
        present = [scene["name"] for scene in self.tables.scenes]
        custom = read_splits(self.root, self.found.version)
        provenance = self.root / self.found.version / PROVENANCE
        provenance_values = read_json(provenance) if provenance.is_file() else None
        built_as = provenance_values.get("split") if isinstance(provenance_values, dict) else None
        split = self.settings.split or find_default_split(present, custom, where=str(self.root), built_as=built_as)
        return split, select_scenes(split, present, custom, where=str(self.root), built_as=built_as)

    def _list_value_differences(self, names: Sequence[str]) -> list[repairs.ConverterDifference]:
        """Values of scenes that the converter gets wrong: the motion of suffixed names, the numbers of categories."""
        rows = {name: find_table_name_below(self.root, name) for name in names}
        refused = {name for name in names if not is_devkit_name(rows[name]) and has_can_bus(self.root, name)}
        differences = [repairs.describe_can_bus_names(self.reader, refused)] if refused else []
        if self.reader.name == "vad":
            differences += repairs.describe_category_numbers(self.tables.category_numbers)
        return differences

    def _put(self, names: Sequence[str], part_of: Callable[[str], Part]) -> None:
        """Make the infos of scenes and put them into files, each in the order of the sample table."""
        numbered: list[tuple[int, Part, Info]] = []
        scenes = track_progress(
            self.tables.of_scenes(frozenset(names)), total=len(names), label="infos", count=CountedUnits("scene")
        )
        for rows in scenes:
            part = part_of(rows.name)
            numbered += [(number, part, info) for number, info in zip(rows.sample_numbers, self._scene(rows))]
        self.found.parts = {"train": [], "val": []}
        frame = 0
        for _, part, info in sorted(numbered, key=lambda entry: entry[0]):
            if self.reader.has_can_bus:
                info["frame_idx"] = frame
                frame = frame + 1 if info["next"] else 0
            self.found.parts[part].append(info)

    def _scene(self, rows: SceneTableRows) -> list[Info]:
        if self.reader.name == "vad" and len(rows.samples) < 2:
            raise InputError(f"{rows.name} has only one sample, on which VAD's converter fails; leave the scene out")
        if self.settings.as_converted or has_cameras(rows):
            repairs.require_cameras(rows)
        sources = SceneSources(
            rows=rows,
            boxes=SceneBoxes.of(rows),
            drive=EgoTrajectory.of(rows),
            can=self._can_bus(rows),
            map_lines=self._map(rows) if self.reader.name == "sparsedrive" else None,
            prefix=self.prefix,
            category_numbers=self._category_numbers(),
            default_visibility=None if self.settings.as_converted else repairs.DEFAULT_VISIBILITY,
        )
        return list(build_scene_infos(self.reader, self.found.version, sources))

    def _can_bus(self, rows: SceneTableRows) -> ConverterCanMessages:
        return ConverterCanMessages.read(self.root, rows.name, as_converted=self.settings.as_converted)

    def _category_numbers(self) -> dict[str, int]:
        return self.tables.category_numbers

    def _map(self, rows: SceneTableRows) -> MapLines:
        if rows.location not in self._maps:
            path = find_expansion_file(self.root, rows.location)
            if path is None:
                raise InputError(
                    f"{rows.name} lies in {rows.location}, and {self.root} has no maps/expansion/{rows.location}.json, "
                    "the source of map elements; fetch the map expansion or make it again"
                )
            self._maps[rows.location] = MapLines(path)
        return self._maps[rows.location]


class _RepairingInfoConverter(_InfoConverter):
    """The same with what official code trips on cured, and refused where it cannot be."""

    def __init__(self, root: Path, version: str, reader: Repository, settings: InfoSettings) -> None:
        super().__init__(root, version, reader, settings)
        here = settings.root_as if settings.root_as is not None else str(root.resolve())
        self.prefix = f"{here.rstrip('/')}/"
        self._artist = Artist.of(root, read_cached_json(root / version / PROVENANCE))
        self._times: list[tuple[str, int, int]] = []
        self._infos: dict[str, list[Info]] = {}
        if not Path(here).is_absolute():
            raise InputError(f"--root-as {here} must be an absolute path; file names begin with it")
        self._seen = repairs.ExportObservations()
        self._surroundings: dict[str, shapely.Geometry] = {}

    def files(self) -> InfoFiles:
        """Infos of the split, all in the file that official configurations evaluate."""
        split, names = self._split()
        self._put(names, lambda _: "val")
        shifts = compute_shifts_us(self._times)
        for name, shift in shifts.items():
            repairs.shift_times(self._infos[name], shift)
        if self.found.version == TEST:
            self.found.parts = {"test": self.found.parts["val"]}
        self.found.differences = self._list_differences(split, names, shifts)
        self.found.unrepaired = repairs.list_unrepaired(self.reader, self._seen)
        return self.found

    def _scene(self, rows: SceneTableRows) -> list[Info]:
        images = not self.settings.planning_only
        if images and self._artist is not None and has_cameras(rows):
            named = (row for channels in rows.key_frames.values() for row in channels.values())
            self._artist.draw(rows.name, (self.root / row["filename"] for row in named), sweeps=False)
        repairs.require_usable(self.root, self.reader, rows, images=images)
        infos = super()._scene(rows)
        times = [sample["timestamp"] for sample in rows.samples]
        self._times.append((rows.name, min(times), max(times)))
        self._infos[rows.name] = infos
        observations = self._seen
        if images:
            observations.sizes.update((row["width"], row["height"]) for row in rows.data.values() if row["width"])
            observations.without_cameras += not has_cameras(rows)
        observations.without_points += sum(row["num_lidar_pts"] == 0 for row in rows.annotations.values())
        if not self._can_bus(rows).pose:
            observations.without_can_bus.append(rows.name)
        unknown = sum(not is_level(row["visibility_token"]) for row in rows.annotations.values())
        if unknown:
            observations.without_visibility[rows.name] = unknown
        if self.reader.name == "uniad":
            observations.off_the_map += self._samples_off_the_map(rows)
        return infos

    def _samples_off_the_map(self, rows: SceneTableRows) -> int:
        """Samples with no drivable area around the lidar; where there is some, there are edges of it."""
        if rows.location not in self._surroundings:
            path = find_expansion_file(self.root, rows.location)
            area = read_road_map(path).drivable_area if path is not None else shapely.MultiPolygon()
            shapely.prepare(area)
            self._surroundings[rows.location] = area
        places = shapely.points(EgoTrajectory.of(rows).origin[:, :2])
        return int((~shapely.dwithin(self._surroundings[rows.location], places, repairs.AROUND_M)).sum())

    def _category_numbers(self) -> dict[str, int]:
        return repairs.build_category_numbers(super()._category_numbers())

    def _list_differences(
        self, split: str, names: Sequence[str], shifts: dict[str, int]
    ) -> list[repairs.ConverterDifference]:
        training = list_official_training_scenes(self.found.version)
        others = len(self.tables.scenes) - len(names)
        differences = [
            repairs.describe_paths(self.prefix),
            *repairs.describe_scene_choice(split, training & set(names), others),
        ]
        if shifts:
            differences.append(repairs.describe_shifts(shifts))
        differences += self._list_value_differences(names)
        if self.reader.name == "uniad" and self._seen.without_visibility:
            differences.append(repairs.describe_default_visibility(self._seen.without_visibility))
        cities = find_missing_cities(self.root)
        if cities:
            differences.append(repairs.describe_empty_maps(cities))
        return differences


def _narrow_settings(variant: str, settings: InfoSettings) -> InfoSettings:
    """Settings of one of several roots that lie side by side."""
    return settings if settings.root_as is None else replace(settings, root_as=f"{settings.root_as}/{variant}")


def _build_stand_in_root(
    reader: Repository, root: Path, to: Path, infos: InfoFiles, settings: InfoSettings
) -> StandInRoot:
    """VAD looks for its info files in the root, the others beside it."""
    beside = [reader.file_name(infos.version, part) for part in infos.parts] if reader.name == "vad" else []
    root_as = settings.root_as if settings.root_as is None or Path(settings.root_as).is_absolute() else None
    return StandInRoot.of(root, to, infos.version, root_as=root_as, beside=beside)


def _write(to: Path, reader: Repository, info_files_of_root: InfoFiles) -> dict[Path, int]:
    files = {}
    for part, infos in info_files_of_root.parts.items():
        path = to / reader.file_name(info_files_of_root.version, part)
        content = {"infos": infos, "metadata": {"version": info_files_of_root.version}}
        write_bytes(path, pickle.dumps(content, protocol=PROTOCOL))
        files[path] = len(infos)
    return files


def _write_differences(to: Path, reader: Repository, info_files_of_root: InfoFiles, *, as_converted: bool) -> None:
    path = to / f"{reader.name}_departures.json"
    if as_converted:
        # Of an earlier export to the same folder.
        path.unlink(missing_ok=True)
        return
    differences = [difference.as_json() for difference in info_files_of_root.differences]
    report = {"for": reader.title, "departures": differences, "not_cured": info_files_of_root.unrepaired}
    write_json(path, report)
