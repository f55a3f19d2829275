"""Command that checks records of strangers: ``leaderboard submit-check``."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    DataOption,
    JsonOption,
    OutOption,
    TablesOption,
    WorkersOption,
    print_json,
)
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    pass


def submit_check_command(
    folder: Annotated[Path, typer.Argument(help="Folder of submitted records, of runs and of drives.")],
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Check a stranger's records of runs and drives: who planned, and every number, computed anew from the plans."""
    from benchmark.cli.preflight_data_sets import require_root

    api.worker_count(workers)
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; name the one that holds the submitted records")
    require_root(data, tables, out)

    from adapters.known_planners import own_planner_like
    from benchmark.extensions.submissions.checking import check_submission, facts_of_record
    from benchmark.extensions.submissions.findings import Level
    from benchmark.records.run import RunRecord

    source = api.open_data(data, tables=tables, workers=workers, out=out)
    opener = partial(api.open_split, source, out=out, workers=workers)
    sound, findings = check_submission(folder, source.name, opener, own_planner_like)
    if json_output:
        print_json(
            {"sound": [str(record.directory) for record in sound], "findings": [found.as_json() for found in findings]}
        )
    else:
        for found in findings:
            typer.echo(f"{found.level}: {found.directory}: {found.sentence}")
        for record in sound:
            rows = counted(len(record.rows), "sample" if isinstance(record, RunRecord) else "drive")
            typer.echo(f"fit: {record.directory}: {record.planner} on {facts_of_record(record).split}, {rows}")
    raise typer.Exit(1 if any(found.level is Level.ERROR for found in findings) else 0)
