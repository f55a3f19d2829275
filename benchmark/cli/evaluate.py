"""Commands that judge planners: ``eval``, ``rescore`` and ``transfer``."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.caveats import warn_of_caveats
from benchmark.cli.options import (
    AsPublishedOption,
    ByOption,
    CategoriesOption,
    DataOption,
    DryRunOption,
    ImageFormatOption,
    JsonOption,
    LimitOption,
    MemoryLimitOption,
    OutOption,
    PlanFrameOption,
    RecordsOption,
    SampleLimitOption,
    ScenesOption,
    SeedOption,
    ShardOption,
    SliceName,
    SplitOption,
    TablesOption,
    WideOption,
    WorkersOption,
    name_list,
    print_json,
    say_plan,
)
from benchmark.cli.result_files import ReadAs, opened_results, results_planner, write_dumps
from benchmark.cli.shards import say_shard
from benchmark.cli.what_next import same_place, say_next
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.evaluation import EvalSettings
    from benchmark.machine.workspace import Workspace
    from benchmark.metrics.transfer import TransferMatrix
    from benchmark.records.run import RunRecord
    from benchmark.runs.plan_rows import PlannerFactory
    from benchmark.runs.shards import Shard


def eval_command(
    model: Annotated[
        list[str],
        typer.Option(
            "--model", metavar="<str>", help="Planner name, package.module:Class or http://HOST:PORT; may be repeated."
        ),
    ] = [],  # noqa: B006 - typer reads the default, nothing changes it
    split: Annotated[
        list[str],
        typer.Option(
            "--split", metavar="<str>", help="val, val-r, adv, or a split of the data set's own; may be repeated."
        ),
    ] = ["val"],  # noqa: B006 - typer reads the default, nothing changes it
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    categories: CategoriesOption = None,
    plans: Annotated[Path | None, typer.Option(help="Plan file (CSV, Parquet, JSON) instead of a model.")] = None,
    results: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="<path>",
            help="Result file that a planner's own repository wrote, or a folder of them; may be repeated.",
        ),
    ] = None,
    results_format: Annotated[
        str, typer.Option("--format", help="With --results: auto tells it by content (docs/your-results.md).")
    ] = "auto",
    name: Annotated[str | None, typer.Option(help="With --results: name of the planner in tables.")] = None,
    dump_results: Annotated[
        str | None, typer.Option(metavar="<str>", help="Also write the plans as a repository's result file.")
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(
            help="Where a network runs: cpu, cuda, cuda:1, or cuda:0,cuda:1 for a process on each; else the first GPU."
        ),
    ] = None,
    precision: Annotated[str | None, typer.Option(help="Of a network: float32 or bfloat16.")] = None,
    native: Annotated[
        str | None,
        typer.Option(help="With --plans or --results: the protocol of the repository that the planner comes from."),
    ] = None,
    frame: PlanFrameOption = None,
    as_is: Annotated[
        bool,
        typer.Option(
            "--as-is",
            help="With --plans or --results: judge plans as they stand, even if they fit far better otherwise; marked.",
        ),
    ] = False,
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    as_published: AsPublishedOption = None,
    image_format: ImageFormatOption = None,
    sample_limit: SampleLimitOption = None,
    memory_limit: MemoryLimitOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    shard: ShardOption = None,
    unchanged: Annotated[
        str | None,
        typer.Option(
            metavar="<root>",
            help="Data set whose recordings the scenes of --split were made from, where --data lacks them: Adv-nuSc.",
        ),
    ] = None,
    allow_partial: Annotated[
        bool,
        typer.Option(
            "--allow-partial", help="Print rates even where the planner failed on samples; --plans may lack rows."
        ),
    ] = False,
    protocol: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<str>",
            help="Tables to print: a protocol, native, pdm or all; may be repeated. Judges that are not standard join.",
        ),
    ] = None,
    by: ByOption = None,
    explain_protocols: Annotated[
        bool,
        typer.Option("--explain-protocols", help="Where each protocol differs from exact, why, and pictures of it."),
    ] = False,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    wide: WideOption = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Run planners on splits, write run records, and print the tables."""
    from benchmark.cli.preflight_data_sets import require_data, unchanged_name
    from benchmark.cli.preflight_names import (
        require_categories,
        require_models,
        require_published_runs,
        supervision_of,
    )
    from benchmark.cli.preflight_over_http import require_frame, require_servers
    from benchmark.cli.preflight_places import require_place, require_plans
    from benchmark.evaluation import EvalSettings, evaluate_together, require_whole_split
    from benchmark.machine.several_devices import require_one_device, workers_for
    from benchmark.protocols import PROTOCOLS, STANDARD
    from benchmark.records.reproduction import find_reproductions, with_reproductions
    from benchmark.records.seed_splits import is_adversarial
    from benchmark.runs.shards import Shard

    if not model and plans is None and not results:
        raise InputError(
            "name a planner with --model (for example constant-velocity), a plan file with --plans or a result file "
            "with --results"
        )
    if native is not None and plans is None and not results:
        raise InputError("--native belongs to --plans and --results; planners that --model names say it themselves")
    if as_is and plans is None and not results:
        raise InputError(
            "--as-is belongs to --plans and --results; the plans of running planners are judged in any case"
        )
    require_models(model, checkpoint, data=data, device=device, precision=precision)
    shown, count = _protocols_to_show(protocol), api.worker_count(workers_for(workers, device))
    mine = None if shard is None else Shard.named(shard)
    if mine is not None:
        require_one_device(device, "a shard plans in one process, on a device of its own")
    supervision = supervision_of(model, sample_limit, memory_limit)
    published = tuple(each.value for each in as_published or ())
    if require_published_runs(model, checkpoint, published, data=data):
        require_one_device(device, "who remembers across scenes plans all of them in one process")
        require_whole_split("the model", name_list(scenes), limit, workers)
        count = 1
    require_categories(categories)
    require_frame(model, None if frame is None else frame.value, of_file=plans is not None or bool(results))
    require_servers(model, image_format)
    if plans is not None:
        require_plans(plans, native)
    opened = opened_results(results, results_format, name, native, dump_results)
    # Unchanged recordings first: the records of the others say which of theirs they are compared with.
    splits = tuple(sorted(dict.fromkeys(split), key=is_adversarial))
    _require_one_split(splits, plans=plans, results=results, dump_results=dump_results, shard=shard)
    every_ahead = {
        each: require_data(data, tables, each, out, scenes=name_list(scenes), limit=limit) for each in splits
    }
    elsewhere = unchanged_name(unchanged, out)
    require_place(out, "--out")
    if dry_run and any(ahead.builds for ahead in every_ahead.values()):
        running = [api.model_that_runs(each, checkpoint, data=data) for each in model]
        runs = [*running, *([] if plans is None else [str(plans)]), *map(str, results or ())]
        planned = [
            line
            for each, ahead in every_ahead.items()
            for line in ahead.plan(f"run {', '.join(runs)} on {ahead.counted()} of {each}")
        ]
        say_plan(list(dict.fromkeys(planned)), json_output=json_output)
        return
    judges = tuple(dict.fromkeys([*STANDARD, *(name for name in shown or () if name in PROTOCOLS)]))
    run_root = api.workspace(out).run_root()
    timings = api.workspace(out).timings_of(run_root)
    asked = () if "all" in (protocol or ()) else tuple(shown or ())
    settings = EvalSettings(
        judges, name_list(scenes), limit, count, seed, timings=timings, asked=asked, unchanged=elsewhere
    )
    over_http = {
        name: option.value for name, option in (("image_format", image_format), ("frame", frame)) if option is not None
    }
    # Planners first: a stranger's class may not be importable, and data may take minutes to build.
    factories: list[PlannerFactory] = [
        api.load_planner(
            each,
            checkpoint,
            data=data,
            seed=seed,
            device=device,
            precision=precision,
            as_published=published,
            over_http=over_http,
            supervision=supervision,
        )
        for each in model
    ]
    source = api.open_data(data, tables=tables, workers=workers, out=out, categories=categories)
    dataset = api.open_split(source, splits[0], out, workers=workers)
    read_as: ReadAs = {"frame": None if frame is None else frame.value, "as_is": as_is}
    if plans is not None:
        from adapters.plan_file import plan_file_factory

        chosen = settings.chosen(dataset, splits[0])
        from_file = plan_file_factory(
            plans,
            dataset,
            splits[0],
            scenes=chosen,
            native=native,
            records=[run_root],
            allow_partial=allow_partial,
            **read_as,
        )
        for sentence in from_file.sentences:
            api.tell(sentence)
        factories.append(from_file)
    if opened:
        chosen = settings.chosen(dataset, splits[0])
        factories.append(
            results_planner(opened, dataset, splits[0], scenes=chosen, name=name, native=native, read_as=read_as)
        )
    if dry_run:
        names = ", ".join(factory.facts.name for factory in factories)
        opened_splits = {each: api.open_split(source, each, out, workers=workers) for each in splits}
        where = [
            f"{counted(len(settings.chosen(one, each)), 'scene')} of {each}" for each, one in opened_splits.items()
        ]
        say_plan([f"would run {names} on {each}" for each in where], json_output=json_output)
        return
    planners = [(each, _also_by_its_own(settings, each)) for each in factories]
    if mine is not None:
        _plan_shard(
            dataset,
            splits[0],
            planners,
            run_root,
            mine,
            json_output=json_output,
            again=same_place(data, out, tables, categories),
        )
        return
    records: list[RunRecord] = []
    for place, each in enumerate(splits):
        here = dataset if place == 0 else api.open_split(source, each, out, workers=workers)
        of_split = with_reproductions(evaluate_together(here, each, planners, run_root), find_reproductions([run_root]))
        if explain_protocols:
            _explain(source.name, here, of_split, api.workspace(out), wide=wide, json_output=json_output)
        records += of_split
    warn_of_caveats(record.run for record in records)
    dumped = write_dumps(records, dataset, splits[0], dump_results, api.workspace(out))
    sound = _show_runs(
        source.name, records, shown, by or (), run_root, allow_partial=allow_partial, wide=wide, json_output=json_output
    )
    again = same_place(data, out, tables, categories)
    say_next(
        "; ".join([f"records: {', '.join(str(record.directory) for record in records)}", *dumped]),
        (f"sheets --split {splits[-1]}{again}", "what films and the site show of the scenes"),
        (f"leaderboard{same_place('mini', out)}", "tables, figures and a site of all records"),
        json_output=json_output,
    )
    if not sound:
        raise typer.Exit(1)


def _require_one_split(splits: tuple[str, ...], **options: object) -> None:
    """Refuse several splits with what belongs to one."""
    given = next((name for name, value in options.items() if value), None)
    if len(splits) > 1 and given is not None:
        option = given.replace("_", "-")
        raise InputError(f"--{option} belongs to one split, and --split names {', '.join(splits)}; give one at a time")


def _plan_shard(
    dataset: "DataSet",
    split: str,
    planners: "Sequence[tuple[PlannerFactory, EvalSettings]]",
    root: Path,
    shard: "Shard",
    *,
    json_output: bool,
    again: str,
) -> None:
    """Plan one shard and say what is left to do."""
    from benchmark.evaluation import plan_shard

    found = plan_shard(dataset, split, planners, root, shard)
    step = (f"eval{again}", "with the same options and no --shard, when all shards are")
    say_shard(shard, found, "planned", step, json_output=json_output)


def rescore_command(
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    records: RecordsOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Judge stored plans anew, of run records under every protocol and of drives, without running a planner."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.cli.preflight_places import require_folder
    from benchmark.runs.rescoring import rescore_all
    from benchmark.runs.rescoring_drives import rescore_all_drives

    place = api.workspace(out)
    folders = records or [root for root in (place.run_root(), place.drive_root()) if root.is_dir()]
    api.worker_count(workers)
    require_root(data, tables, out)
    for folder in records or ():
        require_folder(folder, "--records")
    if not folders:
        raise InputError(
            f"there are no run records at {place.run_root()} and no drives at {place.drive_root()}; run "
            "challenger-bench eval first, or challenger-bench drive"
        )
    source = api.open_data(data, tables=tables, workers=workers, out=out)
    opener = partial(api.open_split, source, out=out, workers=workers)
    results = [
        result
        for folder in folders
        for found in (rescore_all(folder, opener, source.name), rescore_all_drives(folder, opener, source.name))
        for result in found
    ]
    if json_output:
        print_json([{"directory": str(result.directory), "says": result.sentence} for result in results])
    else:
        for result in results:
            typer.echo(f"{result.directory}: {result.sentence}")
    raise typer.Exit(1 if any(result.failed for result in results) else 0)


class MapName(StrEnum):
    """Which picture of the transfer between planners."""

    TRANSFER = "transfer"
    ADVERSARY = "adversary"
    LIFT = "lift"


def transfer_command(
    split: SplitOption = "adv",
    out: OutOption = api.OUT,
    records: RecordsOption = None,
    protocol: Annotated[str, typer.Option(help="Whose verdicts count; native: of each planner's own.")] = "exact",
    data: Annotated[str | None, typer.Option("--data", help="Only records of the data set of this name.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Write a heat map to this .png or .svg file.")] = None,
    figure_of: Annotated[
        MapName,
        typer.Option(
            help="Of what: transfer of any failure, of contacts with the adversary, or lift and φ of the latter (of "
            "any failure where records do not say whom contacts are with)."
        ),
    ] = MapName.TRANSFER,
    pairs: Annotated[bool, typer.Option("--pairs", help="Also a row for every two planners.")] = False,
    wide: WideOption = False,
    json_output: JsonOption = False,
) -> None:
    """Show who else fails the scenes that one planner fails: the surrogate-filtered matrix, from run records."""
    from benchmark.cli.preflight_places import require_output_file
    from benchmark.metrics.disagreement import EXACT
    from benchmark.protocols import protocol as known_protocol
    from benchmark.records.inventory import recorded, said_of
    from benchmark.records.run import NATIVE, find_records
    from benchmark.report.plots import FORMATS
    from leaderboard.figures.heat_map import write_heat_map, write_lift_map
    from leaderboard.tables.transfer import agreement_table, lift_table, transfer_matrices, transfer_table

    if protocol != NATIVE:
        known_protocol(protocol)
    require_output_file(figure, "--figure", FORMATS)
    folders = records or [api.workspace(out).run_root()]
    known = find_records(*folders)
    for record in known:
        if record.run.split == split and not record.covers_split:
            typer.echo(f"left out: {record.directory} holds a part of the split only", err=True)
    matrices = transfer_matrices(known, split, protocol=protocol, data=data)
    if not matrices:
        raise InputError(
            f"no complete run records of split {split!r} below {', '.join(map(str, folders))}"
            f"{'' if data is None else f' for data set {data!r}'}; {said_of(recorded(folders))}; name one of these or "
            f"run challenger-bench eval --split {split} first"
        )
    if figure is not None:
        if len(matrices) > 1:
            raise InputError(f"--figure draws one matrix and there are {', '.join(matrices)}; choose one with --data")
        ((name, drawn),) = matrices.items()
        of_adversary = _of_adversary(known, split, name) if protocol == EXACT else []
        if figure_of is MapName.ADVERSARY and not of_adversary:
            raise InputError(
                "--figure-of adversary needs two records that say whom contacts are with, judged by exact; "
                "challenger-bench rescore brings that to older ones"
            )
        drawn = drawn if figure_of is MapName.TRANSFER else (*of_adversary, drawn)[0]
        (write_lift_map if figure_of is MapName.LIFT else write_heat_map)(drawn, figure)
    if json_output:
        print_json(
            {
                name: {
                    **asdict(matrix),
                    "adversary": [asdict(one) for one in _of_adversary(known, split, name)]
                    if protocol == EXACT
                    else [],
                }
                for name, matrix in matrices.items()
            }
        )
        return
    for name, matrix in matrices.items():
        shown = [matrix] if protocol != EXACT else [matrix, *_of_adversary(known, split, name)]
        for one in shown:
            typer.echo(transfer_table(name, one).plain(wide=wide))
            typer.echo(lift_table(name, one).plain(wide=wide))
            if pairs:
                typer.echo(agreement_table(name, one).plain(wide=wide))


def _of_adversary(known: "Sequence[RunRecord]", split: str, data: str) -> "list[TransferMatrix]":
    """The matrix of contacts with the adversary alone, where the records say whom contacts are with."""
    from benchmark.metrics.effect import says_whom
    from leaderboard.tables.transfer import transfer_matrices

    telling = [record for record in known if record.run.split != split or says_whom(record)]
    found = transfer_matrices(telling, split, data=data, adversary_only=True)
    return [matrix for matrix in found.values() if len(matrix.planners) > 1]


def _also_by_its_own(settings: "EvalSettings", factory: "PlannerFactory") -> "EvalSettings":
    """The settings with the planner's own protocol among the judges, if it has one."""
    own = factory.facts.native_protocol
    return settings if own is None else replace(settings, protocols=tuple(dict.fromkeys([*settings.protocols, own])))


def _protocols_to_show(names: list[str] | None) -> tuple[str, ...] | None:
    """What ``--protocol`` asks for; ``None`` is the default: exact, and the planners' own where they have one."""
    from benchmark.pdm.definition import PDM
    from benchmark.protocols import PROTOCOLS, protocol
    from benchmark.records.run import NATIVE

    if names is None:
        return None
    if "all" in names:
        return (*PROTOCOLS, PDM)
    return tuple(dict.fromkeys(name if name in (NATIVE, PDM) else protocol(name).name for name in names))


def _explain(
    data_name: str,
    dataset: "DataSet",
    records: "Sequence[RunRecord]",
    space: "Workspace",
    *,
    wide: bool,
    json_output: bool,
) -> None:
    """Where protocols differ from exact on these runs: the table, and a picture of the clearest case of each cause."""
    from benchmark.machine.extension import from_extension
    from leaderboard.tables.disagreement import disagreement_table

    split = records[0].run.split
    folder = space.out / "explained" / data_name / split
    pictures = from_extension("judge", "explanation")(records, dataset, folder)
    typer.echo(disagreement_table(data_name, split, records).plain(wide=wide), err=json_output)
    for picture in pictures:
        typer.echo(f"{picture.path}: {picture.sentence}", err=json_output)


def _show_runs(
    data_name: str,
    records: "Sequence[RunRecord]",
    protocols: tuple[str, ...] | None,
    by: "Sequence[SliceName]",
    run_root: Path,
    *,
    allow_partial: bool,
    wide: bool,
    json_output: bool,
) -> bool:
    """Print the tables of runs; whether all is well: a run that failed on samples is not unless that is allowed."""
    from benchmark.metrics.attacks import attack_facts
    from benchmark.metrics.effect import effect_facts
    from benchmark.metrics.slices import kinds_named
    from benchmark.metrics.unchanged import unchanged_candidates, unchanged_record
    from benchmark.runs.failures import FAILURES_FILE, first_failure
    from leaderboard.tables.collision import run_tables
    from leaderboard.tables.slices import run_slices

    partial = [record for record in records if not record.complete]
    # The table that compares is shown where none is asked for by name.
    against = unchanged_candidates(run_root, records) if json_output or protocols is None else []
    sliced = run_slices(data_name, records, kinds_named(by), protocols, allow_partial=allow_partial)
    if json_output:
        rows = [
            {
                "directory": str(r.directory),
                "status": r.run.status,
                **r.summary.model_dump(mode="json"),
                **attack_facts(r),
                **effect_facts(r, unchanged_record(r, (*against, *records))),
            }
            for r in records
        ]
        print_json({"runs": rows, "slices": [table.as_json() for table in sliced]} if by else rows)
    else:
        shown = run_tables(data_name, records, protocols, allow_partial=allow_partial, against=against)
        for table in (*shown, *sliced):
            typer.echo(table.plain(wide=wide))
    for record in partial:
        typer.echo(
            f"{record.planner} failed on {record.summary.failed} of {counted(record.summary.samples, 'sample')} "
            f"(the first: {first_failure(record.rows)}; all tracebacks: {record.directory / FAILURES_FILE}); "
            + ("rates leave them out" if allow_partial else "--allow-partial prints the rates of the others"),
            err=True,
        )
    return allow_partial or not partial
