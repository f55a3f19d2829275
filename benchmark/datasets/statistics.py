"""A data set in numbers: the paper's table, what generated adversaries do where, its scenes and splits.

Reads tables and small files without the devkit, so that maps and images may be missing.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.datasets.scene_names import PROVENANCE, find_name_fault, find_table_name, rename_scenes
from benchmark.datasets.split_names import read_splits, select_scenes
from benchmark.datasets.split_reviews import join_reviews, read_root_review, scene_tokens
from benchmark.datasets.stored_rows import count_rows
from benchmark.datasets.tables import find_variant_folders, find_version
from benchmark.errors import InputError
from benchmark.machine.storage import read_cached_json, read_json
from benchmark.published import ADV_NUSC
from benchmark.records.attempts import ManoeuvreLabels, list_stored_labels
from benchmark.records.review import SplitReview, read_review
from benchmark.records.statistics import ManoeuvreRow, Quantiles, SplitStatistics, TableCounts
from benchmark.records.store import validate_stored
from benchmark.report.table import build_table


def list_scenes(root: Path, split: str | None = None, *, version: str | None = None) -> tuple[str, ...]:
    """Names of scenes as an opened data set has them (`NuScenesData.scene_names`); all where ``split`` is ``None``."""
    if split is not None:
        review = read_split_review(root, split, version=version)
        return review.kept(tuple(name for name in scene_tokens(root, version) if name in set(review.named)))
    return tuple(scene_tokens(root, version))


def read_split_review(root: Path, split: str, *, version: str | None = None) -> SplitReview:
    """Review of a split (`benchmark.datasets.nuscenes.NuScenesData.review`)."""
    variants = find_variant_folders(root)
    if not variants:
        return _read_root_review(root, split, version)
    parts = {folder: _read_root_review(root / folder, split, version) for folder in variants}
    of_split = {name for folder, part in parts.items() for name in part.under(folder).named}
    tokens = {name: token for name, token in scene_tokens(root, version).items() if name in of_split}
    return join_reviews(parts, read_review(root), tokens)


def _read_root_review(root: Path, split: str, version: str | None) -> SplitReview:
    version, tokens = find_version(root, version), scene_tokens(root, version)
    provenance = read_cached_json(root / version / PROVENANCE)
    built_as = provenance.get("split") if isinstance(provenance, dict) else None
    names = select_scenes(split, tuple(tokens), read_splits(root, version), where=str(root), built_as=built_as)
    return read_root_review(root, {name: tokens[name] for name in names}, provenance, split)


_QUANTILES: Final = {"least": 0.0, "tenth": 0.1, "median": 0.5, "ninetieth": 0.9, "most": 1.0}


class DataSetStatistics(SplitStatistics):
    """Numbers that `statistics` found in the data set at ``root``."""

    root: str

    def as_json(self) -> dict[str, Any]:
        """Everything as JSON values, with the published table beside."""
        return self.model_dump()

    def plain(self) -> str:
        """Everything as text tables."""
        which = "all scenes" if self.split is None else f"split {self.split}"
        tables = [_count_rows(self.counts)]
        if self.adversaries_per_scene:
            tables.append([("adversaries", "scenes"), *sorted(self.adversaries_per_scene.items())])
        if self.labelled:
            tables += [_manoeuvre_rows(self.manoeuvres, self.places), _quantile_rows(self)]
        texts = ([tuple(map(str, row)) for row in rows] for rows in tables)
        blocks = (build_table("", "", head, rows).plain() for head, *rows in texts)
        return "\n".join([f"{self.root}, {which}\n", *blocks]).removesuffix("\n")


@dataclass(frozen=True, slots=True)
class _Root:
    """One root, opened as far as needed: names in the tables of its scenes that count, and how scenes were made."""

    folder: Path
    scenes: frozenset[str] | None
    made: Mapping[str, Any]


def statistics(root: Path, *, split: str | None = None, version: str | None = None) -> DataSetStatistics:
    """Count a data set: tables always, manoeuvres where ``challenger.json`` has labels.

    Args:
        root: A nuScenes-format root, or a folder of variant roots, which are summed. Only tables are read.
        split: Split to count, by the rules of `select_scenes`, without scenes that inspectors rejected; ``None`` for
            every row of the tables.
        version: Version folder; needed only where there are several.

    Returns:
        The numbers.

    Raises:
        InputError: If there is no such data set or split, or a table is missing, broken or lacks a field.
    """
    parts = _roots(root, split, version)
    counted = [count_rows(part.folder, part.scenes) for part in parts]
    total = TableCounts(**{name: sum(getattr(counts, name) for counts in counted) for name in TableCounts.model_fields})
    labels = [label for part in parts for label in _labels_of(part)]
    adversaries = Counter(len(entry.get("adversaries", ())) for part in parts for entry in part.made.values())
    reached = [label.time_to_collision.seconds for label in labels if label.time_to_collision is not None]
    return DataSetStatistics(
        root=str(root),
        split=split,
        counts=total,
        adversaries_per_scene=dict(sorted(adversaries.items())) if any(adversaries) else {},
        labelled=len(labels),
        manoeuvres=_rows_of(labels),
        places=_falling(Counter(label.place for label in labels)),
        gap_m=_quantiles([label.closest_approach.gap_m for label in labels]),
        time_to_collision_s=_quantiles(reached),
        within_5_s=len(reached),
    )


def _roots(root: Path, split: str | None, version: str | None) -> list[_Root]:
    folders = find_variant_folders(root)
    if split is None:
        return [_open(folder, version, None) for folder in ([root / name for name in folders] or [root])]
    listed = list_scenes(root, split, version=version)
    if not folders:
        return [_open(root, version, listed)]
    return [
        _open(root / folder, version, [name.partition("/")[2] for name in listed if name.startswith(f"{folder}/")])
        for folder in folders
    ]


def _open(root: Path, version: str | None, names: Sequence[str] | None) -> _Root:
    version = find_version(root, version)
    folder = root / version
    scene_reports: dict[str, Any] = _provenance(folder / PROVENANCE).get("scenes", {})
    if names is None:
        return _Root(folder, None, scene_reports)
    rows = frozenset(find_table_name(folder, name) for name in names)
    return _Root(folder, rows, {name: scene_reports[name] for name in names if name in scene_reports})


def _provenance(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    value = read_json(path)
    scene_reports = value.get("scenes") if isinstance(value, dict) else None
    if not isinstance(scene_reports, dict) or not all(
        isinstance(entry, dict) and isinstance(entry.get("adversaries", []), list) for entry in scene_reports.values()
    ):
        raise InputError(f"{path} must be an object with its scenes; write the data set again")
    if wrong := find_name_fault(value):
        raise InputError(f"{path}: {wrong}; write the data set again")
    return rename_scenes(value)


def _labels_of(part: _Root) -> Iterator[ManoeuvreLabels]:
    def labels(scene: str, stored: Any) -> ManoeuvreLabels:
        whose = f"{part.folder / PROVENANCE}: the labels of {scene}"
        return validate_stored(
            ManoeuvreLabels.model_validate,
            stored,
            lambda where, _: f"{whose} lack a proper {where or 'content'}; generate the data set again",
        )

    for name, entry in part.made.items():
        yield from (labels(name, stored_label) for stored_label in list_stored_labels(entry.get("report")))


def _rows_of(labels: Sequence[ManoeuvreLabels]) -> tuple[ManoeuvreRow, ...]:
    primary = Counter(label.manoeuvre for label in labels)
    occurred = Counter(kind for label in labels for kind in {item.kind for item in label.occurred})
    rows = []
    for kind in sorted({*primary, *occurred}, key=lambda kind: (-primary[kind], -occurred[kind], kind)):
        labels_of_kind = [label for label in labels if label.manoeuvre == kind]
        gaps = [label.closest_approach.gap_m for label in labels_of_kind]
        places = _falling(Counter(label.place for label in labels_of_kind))
        rows.append(
            ManoeuvreRow(
                manoeuvre=kind,
                primary=primary[kind],
                occurred=occurred[kind],
                places=places,
                median_gap_m=float(np.median(gaps)) if gaps else None,
            )
        )
    return tuple(rows)


def _falling(counts: Counter[str]) -> dict[str, int]:
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _quantiles(values: Sequence[float]) -> Quantiles | None:
    if not values:
        return None
    return Quantiles(**{name: float(np.quantile(values, level)) for name, level in _QUANTILES.items()})


def _count_rows(counts: TableCounts) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = [("", "here", "Adv-nuSc as published")]
    for name, published in ADV_NUSC.items():
        rows.append((name.replace("_", " "), f"{getattr(counts, name):,}", f"{published:,}"))
    return rows


def _manoeuvre_rows(table: Sequence[ManoeuvreRow], places: Mapping[str, int]) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = [("manoeuvre", "primary", "occurred", *places, "median gap")]
    for row in table:
        gap = "-" if row.median_gap_m is None else f"{row.median_gap_m:.2f} m"
        rows.append((row.manoeuvre, row.primary, row.occurred, *(row.places.get(place, 0) for place in places), gap))
    return [*rows, ("all", sum(row.primary for row in table), "", *places.values(), "")]


def _quantile_rows(numbers: DataSetStatistics) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = [("", "of", *(name for name in _QUANTILES))]
    for label, count, quantiles, digits in (
        ("smallest gap, m", numbers.labelled, numbers.gap_m, 2),
        ("time to collision, s", numbers.within_5_s, numbers.time_to_collision_s, 1),
    ):
        if quantiles is not None:
            rows.append((label, count, *(f"{getattr(quantiles, name):.{digits}f}" for name in _QUANTILES)))
    return rows
