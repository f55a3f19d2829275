"""Command that writes AlpaSim's table: ``leaderboard export-alpasim``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_result
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import pluralise

AlgorithmName = Literal["average", "zoib"]
"""How scores of policies are made."""
RulesName = Literal["alpasim@2026-07", "alpasim@2026-09"]
"""Rules of the scene score."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportAlpasimOptions:
    """Options of ``leaderboard export-alpasim``."""

    to: Annotated[Path, Option("Folder for the matrix, the ranking and the manifest.", "Output")]
    runs: Annotated[
        Path | None, Option("AlpaSim's results, a folder a policy, in place of records of drives.", "Input")
    ] = None
    split: shared.Split = "adv"
    rules: Annotated[RulesName, Option("Scene score of our drives.", "Output")] = "alpasim@2026-09"
    algorithm: Annotated[AlgorithmName, Option("Mean of scenes, or abilities that --posterior gives.", "Output")] = (
        "average"
    )
    posterior: Annotated[Path | None, Option("JSON of subject_ids, scores, score_uncertainty, for zoib.", "Input")] = (
        None
    )
    anchors: Annotated[Path | None, Option("AlpaSim's manifest of references, with its score_scale.", "Input")] = None
    out: shared.Out = api.OUT
    records: shared.Records = None
    json_output: shared.Json = False


@command(ExportAlpasimOptions)
def export_alpasim_command(options: ExportAlpasimOptions) -> None:
    """Write the table of AlpaSim's challenge in its own files and order, with scores on its anchored scale."""
    from benchmark.extensions.alpasim_table.subjects import collect_subjects, read_subjects
    from benchmark.extensions.alpasim_table.table import Anchors, Posterior, build_alpasim_table
    from benchmark.machine.path_checks import require_file, require_folder, require_place
    from benchmark.records.drives import find_drives

    for path, name in ((options.posterior, "--posterior"), (options.anchors, "--anchors")):
        require_file(path, name)
    for folder in (options.runs, *(options.records or ())):
        require_folder(folder, "--runs" if folder is options.runs else "--records")
    require_place(options.to, "--to")
    if options.posterior is not None and options.algorithm != "zoib":
        raise InputError("--posterior applies only to --algorithm zoib; leave it out")
    if options.runs is not None:
        subjects = read_subjects(options.runs)
    else:
        found = find_drives(*(options.records or (api.workspace(options.out).drive_root(),)))
        subjects = collect_subjects([record for record in found if record.facts.split == options.split], options.rules)
    table = build_alpasim_table(
        subjects,
        options.algorithm,
        None if options.posterior is None else Posterior.read(options.posterior),
        None if options.anchors is None else Anchors.read(options.anchors),
    )
    written = [str(path) for path in table.write(options.to)]
    for warning in table.warnings:
        typer.echo(f"warning: {warning.replace('_', ' ')}: the mean over scenes is used", err=True)
    print_result(
        {"files": written, "order": list(table.order), "warnings": list(table.warnings)},
        f"{pluralise(len(table.order), 'policy', 'policies')} in AlpaSim's order: {', '.join(table.order)}\n"
        f"files: {', '.join(written)}",
        json_output=options.json_output,
    )
