"""Commands on abilities: ``leaderboard ability`` and ``leaderboard next``."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json, print_next_steps, print_result, print_tables, suggest_leaderboard
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import format_options, pluralise

if TYPE_CHECKING:
    from leaderboard.extensions.ability.fit import AbilityFit
    from leaderboard.extensions.ability.next_scenes import NextScenes
    from leaderboard.extensions.ability.outcomes import GatheredOutcomes, Kind

Outcome = Annotated[
    Literal["contact", "score"],
    Option("What a cell is: contact (safe or not), or score (0 to 1; docs/extensions/ability.md).", "Input"),
]
Drives = Annotated[bool, Option("Closed loop: from records of drives.", "Input")]
MaxSeconds = Annotated[
    float, Option("Give no number if the chains do not agree within so many seconds of processor time.", "Execution")
]


@dataclass(frozen=True, slots=True, kw_only=True)
class AbilityOptions:
    """Options of ``leaderboard ability``."""

    split: shared.Split = "adv"
    data: shared.Data = "mini"
    outcome: Outcome = "contact"
    drives: Drives = False
    out: shared.Out = api.OUT
    records: shared.Records = None
    seed: shared.Seed = 0
    max_seconds: MaxSeconds = 600.0
    wide: shared.Wide = False
    verbose: shared.Verbose = False
    json_output: shared.Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class NextOptions:
    """Options of ``leaderboard next``."""

    model: Annotated[str, Option("Planner whose rank is to be sharpened, as in the tables.", "Planner")]
    split: shared.Split = "adv"
    count: Annotated[int, Option("Number of scenes.", "Output", min=1)] = 5
    data: shared.Data = "mini"
    outcome: Outcome = "contact"
    drives: Drives = False
    out: shared.Out = api.OUT
    records: shared.Records = None
    seed: shared.Seed = 0
    max_seconds: MaxSeconds = 600.0
    json_output: shared.Json = False


@command(AbilityOptions)
def ability_command(options: AbilityOptions) -> None:
    """Fit abilities of all planners and difficulties of all scenes of a split together, and store them."""
    gathered = _gather(options)
    fit, path = fit_abilities(gathered, options.out, seed=options.seed, max_seconds=options.max_seconds)
    from leaderboard.extensions.ability.fit import StoredFit
    from leaderboard.extensions.ability.tables import ability_table

    tables = [ability_table(StoredFit(fit, current=True))]
    if options.json_output:
        print_json({"file": str(path), "fit": fit.model_dump(mode="json", by_alias=True, exclude={"kept"})})
        return
    print_tables(tables, wide=options.wide, verbose=options.verbose)
    print_next_steps(f"fit: {path}", suggest_leaderboard(options.out, path), json_output=options.json_output)


@command(NextOptions)
def next_command(options: NextOptions) -> None:
    """Print the scenes that would sharpen a planner's rank most, and the command that runs them."""
    gathered = _gather(options)
    fit = _find_or_fit(gathered, options)
    from leaderboard.extensions.ability.fit import require_planner
    from leaderboard.extensions.ability.next_scenes import choose_next_scenes

    planner = require_planner(fit, options.model)
    chosen = choose_next_scenes(fit, planner, options.count)
    names = ",".join(each.scene for each in chosen.scenes)
    verb = "drive" if options.drives else "eval"
    out = None if options.out == api.OUT else options.out
    given = format_options(model=options.model, data=options.data, split=options.split, scenes=names, out=out)
    run = f"challenger-bench {verb}{given}"
    value: dict[str, Any] = {
        "model": options.model,
        "average": planner is None,
        "scenes": [
            {"scene": each.scene, "recording": each.recording, "deviation": each.deviation} for each in chosen.scenes
        ],
        "deviation": chosen.deviation,
        "expected_loss": chosen.loss,
        "left": chosen.left,
        "command": run,
    }
    print_result(
        value, _describe(options.model, chosen, average=planner is None, run=run), json_output=options.json_output
    )


def _describe(model: str, chosen: "NextScenes", *, average: bool, run: str) -> str:
    who = f"{model} has no record here: for an average planner" if average else model
    lines = [f"{who}: standard deviation of the ability {chosen.deviation:.2f} now, expected after each scene:"]
    width = max(len(each.scene) for each in chosen.scenes)
    lines += [f"  {each.scene:<{width}}  {each.deviation:.2f}  (of {each.recording})" for each in chosen.scenes]
    loss = f"{chosen.loss:.2f}, {100.0 * chosen.loss / chosen.deviation:.0f} %"
    some = pluralise(len(chosen.scenes), "scene")
    lines.append(f"expected loss with {some} of {chosen.left} that it has not run: {loss}")
    return "\n".join([*lines, f"run: {run}"])


def _gather(options: AbilityOptions | NextOptions) -> "GatheredOutcomes":
    from benchmark.machine.path_checks import require_folder

    for place in options.records or ():
        require_folder(place, "--records")
    if not options.max_seconds > 0.0:
        raise InputError(f"--max-seconds is {options.max_seconds:g}; it must be above 0")
    return gather_recorded(
        options.data, options.split, options.outcome, out=options.out, records=options.records, drives=options.drives
    )


def gather_recorded(
    data: str = "mini",
    split: str = "adv",
    outcome: "Kind" = "contact",
    *,
    out: Path = api.OUT,
    records: Sequence[Path] | None = None,
    drives: bool = False,
) -> "GatheredOutcomes":
    """Outcomes of all planners on a split, from records.

    Args:
        data: ``mini``, ``demo`` or the root of the data set.
        split: The split.
        outcome: ``contact`` or ``score``.
        out: The output folder.
        records: Folders of records, if not all of the output folder.
        drives: Whether the records are of drives.

    Returns:
        The outcomes, whose matrix may have holes.

    Raises:
        InputError: If there are no such records.
    """
    from benchmark.records.drives import find_drives
    from benchmark.records.run import find_records
    from leaderboard.extensions.ability.outcomes import choose_gathered, gather_outcomes

    space = api.workspace(out)
    folders = list(records or [space.drive_root() if drives else space.run_root()])
    missing = [folder for folder in folders if not folder.is_dir()]
    if missing:
        verb = "drive" if drives else "eval"
        raise InputError(
            f"there are no records below {missing[0]}; run challenger-bench {verb} first, or name --records"
        )
    runs = [] if drives else find_records(*folders)
    driven = find_drives(*folders) if drives else []
    gathered = gather_outcomes(runs, driven, outcome, "closed" if drives else "open")
    return choose_gathered(gathered, Path(data).resolve().name, split)


def fit_abilities(
    gathered: "GatheredOutcomes", out: Path = api.OUT, *, seed: int = 0, max_seconds: float = 600.0
) -> "tuple[AbilityFit, Path]":
    """Fit abilities and difficulties together, and store them below an output folder.

    Args:
        gathered: What all planners did (`gather_recorded`).
        out: The output folder.
        seed: Of the sampler.
        max_seconds: Seconds of processor time after which it gives up.

    Returns:
        The fit and its file.

    Raises:
        InputError: If there are too few planners or recordings, numpyro is not installed, or the chains do not agree.
    """
    from leaderboard.extensions.ability.fit import summarise_posterior, write_fit
    from leaderboard.extensions.ability.sampling import fit_posterior

    matrix = gathered.matrix
    matrix.require_enough()
    posterior = fit_posterior(matrix, seed=seed, max_seconds=max_seconds)
    fit = summarise_posterior(posterior, gathered)
    return fit, write_fit(out, fit)


def _find_or_fit(gathered: "GatheredOutcomes", options: NextOptions) -> "AbilityFit":
    """The stored fit of exactly these records, or a new one."""
    from leaderboard.extensions.ability.fit import find_fit_path, read_fit

    path = find_fit_path(options.out, gathered.measured)
    if path.is_file():
        stored = read_fit(path)
        if tuple(stored.records) == gathered.records and stored.seed == options.seed:
            return stored
    return fit_abilities(gathered, options.out, seed=options.seed, max_seconds=options.max_seconds)[0]
