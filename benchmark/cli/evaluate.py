"""Command that judges planners, ``eval``, and plans that others made, as it reads and writes them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from benchmark import api
from benchmark.cli.eval_options import EvalOptions
from benchmark.cli.options import parse_name_list, parse_shard
from benchmark.cli.output import (
    print_json,
    print_next_steps,
    print_plan,
    print_shard_progress,
    repeat_data_options,
    repeat_out_option,
    warn_of_caveats,
)
from benchmark.cli.settings import command, take_options
from benchmark.errors import InputError
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from adapters.registry import NamedPlanner
    from adapters.result_files.recognition import RecognisedFile
    from benchmark.api import PlannerSource
    from benchmark.datasets.roots import DataSet
    from benchmark.evaluation import EvalSettings
    from benchmark.machine.workspace import Workspace
    from benchmark.records.run import RunRecord
    from benchmark.runs.plan_rows import PlannerFactory

_LONGEST_NAME: Final = 100
"""Characters of a planner's name in tables."""


def open_result_files(options: "EvalOptions") -> "list[RecognisedFile]":
    """Result files of ``--results`` with their formats; the file of ``--plans`` is checked too, before any build."""
    from adapters.result_files.recognition import AUTO, recognise, require_format
    from adapters.result_files.writing.formats import require_writable
    from benchmark.machine.path_checks import require_file
    from benchmark.runs.planner_facts import require_known_native

    plans, paths, wanted = options.plans, options.results, options.results_format
    if plans is not None:
        require_known_native(options.native, f"plan file {plans}")
        require_file(plans, "--plans", (".csv", ".parquet", ".json"))
        # Slow to import.
        from adapters.plan_file import read_plan_file

        read_plan_file(plans)
    if options.dump_results is not None:
        require_writable(options.dump_results)
    if not paths:
        if wanted != AUTO:
            raise InputError("--format needs --results; add it")
        return []
    require_format(wanted)
    require_known_native(options.native, f"result file {paths[0]}")
    return [recognise(path, wanted) for path in paths]


def load_file_planners(
    options: "EvalOptions",
    opened: "Sequence[RecognisedFile]",
    dataset: "DataSet",
    split: str,
    scenes: tuple[str, ...],
    run_root: Path,
) -> "list[PlannerFactory]":
    """The planners of a plan file and of opened result files; what was found in them is said on stderr."""
    from adapters.plan_file import plan_file_factory
    from adapters.result_files.planner import result_file_factory

    read_as: dict[str, Any] = {"scenes": scenes, "native": options.native, "frame": options.frame}
    read_as |= {"as_is": options.as_is, "name": options.name}
    factories: list[Any] = []
    if options.plans is not None:
        partial = options.allow_partial
        factories.append(
            plan_file_factory(options.plans, dataset, split, records=[run_root], allow_partial=partial, **read_as)
        )
    if opened:
        factories.append(result_file_factory(opened, dataset, split, **read_as))
    for factory in factories:
        for sentence in factory.sentences:
            api.notify(sentence)
    return factories


def write_dumps(
    records: "Sequence[RunRecord]", dataset: "DataSet", split: str, name: str | None, space: "Workspace"
) -> list[str]:
    """Write the plans of records as result files, if asked to; what was written, in words."""
    if name is None:
        return []
    from adapters.result_files.samples import read_recorded_samples
    from adapters.result_files.writing.formats import write_results

    samples = read_recorded_samples(dataset, split)
    runs = space.run_root()
    written = [
        write_results(record, samples, name, space.out / "result-files" / record.directory.relative_to(runs) / name)
        for record in records
    ]
    return [f"result files: {', '.join(map(str, written))}"]


@command(EvalOptions)
def eval_command(options: EvalOptions) -> None:
    """Run planners on splits, write run records, and print the tables."""
    from benchmark.machine.path_checks import require_place
    from benchmark.records.seed_splits import is_adversarial

    # What is quick to refuse comes before what is slow to import.
    _require_planner(options)
    _require_name(options)
    own = take_options("planner", options.model)
    planners = api.PlannerSource.of(options, of_extensions=own).require()
    protocols, scenes = _protocols_to_show(options.protocol), parse_name_list(options.scenes)
    shard = parse_shard(options.shard)
    count = _processes(options, planners)
    planners.require_frame(of_file=options.plans is not None or bool(options.results))
    planners.require_servers()
    opened = open_result_files(options)
    # Unchanged recordings first: records of other splits name the record that they are compared with.
    splits = tuple(sorted(dict.fromkeys(options.split), key=is_adversarial))
    _require_one_split(splits, options)
    data = api.DataSource.of(options)
    every_ahead = {split: data.require_split(split, scenes, options.limit) for split in splits}
    elsewhere = None
    if options.unchanged is not None:
        unchanged = api.DataSource(options.unchanged, out=options.out)
        unchanged.require()
        elsewhere = unchanged.name
    require_place(options.out, "--out")
    if options.dry_run and any(ahead.builds for ahead in every_ahead.values()):
        files = [] if options.plans is None else [str(options.plans)]
        runs = [*planners.runnable_names, *files, *map(str, options.results or ())]
        planned = [
            line
            for split, ahead in every_ahead.items()
            for line in ahead.plan(f"run {', '.join(runs)} on {ahead.counted()} of {split}")
        ]
        print_plan(list(dict.fromkeys(planned)), json_output=options.json_output)
        return
    # Planners first: importing a class of another package may fail, and data may take minutes to build.
    factories: list[PlannerFactory] = [_rename_planner(planner, options.name) for planner in planners.load()]
    from benchmark.evaluation import EvalSettings, evaluate_together
    from benchmark.protocols import PROTOCOLS, STANDARD
    from benchmark.records.reproduction import find_reproductions, with_reproductions

    space = api.workspace(options.out)
    run_root = space.run_root()
    settings = EvalSettings(
        tuple(dict.fromkeys([*STANDARD, *(name for name in protocols or () if name in PROTOCOLS)])),
        scenes,
        options.limit,
        count,
        options.seed,
        timings=space.timings_of(run_root),
        asked=() if "all" in (options.protocol or ()) else protocols or (),
        unchanged=elsewhere,
    )
    source = data.open()
    dataset = data.open_split(splits[0], source)
    if options.plans is not None or opened:
        chosen = settings.chosen(dataset, splits[0])
        factories += load_file_planners(options, opened, dataset, splits[0], chosen, run_root)
    if options.dry_run:
        names = ", ".join(factory.facts.name for factory in factories)
        chosen_of = {split: settings.chosen(data.open_split(split, source), split) for split in splits}
        where = [f"{pluralise(len(chosen), 'scene')} of {split}" for split, chosen in chosen_of.items()]
        print_plan([f"would run {names} on {split}" for split in where], json_output=options.json_output)
        return
    judged = [(split, _with_native_protocol(settings, split)) for split in factories]
    again = repeat_data_options(options)
    if shard is not None:
        from benchmark.evaluation import plan_shard

        step = (f"eval{again}", "with the same options and no --shard, once all shards are done")
        done = plan_shard(dataset, splits[0], judged, run_root, shard)
        print_shard_progress(shard, done, "planned", step, json_output=options.json_output)
        return
    records: list[RunRecord] = []
    for place, split in enumerate(splits):
        split_data = dataset if place == 0 else data.open_split(split, source)
        of_split = with_reproductions(
            evaluate_together(split_data, split, judged, run_root), find_reproductions([run_root])
        )
        if options.explain_protocols:
            _explain(source.name, split_data, of_split, options)
        records += of_split
    warn_of_caveats(record.run for record in records)
    dumped = write_dumps(records, dataset, splits[0], options.dump_results, space)
    sound = _show_runs(
        source.name,
        records,
        protocols,
        options.by or (),
        run_root,
        allow_partial=options.allow_partial,
        wide=options.wide,
        json_output=options.json_output,
    )
    print_next_steps(
        "; ".join([f"records: {', '.join(str(record.directory) for record in records)}", *dumped]),
        (f"sheets --split {splits[-1]}{again}", "draw the scenes for films and the site"),
        (f"leaderboard{repeat_out_option(options.out)}", "write tables, figures and a site of all records"),
        json_output=options.json_output,
    )
    if not sound:
        raise typer.Exit(1)


def _require_planner(options: EvalOptions) -> None:
    """Refuse to judge nothing, and options of files where no file is named."""
    of_file = options.plans is not None or options.results
    if not options.model and not of_file:
        raise InputError(
            "name a planner with --model (for example constant-velocity), a plan file with --plans or a result file "
            "with --results"
        )
    if options.native is not None and not of_file:
        raise InputError("--native is for --plans and --results; planners given with --model state it themselves")
    if options.as_is and not of_file:
        raise InputError(
            "--as-is applies only to --plans and --results; plans of running planners are always evaluated as they are"
        )


def _require_name(options: EvalOptions) -> None:
    """Refuse a name that cannot stand in tables, and one name for several planners."""
    name = options.name
    if name is None:
        return
    if not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME:
        raise InputError(f"--name must be printable text of at most {_LONGEST_NAME} characters")
    planners = len(options.model) + (options.plans is not None) + bool(options.results)
    if planners > 1:
        raise InputError(f"--name {name} names one planner, and the command runs {planners}; run them one at a time")


def _rename_planner(planner: "NamedPlanner", name: str | None) -> "NamedPlanner":
    """The planner whose record and rows of tables have a name of the user's choice, if one is given."""
    return planner if name is None else replace(planner, facts=planner.facts.model_copy(update={"name": name}))


def _processes(options: EvalOptions, planners: "PlannerSource") -> int:
    """How many processes plan: one where a planner remembers across scenes."""
    from benchmark.machine.several_devices import count_workers, require_one_device

    count = api.worker_count(count_workers(options.workers, options.device))
    if options.shard is not None:
        require_one_device(options.device, "a shard plans in one process, on its own device")
    if not planners.remembers_across_scenes():
        return count
    from benchmark.evaluation import require_whole_split

    require_one_device(options.device, "a planner that keeps state across scenes must plan all of them in one process")
    require_whole_split("the model", parse_name_list(options.scenes), options.limit, options.workers)
    return 1


def _require_one_split(splits: tuple[str, ...], options: EvalOptions) -> None:
    """Refuse several splits with what belongs to one."""
    given = next((name for name in ("plans", "results", "dump_results", "shard") if getattr(options, name)), None)
    if len(splits) > 1 and given is not None:
        option = given.replace("_", "-")
        raise InputError(f"--{option} applies to one split, and --split names {', '.join(splits)}; give one at a time")


def _with_native_protocol(settings: "EvalSettings", factory: "PlannerFactory") -> "EvalSettings":
    """The settings with the planner's own protocol among the judges, if it has one."""
    native_protocol = factory.facts.native_protocol
    return (
        settings
        if native_protocol is None
        else replace(settings, protocols=tuple(dict.fromkeys([*settings.protocols, native_protocol])))
    )


def _protocols_to_show(names: tuple[str, ...] | None) -> tuple[str, ...] | None:
    """Protocols that ``--protocol`` asks for; by default (``None``) exact, and the planners' own if they have one."""
    from benchmark.pdm.definition import PDM
    from benchmark.protocols import PROTOCOLS, find_protocol
    from benchmark.records.run import NATIVE

    if names is None:
        return None
    if "all" in names:
        return (*PROTOCOLS, PDM)
    return tuple(dict.fromkeys(name if name in (NATIVE, PDM) else find_protocol(name).name for name in names))


def _explain(data_name: str, dataset: "DataSet", records: "Sequence[RunRecord]", options: EvalOptions) -> None:
    """Where protocols differ from exact on these runs: the table, and a picture of the clearest case of each cause."""
    from benchmark.machine.extension import import_from_extension
    from leaderboard.tables.disagreement import disagreement_table

    split = records[0].run.split
    folder = api.workspace(options.out).out / "explained" / data_name / split
    pictures = import_from_extension("explanation", "protocols")(records, dataset, folder)
    table = disagreement_table(data_name, split, records)
    typer.echo(table.plain(wide=options.wide), err=options.json_output)
    for picture in pictures:
        typer.echo(f"{picture.path}: {picture.sentence}", err=options.json_output)


def _show_runs(
    data_name: str,
    records: "Sequence[RunRecord]",
    protocols: tuple[str, ...] | None,
    by: "Sequence[str]",
    run_root: Path,
    *,
    allow_partial: bool,
    wide: bool,
    json_output: bool,
) -> bool:
    """Print the tables of runs; whether all is well: a run that failed on samples is not unless that is allowed."""
    from benchmark.metrics.attacks import attack_rates_to_json
    from benchmark.metrics.effect import effect_to_json
    from benchmark.metrics.slices import select_kinds
    from benchmark.metrics.unchanged_records import find_unchanged_candidates, find_unchanged_record
    from benchmark.runs.units import FAILURES_FILE, find_first_failure
    from leaderboard.tables.collision import run_tables
    from leaderboard.tables.slices import run_slices

    partial = [record for record in records if not record.complete]
    # The comparison table is shown unless tables are requested by name.
    against = find_unchanged_candidates(run_root, records) if json_output or protocols is None else []
    sliced = run_slices(data_name, records, select_kinds(by), protocols, allow_partial=allow_partial)
    if json_output:
        rows = [
            {
                "directory": str(r.directory),
                "status": r.run.status,
                **r.summary.model_dump(mode="json"),
                **attack_rates_to_json(r),
                **effect_to_json(r, find_unchanged_record(r, (*against, *records))),
            }
            for r in records
        ]
        print_json({"runs": rows, "slices": [table.as_json() for table in sliced]} if by else rows)
    else:
        tables = run_tables(data_name, records, protocols, allow_partial=allow_partial, against=against)
        for table in (*tables, *sliced):
            typer.echo(table.plain(wide=wide))
    for record in partial:
        typer.echo(
            f"{record.planner} failed on {record.summary.failed} of {pluralise(record.summary.samples, 'sample')} "
            f"(the first: {find_first_failure(record.rows)}; all tracebacks: {record.directory / FAILURES_FILE}); "
            + ("the rates exclude them" if allow_partial else "--allow-partial prints the rates of the other samples"),
            err=True,
        )
    return allow_partial or not partial
