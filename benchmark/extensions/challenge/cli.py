"""Commands of organisers: ``challenge check|score|rules``, strangers' scenes held to rules and recordings."""

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.help import FullSummaryGroup
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import (
    print_json,
    print_next_steps,
    print_result,
    print_tables,
    repeat_out_option,
    suggest_leaderboard,
)
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import format_options, pluralise

if TYPE_CHECKING:
    from benchmark.records.challenge import EntryVerdict

app = typer.Typer(
    cls=FullSummaryGroup,
    help="Check and rank strangers' adversarial scenes, as the organiser of a challenge.",
    no_args_is_help=True,
    rich_help_panel="Data",
)


RuleSet = Literal["default", "strict", "paper"]
"""Rules to start from (`benchmark.extensions.challenge.rules.RULE_SETS`)."""


Horizon = Literal["1s", "2s", "3s", "avg"]
"""Horizons of collision rates (`benchmark.metrics.rates.HORIZONS`)."""


BaseOption = Annotated[str, Option("mini, demo or the root of the recordings it was made from.", "Input")]
BaseTablesOption = Annotated[str | None, Option("Version folder of the recordings, if there are several.", "Input")]
EntryTablesOption = Annotated[
    str | None, Option("Version folder of the entry, if there are several.", "Input", names="--tables")
]
RulesOption = Annotated[Path | None, Option("rules.toml; what it leaves out has its default.", "Input")]


@dataclass(frozen=True, slots=True, kw_only=True)
class ChallengeCheckOptions:
    """Options of ``challenge check``."""

    root: Annotated[Path, Option("Root of the entry.", "Input", names="")]
    base: BaseOption
    rules: RulesOption = None
    out: shared.Out = api.OUT
    to: Annotated[Path | None, Option("Folder of verdict and page, if not <out>/challenge/<entry>.", "Output")] = None
    tables: EntryTablesOption = None
    base_tables: BaseTablesOption = None
    scenes: shared.Scenes = None
    page: Annotated[bool, Option("Whether to write the page too.", "Output", names="--page/--no-page")] = True
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(ChallengeCheckOptions, app, "check")
def challenge_check_command(options: ChallengeCheckOptions) -> None:
    """Say which scenes of an entry keep the rules; exit code 1 if one is refused, 2 if nothing can be said."""
    from benchmark.extensions.challenge.checking import check_entry
    from benchmark.extensions.challenge.page import write_page
    from benchmark.extensions.challenge.rules import read_rules
    from benchmark.extensions.challenge.scene_drawings import draw_scenes
    from benchmark.machine.path_checks import require_file, require_folder, require_place
    from benchmark.machine.storage import sanitise_file_name
    from benchmark.machine.workers import LocalProcesses
    from benchmark.records.challenge import write_verdict

    count = api.worker_count(options.workers)
    require_file(options.rules, "--rules", (".toml",))
    rules = read_rules(options.rules)
    require_folder(options.root, "entry")
    base = api.DataSource.of(options, data=options.base, tables=options.base_tables)
    base.require()
    require_place(options.to or options.out, "--to" if options.to else "--out")
    entry, recordings = api.open_data(options.root, tables=options.tables), base.open()
    verdict = check_entry(entry, recordings, rules, parse_name_list(options.scenes), LocalProcesses(count))
    folder = options.to or api.workspace(options.out).challenge_root() / sanitise_file_name(entry.name)
    file = write_verdict(folder, verdict)
    page = write_page(folder, verdict, rules, draw_scenes(entry, recordings, verdict)) if options.page else file
    if options.json_output:
        print_json(verdict.model_dump(mode="json", by_alias=True))
    else:
        _print_verdict(verdict)
    given = format_options(
        base=options.base, rules=options.rules, base_tables=options.base_tables, model="constant-velocity"
    )
    score = f"challenge score {shlex.quote(str(options.root))}{given}{repeat_out_option(options.out)}"
    print_next_steps(
        f"verdict: {file}{f', {page} in any browser' if options.page else ''}",
        (score, "planners on it") if verdict.accepted else None,
        json_output=options.json_output,
    )
    raise typer.Exit(0 if verdict.accepted else 1)


def name_entries(roots: Sequence[Path]) -> dict[str, Path]:
    """Roots of entries by name: the folder, with as many of those above as tell entries apart."""
    resolved = [root.resolve() for root in roots]
    if twice := next((root for root, own in zip(roots, resolved, strict=True) if resolved.count(own) > 1), None):
        raise InputError(f"the entry {twice} is named twice; name each entry once")
    parts = [Path(os.path.normpath(root.absolute())).parts for root in roots]
    count = 1
    while len({own[-count:] for own in parts}) < len(parts):
        count += 1
    return {"/".join(own[-count:]): root for own, root in zip(parts, roots, strict=True)}


def _print_verdict(verdict: "EntryVerdict") -> None:
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
    typer.echo(f"{accepted} of {pluralise(len(verdict.scenes), 'scene')} of {verdict.entry.name} accepted")


@dataclass(frozen=True, slots=True, kw_only=True)
class ChallengeScoreOptions:
    """Options of ``challenge score``."""

    roots: Annotated[
        tuple[Path, ...], Option("Roots of entries; names that are alike get their folders.", "Input", names="")
    ]
    base: BaseOption
    model: Annotated[tuple[str, ...], Option("Planner by name or module:Class; may be repeated.", "Planner")]
    rules: RulesOption = None
    protocol: Annotated[str, Option("Who judges the plans; native: each planner's own.", "Output")] = "exact"
    horizon: Annotated[Horizon, Option("Whose collision rate ranks; avg is the mean of the three.", "Output")] = "avg"
    out: shared.Out = api.OUT
    base_tables: BaseTablesOption = None
    device: shared.NetworkDevice = None
    precision: shared.Precision = None
    seed: shared.Seed = 0
    workers: shared.Workers = 0
    wide: shared.Wide = False
    json_output: shared.Json = False


@command(ChallengeScoreOptions, app, "score")
def challenge_score_command(options: ChallengeScoreOptions) -> None:
    """Check entries, let planners drive on them, rank them, and say which places are not told apart."""
    from benchmark.extensions.challenge.rules import read_rules
    from benchmark.extensions.challenge.scoring import ScoreSettings, score_entries
    from benchmark.machine.path_checks import require_file, require_folder, require_place
    from benchmark.protocols import find_protocol as known_protocol
    from benchmark.records.challenge import write_scores
    from benchmark.records.run import NATIVE
    from leaderboard.extensions.challenge.tables import challenge_tables

    count = api.worker_count(options.workers)
    if options.protocol != NATIVE:
        known_protocol(options.protocol)
    require_file(options.rules, "--rules", (".toml",))
    rules = read_rules(options.rules)
    for root in options.roots:
        require_folder(root, "entry")
    named = api.PlannerSource.of(options, data=options.base).require()
    base = api.DataSource.of(options, data=options.base, tables=options.base_tables)
    base.require()
    require_place(options.out, "--out")
    planners, recordings = named.load(), base.open()
    entries = {name: api.open_data(root) for name, root in name_entries(options.roots).items()}
    folder = api.workspace(options.out).challenge_root()
    settings = ScoreSettings(folder, rules, options.protocol, options.horizon, options.seed, count)
    scores = score_entries(entries, recordings, planners, settings)
    file = write_scores(folder, scores)
    if options.json_output:
        print_json(scores.model_dump(mode="json", by_alias=True))
    else:
        print_tables(challenge_tables(scores), wide=options.wide, verbose=True)
    print_next_steps(
        f"scores: {file}; verdicts and records of the planners: {folder}",
        suggest_leaderboard(options.out, file),
        json_output=options.json_output,
    )
    failed = any(planner_score.failed for entry in scores.entries for planner_score in entry.planners.values())
    raise typer.Exit(1 if failed or not any(entry.best_place for entry in scores.entries) else 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChallengeRulesOptions:
    """Options of ``challenge rules``."""

    rules: Annotated[Path | None, Option("rules.toml to read and complete.", "Input", names="")] = None
    start: Annotated[
        RuleSet, Option("Without a file: the defaults, a stricter set, or one without limits of motion.", names="--set")
    ] = "default"
    json_output: shared.Json = False


@command(ChallengeRulesOptions, app, "rules")
def challenge_rules_command(options: ChallengeRulesOptions) -> None:
    """Print a whole rules.toml, each rule with what it says."""
    from benchmark.extensions.challenge.rules import RULE_SETS, format_rules, read_rules
    from benchmark.machine.path_checks import require_file

    require_file(options.rules, "rules", (".toml",))
    rule_set = RULE_SETS[options.start] if options.rules is None else read_rules(options.rules)
    rules = {"fingerprint": rule_set.fingerprint, "rules": rule_set.model_dump(mode="json", by_alias=True)}
    print_result(rules, format_rules(rule_set), json_output=options.json_output)
