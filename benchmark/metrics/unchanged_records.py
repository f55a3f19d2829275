"""Which record an adversarial run is compared with: the same planner on the same recordings, unchanged."""

import glob
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from benchmark.errors import InputError
from benchmark.machine.storage import sanitise_file_name
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.planner_versions import PLANS_SHA256, describe_version
from benchmark.records.run import RunRecord, load_record
from benchmark.records.run_schema import PlannerFacts
from benchmark.records.seed_splits import RECORDED_EGO, format_ego_split, is_adversarial, parse_ego, strip_ego
from benchmark.records.store import RUN_FILE

UNCHANGED_SPLITS: Final = ("val-r", "val")
"""In the order in which they are preferred for planners that see images: val-r is drawn by the renderer of adv."""


def sees_images(planner: PlannerFacts) -> bool:
    """Whether a planner says that it wants images, or is one of the networks; of others that is not known."""
    return "images" in planner.wants or planner.native_protocol is not None or planner.miniature


def find_unchanged_record(
    record: RunRecord, candidates: Iterable[RunRecord], elsewhere: str | None = None
) -> RunRecord | None:
    """The record of the same planner on the unchanged recordings of an adversarial split.

    ``candidates`` have the newest of each split last. Of val-r before val for planners that see images, of val before
    val-r for others; of records of one split the last that has most of the recordings. Of other data sets only those
    count that ``elsewhere`` or the record itself names. ``None`` where no candidate has any of the recordings.
    """
    sources, data_names = set(map_scenes_to_sources(record).values()), _find_data_names(record, elsewhere)
    order = UNCHANGED_SPLITS if sees_images(record.run.planner) else UNCHANGED_SPLITS[::-1]
    best: tuple[tuple[int, int], RunRecord] | None = None
    for candidate in candidates:
        shared = len(sources & set(map_scenes_to_sources(candidate).values()))
        split = candidate.run.split
        if not shared or is_adversarial(split) or candidate.run.data.name not in data_names:
            continue
        # An ego that reacts is compared with the same driver undisturbed, never with the recorded one.
        if parse_ego(split) != parse_ego(record.run.split):
            continue
        if not _same_planner(record, candidate):
            continue
        plain = strip_ego(split)
        rank = (shared, -order.index(plain) if plain in order else -len(order))
        if best is None or rank >= best[0]:
            best = rank, candidate
    return None if best is None else best[1]


def find_unchanged_candidates(
    root: Path, records: Iterable[RunRecord], elsewhere: str | None = None
) -> list[RunRecord]:
    """Records on val-r and val of the same planners, the newest last, below a folder; damaged ones are left out."""
    wanted = {
        (data_name, record.run.planner.name, parse_ego(record.run.split))
        for record in records
        if has_adversaries(record)
        for data_name in _find_data_names(record, elsewhere)
    }
    candidates: list[RunRecord] = []
    for data_name, planner, ego in sorted(wanted):
        for split in UNCHANGED_SPLITS if ego == RECORDED_EGO else (format_ego_split("val-r", ego),):
            folder = root / sanitise_file_name(data_name) / sanitise_file_name(split)
            for head in folder.glob(f"{glob.escape(sanitise_file_name(planner))}*/{RUN_FILE}"):
                with suppress(InputError):
                    candidates.append(load_record(head.parent))
    return sorted(candidates, key=lambda record: ((record.directory / RUN_FILE).stat().st_mtime_ns, record.directory))


def _find_data_names(record: RunRecord, elsewhere: str | None) -> set[str]:
    """Data sets that may hold the unchanged recordings of a record."""
    named = record.run.unchanged
    return {elsewhere} if elsewhere else {record.run.data.name, *([] if named is None else [named.data.name])}


def _same_planner(first: RunRecord, second: RunRecord) -> bool:
    """The same weights, code, settings and seed; plan files hold one split each."""
    one, other = first.run.planner, second.run.planner
    settings = [{k: v for k, v in describe_version(planner).items() if k != PLANS_SHA256} for planner in (one, other)]
    return (one.name, one.code_sha256, settings[0]) == (
        other.name,
        other.code_sha256,
        settings[1],
    )
