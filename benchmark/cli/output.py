"""Output of commands: JSON, plans of ``--dry-run``, caveats, paths of results and next commands."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import typer

from benchmark import api
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from benchmark.records.run_schema import RecordFacts
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


def print_plan(sentences: Sequence[str], *, json_output: bool) -> None:
    """Print the text of ``--dry-run``."""
    print_result({"would": list(sentences)}, "\n".join(sentences), json_output=json_output)


def print_next_steps(where: str, *steps: tuple[str, str], json_output: bool) -> None:
    """Print on stderr where results are, and each command that comes next with its purpose; nothing with ``--json``."""
    if json_output:
        return
    typer.echo(where, err=True)
    for number, (command, purpose) in enumerate(steps):
        typer.echo(f"{'next:' if number == 0 else '     '} challenger-bench {command}   # {purpose}", err=True)


def repeat_data_options(options: DataLocation) -> str:
    """Options that name the same data and output folder again, with a space before; nothing where they are default."""
    categories = getattr(options, "categories", None)
    given = "" if options.data == "mini" else f" --data {options.data}"
    given += "" if options.tables is None else f" --tables {options.tables}"
    given += "" if categories is None else f" --categories {categories}"
    return given + repeat_out_option(options.out)


def repeat_out_option(out: Path) -> str:
    """The option that names the same output folder again, with a space before; nothing where it is the default."""
    return "" if out == api.OUT else f" --out {out}"


def print_shard_progress(
    shard: "Shard", found: "Sequence[ShardProgress]", did: str, step: tuple[str, str], *, json_output: bool
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
    print_next_steps(f"shard {shard} is {did}", step, json_output=json_output)


def warn_of_caveats(records: "Iterable[RecordFacts]") -> None:
    """Print the caveats of records on stderr, each sentence once with its planners."""
    planners: dict[str, list[str]] = {}
    for facts in records:
        for caveat in facts.caveats:
            planners.setdefault(caveat.sentence, []).append(facts.planner.name)
    for sentence, names in planners.items():
        api.notify(f"warning: {', '.join(dict.fromkeys(names))}: {sentence}")
