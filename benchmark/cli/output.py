"""Output of commands: JSON, plans of ``--dry-run``, caveats, paths of results and next commands."""

import glob
import json
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import typer

from benchmark import api
from benchmark.cli.settings import repeat_command
from benchmark.report.words import format_options, pluralise

if TYPE_CHECKING:
    from benchmark.records.run_schema import RecordFacts
    from benchmark.report.table import Table
    from benchmark.runs.units import Shard, ShardProgress


class DataLocation(Protocol):
    """Options for the data and for the output folder."""

    @property
    def data(self) -> str:
        """Value of ``--data``."""

    @property
    def tables(self) -> str | None:
        """Version folder."""

    @property
    def out(self) -> Path:
        """Folder of everything that is made."""


def print_json(value: Any) -> None:
    """Machine-readable output: JSON and nothing else on stdout."""
    typer.echo(json.dumps(value, indent=1, sort_keys=True, allow_nan=False))


def print_result(value: Any, text: str, *, json_output: bool) -> None:
    """Print the findings of a command, as JSON for a program or as text for people."""
    if json_output:
        print_json(value)
    else:
        typer.echo(text.removesuffix("\n"))


def print_tables(tables: "Sequence[Table]", *, wide: bool, verbose: bool, err: bool = False) -> None:
    """Print tables, and below them each note that their rows need once; all notes if ``verbose``."""
    if tables:
        from benchmark.report.table import format_tables

        typer.echo(format_tables(tables, wide=wide, verbose=verbose), err=err)


def print_plan(sentences: Sequence[str], *, json_output: bool) -> None:
    """Print the text of ``--dry-run``."""
    print_result({"would": list(sentences)}, "\n".join(sentences), json_output=json_output)


Step = tuple[str, str] | None
"""A command that comes next, as it is typed after ``challenger-bench``, and its purpose; ``None`` if it is done."""


def print_next_steps(where: str, *steps: Step, json_output: bool) -> None:
    """Print on stderr where results are, and the commands that come next; nothing with ``--json``."""
    if json_output:
        return
    typer.echo(where, err=True)
    for number, (command, purpose) in enumerate(step for step in steps if step is not None):
        typer.echo(f"{'next:' if number == 0 else '     '} challenger-bench {command}   # {purpose}", err=True)


def repeat_data_options(options: DataLocation) -> str:
    """Options that name the same data and output folder again, with a space before; nothing where they are default."""
    data = None if options.data == "mini" else options.data
    given = {name: getattr(options, name, None) for name in ("categories", "cameras", "driving_side")}
    return format_options(data=data, tables=options.tables, **given) + repeat_out_option(options.out)


def repeat_out_option(out: Path) -> str:
    """The option that names the same output folder again, with a space before; nothing where it is the default."""
    return format_options(out=None if out == api.OUT else out)


def suggest_leaderboard(out: Path, *made: Path, records: Collection[str] = ()) -> Step:
    """The step to a leaderboard; ``None`` where the one that is there has the ``records``, by content id.

    Without any it must be newer than the files that were ``made`` now.
    """
    folder = out / "leaderboard"
    if records:
        tables = folder / "tables.json"
        written = tables.read_text() if tables.is_file() else ""
        current = all(content_id in written for content_id in records)
    else:
        current = is_newer(folder / "README.md", made)
    step = (f"leaderboard{repeat_out_option(out)}", "write tables, figures and a site of all records")
    return None if current else step


def find_records_of(out: Path, data_name: str, split: str, planner: str) -> list[Path]:
    """Records of a planner's runs on a split, with any checkpoint and seed."""
    from benchmark.machine.storage import sanitise_file_name
    from benchmark.records.store import RUN_FILE

    folder = api.workspace(out).run_root() / sanitise_file_name(data_name) / sanitise_file_name(split)
    name = glob.escape(sanitise_file_name(planner))
    return [file for pattern in (name, f"{name}-{'[0-9a-f]' * 8}") for file in folder.glob(f"{pattern}/{RUN_FILE}")]


def is_newer(path: Path, than: Iterable[Path]) -> bool:
    """Whether a file is there and was written after others."""
    return path.exists() and all(path.stat().st_mtime >= other.stat().st_mtime for other in than if other.exists())


def print_shard_progress(
    shard: "Shard",
    found: "Sequence[ShardProgress]",
    did: str,
    purpose: str = "once all shards are done",
    *,
    json_output: bool,
) -> None:
    """Print what a shard ``did`` (``driven``, ``scored``, ``searched``, ``drawn``), the rest, and the next command."""
    if json_output:
        print_json(
            [
                {"directory": str(progress.directory), did: progress.done, "scenes": progress.scenes}
                for progress in found
            ]
        )
    for progress in found:
        typer.echo(
            f"{progress.directory}: shard {shard}, {progress.done} of {pluralise(progress.scenes, 'scene')} {did}",
            err=json_output,
        )
    step = (repeat_command(without="--shard"), purpose)
    print_next_steps(f"shard {shard} is {did}", step, json_output=json_output)


def warn_of_caveats(records: "Iterable[RecordFacts]") -> None:
    """Print the caveats of records on stderr, each sentence once with its planners."""
    planners: dict[str, list[str]] = {}
    for facts in records:
        for caveat in facts.caveats:
            planners.setdefault(caveat.sentence, []).append(facts.planner.name)
    for sentence, names in planners.items():
        api.notify(f"warning: {', '.join(dict.fromkeys(names))}: {sentence}")
