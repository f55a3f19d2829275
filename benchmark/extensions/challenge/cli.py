"""Commands of organisers: ``challenge check|score|rules``, strangers' scenes held to rules and recordings."""

import os
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    JsonOption,
    OutOption,
    ScenesOption,
    SeedOption,
    WideOption,
    WorkersOption,
    name_list,
    print_json,
)
from benchmark.cli.what_next import same_place, say_next
from benchmark.cli.whole_help import WholeSummaries
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.records.challenge import EntryVerdict

app = typer.Typer(
    cls=WholeSummaries,
    help="Check and rank strangers' adversarial scenes, as the organiser of a challenge.",
    no_args_is_help=True,
)


class RuleSet(StrEnum):
    """Rules to start from (`benchmark.extensions.challenge.rules.RULE_SETS`)."""

    DEFAULT = "default"
    STRICT = "strict"
    PAPER = "paper"


class Horizon(StrEnum):
    """Horizons of collision rates (`benchmark.metrics.rates.HORIZONS`)."""

    ONE = "1s"
    TWO = "2s"
    THREE = "3s"
    AVERAGE = "avg"


BaseOption = Annotated[str, typer.Option("--base", help="mini, demo or the root of the recordings it was made from.")]
BaseTablesOption = Annotated[
    str | None, typer.Option("--base-tables", help="Version folder of the recordings, if there are several.")
]
EntryTablesOption = Annotated[
    str | None, typer.Option("--tables", help="Version folder of the entry, if there are several.")
]
RulesOption = Annotated[Path | None, typer.Option("--rules", help="rules.toml; what it leaves out has its default.")]


@app.command("check")
def challenge_check_command(
    root: Annotated[Path, typer.Argument(help="Root of the entry.")],
    base: BaseOption,
    rules: RulesOption = None,
    out: OutOption = api.OUT,
    to: Annotated[Path | None, typer.Option(help="Folder of verdict and page, if not <out>/challenge/<entry>.")] = None,
    tables: EntryTablesOption = None,
    base_tables: BaseTablesOption = None,
    scenes: ScenesOption = None,
    page: Annotated[bool, typer.Option("--page/--no-page", help="Whether to write the page too.")] = True,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Say which scenes of an entry keep the rules; exit code 1 if one is refused, 2 if nothing can be said."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.cli.preflight_places import require_file, require_folder, require_place
    from benchmark.extensions.challenge.checking import check_entry
    from benchmark.extensions.challenge.page import write_page
    from benchmark.extensions.challenge.pictures import scenes_from_above
    from benchmark.extensions.challenge.rules import read_rules
    from benchmark.machine.storage import file_name
    from benchmark.machine.workers import LocalProcesses
    from benchmark.records.challenge import write_verdict

    count = api.worker_count(workers)
    require_file(rules, "--rules", (".toml",))
    said = read_rules(rules)
    require_folder(root, "entry")
    require_root(base, base_tables, out)
    require_place(to or out, "--to" if to else "--out")
    entry, recordings = api.open_data(root, tables=tables), api.open_data(base, tables=base_tables, out=out)
    verdict = check_entry(entry, recordings, said, name_list(scenes), LocalProcesses(count))
    folder = to or api.workspace(out).challenge_root() / file_name(entry.name)
    file = write_verdict(folder, verdict)
    shown = write_page(folder, verdict, said, scenes_from_above(entry, recordings, verdict)) if page else file
    if json_output:
        print_json(verdict.model_dump(mode="json", by_alias=True))
    else:
        _say(verdict)
    say_next(
        f"verdict: {file}{f', {shown} in any browser' if page else ''}",
        (f"challenge score {root} --base {base} --model constant-velocity{same_place('mini', out)}", "planners on it"),
        json_output=json_output,
    )
    raise typer.Exit(0 if verdict.accepted else 1)


def entry_names(roots: Sequence[Path]) -> dict[str, Path]:
    """Names of entries: their folders, with as many of those above as tell them apart.

    Args:
        roots: Of the entries.

    Returns:
        Roots by name.

    Raises:
        InputError: If one is named twice.
    """
    resolved = [root.resolve() for root in roots]
    if twice := next((root for root, own in zip(roots, resolved, strict=True) if resolved.count(own) > 1), None):
        raise InputError(f"the entry {twice} is named twice; name each once")
    parts = [Path(os.path.normpath(root.absolute())).parts for root in roots]
    count = 1
    while len({own[-count:] for own in parts}) < len(parts):
        count += 1
    return {"/".join(own[-count:]): root for own, root in zip(parts, roots, strict=True)}


def _say(verdict: "EntryVerdict") -> None:
    for reason in verdict.reasons:
        typer.echo(f"refused: {verdict.entry.name} {reason.sentence} [{reason.rule}]")
    for scene in verdict.scenes:
        if scene.accepted:
            typer.echo(f"accepted: {scene.scene}")
        for reason in scene.reasons:
            typer.echo(f"refused: {scene.scene} {reason.sentence} [{reason.rule}]")
        for note in scene.notes:
            typer.echo(f"note: {scene.scene}: {note}")
    accepted = len(verdict.scenes) - len(verdict.refused)
    typer.echo(f"{accepted} of {counted(len(verdict.scenes), 'scene')} of {verdict.entry.name} accepted")


@app.command("score")
def challenge_score_command(
    roots: Annotated[list[Path], typer.Argument(help="Roots of entries; names that are alike get their folders.")],
    base: BaseOption,
    model: Annotated[
        list[str], typer.Option("--model", metavar="<str>", help="Planner by name or module:Class; may be repeated.")
    ],
    rules: RulesOption = None,
    protocol: Annotated[str, typer.Option(help="Who judges the plans; native: each planner's own.")] = "exact",
    horizon: Annotated[Horizon, typer.Option(help="Whose collision rate ranks; avg is the mean of the three.")] = (
        Horizon.AVERAGE
    ),
    out: OutOption = api.OUT,
    base_tables: BaseTablesOption = None,
    device: Annotated[
        str | None, typer.Option(help="Where a network runs: cpu, cuda, cuda:1; the first GPU if there is one.")
    ] = None,
    precision: Annotated[str | None, typer.Option(help="Of a network: float32 or bfloat16.")] = None,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    wide: WideOption = False,
    json_output: JsonOption = False,
) -> None:
    """Check entries, let planners drive on them, rank them, and say which places are not told apart."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.cli.preflight_names import require_models
    from benchmark.cli.preflight_places import require_file, require_folder, require_place
    from benchmark.extensions.challenge.rules import read_rules
    from benchmark.extensions.challenge.scoring import ScoreSettings, score_entries
    from benchmark.protocols import protocol as known_protocol
    from benchmark.records.challenge_scores import write_scores
    from benchmark.records.run import NATIVE
    from leaderboard.extensions.challenge.tables import challenge_tables

    count = api.worker_count(workers)
    if protocol != NATIVE:
        known_protocol(protocol)
    require_file(rules, "--rules", (".toml",))
    said = read_rules(rules)
    for root in roots:
        require_folder(root, "entry")
    require_models(model, None, data=base, device=device, precision=precision)
    require_root(base, base_tables, out)
    require_place(out, "--out")
    planners = [api.load_planner(each, data=base, seed=seed, device=device, precision=precision) for each in model]
    recordings = api.open_data(base, tables=base_tables, out=out)
    entries = {name: api.open_data(root) for name, root in entry_names(roots).items()}
    folder = api.workspace(out).challenge_root()
    settings = ScoreSettings(folder, said, protocol, horizon.value, seed, count)
    scores = score_entries(entries, recordings, planners, settings)
    file = write_scores(folder, scores)
    if json_output:
        print_json(scores.model_dump(mode="json", by_alias=True))
    else:
        for table in challenge_tables(scores):
            typer.echo(table.plain(wide=wide))
    say_next(
        f"scores: {file}; verdicts and records of the planners: {folder}",
        (f"leaderboard{same_place('mini', out)}", "the entries beside the planners"),
        json_output=json_output,
    )
    failed = any(each.failed for entry in scores.entries for each in entry.planners.values())
    raise typer.Exit(1 if failed or not any(entry.best_place for entry in scores.entries) else 0)


@app.command("rules")
def challenge_rules_command(
    rules: Annotated[Path | None, typer.Argument(help="rules.toml to read and complete.")] = None,
    start: Annotated[
        RuleSet,
        typer.Option("--set", help="Without a file: the defaults, a stricter set, or one without limits of motion."),
    ] = RuleSet.DEFAULT,
    json_output: JsonOption = False,
) -> None:
    """Print a whole rules.toml, each rule with what it says."""
    from benchmark.cli.preflight_places import require_file
    from benchmark.extensions.challenge.rules import RULE_SETS, read_rules, rules_text

    require_file(rules, "rules", (".toml",))
    said = RULE_SETS[start.value] if rules is None else read_rules(rules)
    if json_output:
        print_json({"fingerprint": said.fingerprint, "rules": said.model_dump(mode="json", by_alias=True)})
    else:
        typer.echo(rules_text(said), nl=False)
