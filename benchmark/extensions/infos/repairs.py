"""Repairs: the smallest changes that let official readers work on other roots as on nuScenes itself.

What cannot be repaired is refused before anything is written, or reported with the export.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from benchmark.constants import CAMERA_NAMES, NUMBERED_CATEGORIES, OFFICIAL_LOCATIONS
from benchmark.datasets.map_layers import find_expansion_file
from benchmark.errors import InputError
from benchmark.extensions.infos.repositories import Repository, RepositoryName
from benchmark.extensions.infos.scene_infos import Info, has_cameras
from benchmark.extensions.infos.scene_rows import SceneTableRows
from benchmark.report.words import pluralise

DEFAULT_VISIBILITY: Final = 4
"""nuScenes' level of what is fully visible."""
_NEEDS_FUTURE: Final = 2
AROUND_M: Final = 50.0
"""UniAD's reader takes map elements and drivable cells within about so far."""
_TRAINED_SIZE: Final = (1600, 900)
_MOTION_KEYS: Final[Mapping[RepositoryName, tuple[str, ...]]] = {
    "uniad": ("can_bus",),
    "vad": ("can_bus", "gt_ego_lcf_feat"),
    "sparsedrive": ("ego_status",),
}
_SIZE_OPTIONS: Final = (
    "data build, data import and generate draw it with --size {size}, generate --renderer magicdrive with --image-size "
    "{size}"
)

_NO_NETWORK: Final = "planning metrics open none; --planning-only leaves this out"


@dataclass(frozen=True, slots=True)
class ConverterDifference:
    """Deviation of an export from the converter; `why` is how official code behaves without it.

    `scenes` have the amount where there is one; empty for all.
    """

    what: str
    why: str
    keys: tuple[str, ...]
    scenes: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """JSON values."""
        return {**asdict(self), "keys": list(self.keys), "scenes": dict(self.scenes)}


def require_cameras(rows: SceneTableRows) -> None:
    """Refuse scenes without one of the six cameras, which no converter writes either."""
    for sample in rows.samples:
        missing = [name for name in CAMERA_NAMES if name not in rows.key_frames[sample["token"]]]
        if missing:
            other = "" if has_cameras(rows) else ", or leave --as-converted out"
            raise InputError(
                f"{rows.name} has no image of {missing[0]} at sample {sample['token']}, and info files name those of "
                f"all six cameras; build the data set with images (--renderer schematic or magicdrive){other}"
            )


def require_usable(root: Path, repository: Repository, rows: SceneTableRows, *, images: bool) -> None:
    """Refuse what official code would fail at: no map, short scenes, and missing files, if ``images`` are opened."""
    _require_map(root, rows)
    if len(rows.samples) < _NEEDS_FUTURE:
        raise InputError(
            f"{rows.name} has only one sample, which official code does not evaluate; leave the scene out with --split"
        )
    if not images or not has_cameras(rows):
        return
    require_cameras(rows)
    for sample in rows.samples:
        for name in CAMERA_NAMES:
            image = rows.key_frames[sample["token"]][name]["filename"]
            _require_file(root, image, "write the images, name the root that has them, or add --planning-only")
        if repository.name == "vad":
            _require_file(root, rows.lidar(sample)["filename"], "VAD opens it; an empty file is enough")


def _require_map(root: Path, rows: SceneTableRows) -> None:
    if rows.location not in OFFICIAL_LOCATIONS:
        raise InputError(
            f"{rows.name} lies in {rows.location}, and official code has only maps of {', '.join(OFFICIAL_LOCATIONS)}; "
            "leave the scene out with --split, or rename its location to one of these in log.json and maps/expansion"
        )
    if find_expansion_file(root, rows.location) is None:
        raise InputError(
            f"{rows.name} lies in {rows.location}, and {root} has no maps/expansion/{rows.location}.json, which "
            "official code opens; fetch the map expansion or make it again"
        )


def _require_file(root: Path, name: str, advice: str) -> None:
    if not (root / name).is_file():
        raise InputError(f"{root / name} named in the tables is missing; {advice}")


class SameTimeError(InputError):
    """Scenes lie in one another's time, which only an export that is not ``as_converted`` moves apart."""


def require_apart(infos: Sequence[Info], names: Mapping[str, str]) -> None:
    """Refuse scenes that lie in one another's time with a `SameTimeError`; ``names`` are by token.

    Readers sort by time: SparseDrive's planning metric then looks for future boxes in other scenes and fails, and the
    memory of all networks is of the wrong scene.
    """
    times: dict[str, list[int]] = {}
    for info in infos:
        times.setdefault(info["scene_token"], []).append(info["timestamp"])
    ordered = sorted((min(of_scene), names[token], max(of_scene)) for token, of_scene in times.items())
    for (_, first, ended), (begins, second, _) in pairwise(ordered):
        if begins <= ended:
            raise SameTimeError(
                f"{first} and {second} have the same time, as variants of one recording do, and official code sorts "
                "by time, so that its planning metric fails on what converters write; run it without --as-converted"
            )


def shift_times(infos: Iterable[Info], shift_us: int) -> None:
    """Move all times of a scene's infos by microseconds, so that differences between them stay."""
    for info in infos:
        for timed in (info, *info["cams"].values(), *info["sweeps"]):
            timed["timestamp"] += shift_us


def describe_shifts(shifts: Mapping[str, int]) -> ConverterDifference:
    """The departure that moved times are."""
    return ConverterDifference(
        f"times of {pluralise(len(shifts), 'scene')} are shifted, with their cameras and sweeps (the tables keep "
        "the original times; readers use only order and differences)",
        "readers sort by time: variants of one recording share their times and would be interleaved by sample, so "
        "temporal models would restart at each sample or mix variants",
        ("timestamp", "cams.*.timestamp", "sweeps.*.timestamp"),
        {name: {"shift_us": shift} for name, shift in sorted(shifts.items())},
    )


def build_category_numbers(own: Mapping[str, int]) -> dict[str, int]:
    """VAD's numbers of categories: rows of the table of 32, then names that it lacks, which no code counts."""
    numbers = {name: number for number, name in enumerate(NUMBERED_CATEGORIES)}
    return {name: numbers.get(name, len(numbers) + number) for name, number in own.items()}


def describe_category_numbers(own: Mapping[str, int]) -> list[ConverterDifference]:
    """The departure that other numbers than the table's are; none where the table has them itself."""
    changed = {name: number for name, number in build_category_numbers(own).items() if own[name] != number}
    if not changed:
        return []
    return [
        ConverterDifference(
            "categories have the numbers of nuScenes' table of 32 rows, not their rows in this root's category.json of "
            f"{len(own)}",
            "VAD's collision rule takes 2-8 for people and 14-23 for vehicles; by this root's rows adults and bicycles "
            "would be neither, and barriers people",
            ("gt_agent_lcf_feat[:, 8]",),
        )
    ]


def describe_paths(prefix: str) -> ConverterDifference:
    """The departure that absolute names of files are."""
    return ConverterDifference(
        f"files are named from {prefix} on",
        "the converters' names begin with ./data/nuscenes/, which UniAD joins with its data_root once more",
        ("lidar_path", "cams.*.data_path", "sweeps.*.data_path"),
    )


def describe_can_bus_names(repository: Repository, names: Collection[str]) -> ConverterDifference:
    """The departure that the CAN bus of names is which the devkit refuses."""
    return ConverterDifference(
        "the CAN bus is read from the root's own files",
        "the devkit accepts only names like scene-0061; other scenes would silently get zeros as model input",
        _MOTION_KEYS[repository.name],
        dict.fromkeys(sorted(names)),
    )


def describe_scene_choice(split: str, elsewhere: Collection[str], others: int) -> list[ConverterDifference]:
    """The departure that another choice of scenes is than the converter's by official names."""
    differences = []
    if elsewhere:
        differences.append(
            ConverterDifference(
                f"scenes of {split} that nuScenes names among its training scenes are in the val file",
                "official configurations evaluate only the val file",
                (),
                dict.fromkeys(sorted(elsewhere)),
            )
        )
    if others:
        differences.append(
            ConverterDifference(
                f"{pluralise(others, 'scene')} of the root that {split} does not have are left out",
                "the converters put every scene into one of their two files",
                (),
            )
        )
    return differences


def describe_default_visibility(boxes: Mapping[str, int]) -> ConverterDifference:
    """The departure that a visibility is which the root does not know."""
    return ConverterDifference(
        f"boxes without a visibility have level {DEFAULT_VISIBILITY}",
        "the converter fails on them",
        ("visibility_tokens",),
        dict(sorted(boxes.items())),
    )


def describe_empty_maps(cities: Sequence[str]) -> ConverterDifference:
    """The departure that maps are of cities that do not occur."""
    return ConverterDifference(
        f"the folder nuscenes/ beside the infos has empty maps of {', '.join(cities)}",
        "official code opens the maps of all four cities when it starts",
        (),
    )


@dataclass(slots=True)
class ExportObservations:
    """Observations made while infos were written; `off_the_map` counts samples with nothing of the map around them.

    `without_visibility` are boxes, by scene, whose visibility is no level; `without_cameras` counts scenes.
    """

    sizes: set[tuple[int, int]] = field(default_factory=set)
    without_points: int = 0
    off_the_map: int = 0
    without_can_bus: list[str] = field(default_factory=list)
    without_visibility: dict[str, int] = field(default_factory=dict)
    without_cameras: int = 0


def list_unrepaired(repository: Repository, seen: ExportObservations) -> list[str]:
    """Sentences on what a reader of the results should know, since no info file can change it."""
    last = repository.name == "sparsedrive"
    sentences = [
        "detection, tracking and motion are evaluated against nuScenes' own lists of scenes, in which those of other "
        "data sets are not: "
        + (
            "switch them off (with_det, with_tracking and with_motion False), planning comes last"
            if last
            else "their part of the evaluation ends with an error, after planning"
        )
    ]
    other = sorted(size for size in seen.sizes if size != _TRAINED_SIZE)
    if other:
        drawn, trained = (
            ", ".join(f"{width}x{height}" for width, height in sizes) for sizes in (other, [_TRAINED_SIZE])
        )
        crops = f", and the code of {repository.title} crops as if they were, so that its networks would see black"
        sentences.append(
            f"images are {drawn}, but published networks were trained on {trained}"
            f"{crops if repository.image_size == _TRAINED_SIZE else ''} ({_SIZE_OPTIONS.format(size=trained)}; "
            f"{_NO_NETWORK})"
        )
    if seen.without_cameras:
        scenes = pluralise(seen.without_cameras, "scene has", "scenes have")
        sentences.append(
            f"{scenes} no images (--renderer none), so that no network can run on the infos ({_NO_NETWORK})"
        )
    if seen.without_points:
        boxes = pluralise(seen.without_points, "box has", "boxes have")
        known = (
            "UniAD uses these objects only in its occupancy"
            if repository.name == "uniad"
            else ("the evaluation ignores these objects at these samples")
        )
        sentences.append(f"{boxes} no lidar point: {known}")
    if seen.without_can_bus:
        scenes = pluralise(len(seen.without_can_bus), "scene has", "scenes have")
        sentences.append(
            f"{scenes} no CAN bus, so models get zeros for the motion of the ego: {', '.join(seen.without_can_bus[:3])}"
        )
    if seen.off_the_map:
        sentences.append(
            f"{pluralise(seen.off_the_map, 'sample has', 'samples have')} no map elements within {AROUND_M:g} m, "
            "on which UniAD's reader fails"
        )
    return sentences
