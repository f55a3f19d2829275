"""Command that checks records of strangers: ``leaderboard submit-check``."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import pluralise


@dataclass(frozen=True, slots=True, kw_only=True)
class SubmitCheckOptions:
    """Options of ``leaderboard submit-check``."""

    folder: Annotated[Path, Option("Folder of submitted records, of runs and of drives.", names="")]
    data: shared.Data = "mini"
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(SubmitCheckOptions)
def submit_check_command(options: SubmitCheckOptions) -> None:
    """Check a stranger's records of runs and drives: who planned, and every number, computed anew from the plans."""
    data = api.DataSource.of(options)
    if not options.folder.is_dir():
        raise InputError(f"there is no folder {options.folder}; name the folder with the submitted records")
    data.require()
    from adapters.planner_listing import find_own_planner
    from benchmark.extensions.submissions.checking import check_submission, read_record_facts
    from benchmark.extensions.submissions.recomputed import FindingLevel
    from benchmark.records.run import RunRecord

    source = data.open()
    opener = partial(data.open_split, source=source)
    sound, findings = check_submission(options.folder, source.name, opener, find_own_planner)
    if options.json_output:
        print_json(
            {
                "sound": [str(record.directory) for record in sound],
                "findings": [finding.as_json() for finding in findings],
            }
        )
    else:
        for finding in findings:
            typer.echo(f"{finding.level}: {finding.directory}: {finding.sentence}")
        for record in sound:
            rows = pluralise(len(record.rows), "sample" if isinstance(record, RunRecord) else "drive")
            typer.echo(f"fit: {record.directory}: {record.planner} on {read_record_facts(record).split}, {rows}")
    raise typer.Exit(1 if any(finding.level is FindingLevel.ERROR for finding in findings) else 0)
