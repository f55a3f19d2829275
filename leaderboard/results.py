"""The measured results that the documentation shows: one page and its numbers, and whether they are still current."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.machine.storage import read_kept_json, write_bytes, write_json
from benchmark.metrics.disagreement import EXACT
from benchmark.records.ablation import AblationReport
from benchmark.records.run import NATIVE, RunRecord
from benchmark.report.table import Table
from leaderboard.frame.runs import Frame
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.collision import collision_table
from leaderboard.tables.comparisons import split_table
from leaderboard.tables.diagnosis import diagnosis_tables
from leaderboard.tables.effect import effect_table
from leaderboard.tables.transfer import both_matrices, lift_table, transfer_table

PAGE: Final = "README.md"
NUMBERS: Final = "results.json"
_HEAD: Final = """\
# Measured on the embedded data set

Written by `challenger-bench demo --full`; do not edit. With `--check` the same command says whether it is current.
The miniatures (`docs/miniatures.md`) show the pipeline and rank nothing: no number here says anything about the full
models. What each number is: `docs/metrics.md`.
"""


def write_results(
    data_name: str,
    records: Sequence[RunRecord],
    ablations: Sequence[AblationReport],
    made_from: Mapping[str, Any],
    folder: Path,
) -> list[Path]:
    """Write the page and its numbers, from records of all planners on ``val``, ``val-r`` and ``adv``.

    `made_from` is everything that the numbers depend on, as JSON: versions and hashes.
    """
    tables = [*_results_tables(data_name, records), *ablation_tables(ablations).get(data_name, ())]
    page = "\n".join([_HEAD, *(table.markdown() for table in tables)]).encode()
    numbers = {
        "made_from": made_from,
        "page_sha256": hashlib.sha256(page).hexdigest(),
        "tables": [table.as_json() for table in tables],
    }
    # The numbers come last: they vouch for the page.
    write_bytes(folder / PAGE, page)
    write_json(folder / NUMBERS, numbers)
    return [folder / PAGE, folder / NUMBERS]


def _results_tables(data_name: str, records: Sequence[RunRecord]) -> list[Table]:
    """The tables of the page in reading order: collisions, what changes between splits, transfer, diagnosis."""
    frame = Frame(data_name, records)
    tables: list[Table | None] = [
        effect_table(frame),
        collision_table(frame, EXACT),
        collision_table(frame, NATIVE),
        split_table(frame, EXACT),
    ]
    adversarial = [record for record in frame.runs if record.run.split == "adv"]
    if len(adversarial) > 1:
        for matrix in both_matrices(adversarial, EXACT):
            tables += [transfer_table(data_name, matrix), lift_table(data_name, matrix)]
    tables += diagnosis_tables(frame)
    return [table for table in tables if table is not None]


def stale_results(folder: Path, made_from: Mapping[str, Any]) -> list[str]:
    """One sentence for each reason why results are not what would be measured now; nothing is measured for that.

    `made_from` is what they would be made from now.
    """
    numbers = read_kept_json(folder / NUMBERS)
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
        reasons.append(f"{page} is not what was written with {folder / NUMBERS}")
    return reasons
