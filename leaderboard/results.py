"""Records that may stand in tables together, the documentation's page of measured results, and its staleness."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.machine.storage import read_cached_json, write_bytes, write_json
from benchmark.metrics.disagreement import EXACT
from benchmark.records.ablation import AblationReport
from benchmark.records.planner_versions import label_versions
from benchmark.records.review import NOT_REVIEWED
from benchmark.records.run import NATIVE, RunRecord
from benchmark.report.table import Table
from benchmark.report.words import format_split
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.collision import collision_table
from leaderboard.tables.comparisons import split_table
from leaderboard.tables.diagnosis import diagnosis_tables
from leaderboard.tables.effect import effect_table
from leaderboard.tables.transfer import build_both_matrices, lift_table, transfer_table


def select_runs(records: Sequence[RunRecord]) -> list[RunRecord]:
    """The record that stands for each version of a planner on each split of each data set, in whatever order they come.

    Versions are told apart by `benchmark.records.planner_versions`. A run of the whole split goes before runs of some
    of its scenes; of those the one with most scenes is taken. Two records of the same split and planner, runs of one
    split on different content, or adversarial scenes under the name of another split are an `InputError`.
    """
    chosen: dict[tuple[str, str, str], RunRecord] = {}
    for record in sorted(label_versions(records), key=_preference_key):
        key = (record.run.data.name, record.run.split, record.planner)
        first = chosen.setdefault(key, record)
        if first is not record and record.covers_split:
            raise InputError(
                f"{first.directory} and {record.directory} both hold {record.planner} on split {record.run.split}; "
                "move one of them away or name the records' folder with --records"
            )
    selected = list(chosen.values())
    _require_same_content(selected)
    _require_one_split(selected)
    return sorted(selected, key=lambda record: (record.run.data.name, record.run.split, record.planner))


def _preference_key(record: RunRecord) -> tuple[bool, int, list[str], str]:
    return not record.covers_split, -len(record.run.scenes), record.run.scenes, record.directory.as_posix()


def _require_same_content(records: Sequence[RunRecord]) -> None:
    """Numbers on different scenes under one name would be taken for comparable."""
    records_by_split: dict[tuple[str, str], RunRecord] = {}
    for record in records:
        first = records_by_split.setdefault((record.run.data.name, record.run.split), record)
        if first.judged_content[1] != record.judged_content[1]:
            raise InputError(
                f"{first.directory} and {record.directory} ran under different verdicts of inspectors on "
                f"{format_split(record.run.split, record.run.data.name)} ({_verdict_key(first)} and "
                f"{_verdict_key(record)}); run challenger-bench eval again for the older one, or move it away"
            )
        if first.run.data.fingerprint != record.run.data.fingerprint:
            raise InputError(
                f"{first.directory} and {record.directory} ran on different content of "
                f"{format_split(record.run.split, record.run.data.name)} (the data fingerprints differ); run "
                "challenger-bench eval again for the older one, or move it away"
            )


def _verdict_key(record: RunRecord) -> str:
    review = record.run.review
    return NOT_REVIEWED if review is None else f"review {review.content[:12]}"


def _require_one_split(records: Sequence[RunRecord]) -> None:
    """Adversarial scenes under the name of another split would be compared with themselves: an increase of 0."""
    adversarial = {_scene_key(record): record for record in records if record.run.split == "adv"}
    for record in records:
        same = adversarial.get(_scene_key(record))
        if same is not None and record is not same and record.run.split != "adv":
            raise InputError(
                f"{record.directory} and {same.directory} hold the same scenes of {record.run.data.name} as split "
                f"{record.run.split} and as split adv; remove the first, which is not {record.run.split}"
            )
        adversarial_scenes = sorted(
            name for name, facts in record.run.scene_facts.items() if facts.manoeuvre is not None
        )
        if adversarial_scenes and record.run.split == "val":
            raise InputError(
                f"{record.directory} lists scenes with a generated adversary ({adversarial_scenes[0]}); remove it and "
                "run challenger-bench eval --split adv"
            )


def _scene_key(record: RunRecord) -> tuple[str, str, tuple[str, ...]]:
    return record.run.data.name, record.run.data.fingerprint, tuple(record.run.scenes)


PAGE: Final = "README.md"
NUMBERS: Final = "results.json"
_HEAD: Final = """\
# Measured on the embedded data set

Written by `challenger-bench demo --full`; do not edit. With `--check` the same command tests whether it is current.
The miniatures (`docs/miniatures.md`) show the pipeline and are not for ranking: no number here applies to the full
models. Definitions of the numbers: `docs/metrics.md`.
"""


def write_results(
    data_name: str,
    records: Sequence[RunRecord],
    ablations: Sequence[AblationReport],
    made_from: Mapping[str, Any],
    folder: Path,
) -> list[Path]:
    """Write the page and its numbers, from records on ``val``, ``val-r`` and ``adv``; `made_from` are its inputs."""
    tables = [*_results_tables(data_name, records), *ablation_tables(ablations).get(data_name, ())]
    page = "\n".join([_HEAD, *(table.markdown() for table in tables)]).encode()
    numbers = {
        "made_from": made_from,
        "page_sha256": hashlib.sha256(page).hexdigest(),
        "tables": [table.as_json() for table in tables],
    }
    # The numbers are written last: they certify the page.
    write_bytes(folder / PAGE, page)
    write_json(folder / NUMBERS, numbers)
    return [folder / PAGE, folder / NUMBERS]


def _results_tables(data_name: str, records: Sequence[RunRecord]) -> list[Table]:
    """The tables of the page in reading order: collisions, what changes between splits, transfer, diagnosis."""
    frame = DataSetRuns(data_name, records)
    tables: list[Table | None] = [
        effect_table(frame),
        collision_table(frame, EXACT),
        collision_table(frame, NATIVE),
        split_table(frame, EXACT),
    ]
    adversarial = [record for record in frame.runs if record.run.split == "adv"]
    if len(adversarial) > 1:
        for matrix in build_both_matrices(adversarial, EXACT):
            tables += [transfer_table(data_name, matrix), lift_table(data_name, matrix)]
    tables += diagnosis_tables(frame)
    return [table for table in tables if table is not None]


def find_stale_results(folder: Path, made_from: Mapping[str, Any]) -> list[str]:
    """One sentence for each reason why results do not follow from `made_from`, the present inputs."""
    numbers = read_cached_json(folder / NUMBERS)
    if not isinstance(numbers, dict) or not isinstance(numbers.get("made_from"), dict):
        return [f"there are no results in {folder}"]
    before = numbers["made_from"]
    reasons = [
        f"{name} has changed since {folder / NUMBERS} was written"
        for name in sorted({*before, *made_from})
        if before.get(name) != made_from.get(name)
    ]
    page = folder / PAGE
    if not page.is_file() or hashlib.sha256(page.read_bytes()).hexdigest() != numbers.get("page_sha256"):
        reasons.append(f"{page} does not match {folder / NUMBERS}")
    return reasons
