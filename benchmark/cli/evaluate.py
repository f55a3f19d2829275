"""Command that judges planners, ``eval``, and plans that others made, as it reads and writes them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

from benchmark import api
from benchmark.cli.eval_options import EvalOptions
from benchmark.cli.options import parse_name_list, parse_shard
from benchmark.cli.output import (
    Step,
    print_json,
    print_next_steps,
    print_plan,
    print_shard_progress,
    print_tables,
    repeat_data_options,
    suggest_leaderboard,
    warn_of_caveats,
)
from benchmark.cli.settings import command, is_given, take_options
from benchmark.cli.splits import choose_splits, describe_default
from benchmark.errors import InputError
from benchmark.machine.address import find_scheme
from benchmark.report.words import format_options, pluralise

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
_OF_OTHER_SAMPLES: Final = ("token", "count", "order")
"""Why a result file is refused that may be of another split."""


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


@command(EvalOptions, panel="Run")
def eval_command(options: EvalOptions) -> None:
    """Run planners on splits, write run records, and print the tables."""
    from benchmark.machine.path_checks import require_place
    from benchmark.records.seed_splits import is_adversarial

    # What is quick to refuse comes before what is slow to import.
    _require_planner(options)
    _require_name(options)
    own = take_options("planner", [find_scheme(name) or name for name in options.model])
    planners = api.PlannerSource.of(options, of_extensions=own).require()
    protocols, scenes = _protocols_to_show(options.protocol), parse_name_list(options.scenes)
    shard = parse_shard(options.shard)
    count = _processes(options, planners)
    planners.require_frame(of_file=options.plans is not None or bool(options.results))
    planners.require_servers()
    opened = open_result_files(options)
    _require_one_split(options)
    data = api.DataSource.of(options)
    # Unchanged recordings first: records of other splits name the record that they are compared with.
    taken = choose_splits(data, sorted(dict.fromkeys(options.split), key=is_adversarial), scenes, options.limit)
    splits = tuple(taken.ahead)
    elsewhere = None
    if options.unchanged is not None:
        unchanged = api.DataSource(options.unchanged, out=options.out)
        unchanged.require()
        elsewhere = unchanged.name
    require_place(options.out, "--out")
    files = [str(path) for path in (options.plans, *(options.results or ())) if path is not None]
    if options.dry_run and any(ahead.builds for ahead in taken.ahead.values()):
        taken.say()
        runs = ", ".join([*planners.runnable_names, *files])
        which = f" if {files[0]} has its samples" if files and len(splits) > 1 else ""
        planned = [
            line
            for split, ahead in taken.ahead.items()
            for line in ahead.plan(f"run {runs} on {ahead.counted()} of {split}{which}")
        ]
        print_plan(list(dict.fromkeys(planned)), json_output=options.json_output)
        return
    if not files or len(splits) == 1:
        taken.say()
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
    if files:
        split, of_files = _load_file_planners_of(
            splits, options, opened, partial(data.open_split, source=source), settings
        )
        if len(splits) > 1:
            api.notify(describe_default((split,), splits, f"{files[0]} has the samples of {split}"))
        splits, factories = (split,), [*factories, *of_files]
    datasets = {split: data.open_split(split, source) for split in splits}
    if options.dry_run:
        names = ", ".join(factory.facts.name for factory in factories)
        counted = {split: len(settings.chosen(dataset, split)) for split, dataset in datasets.items()}
        planned = [f"would run {names} on {pluralise(count, 'scene')} of {split}" for split, count in counted.items()]
        print_plan(planned, json_output=options.json_output)
        return
    judged = [(factory, _with_native_protocol(settings, factory)) for factory in factories]
    if shard is not None:
        from benchmark.evaluation import plan_shard

        done = [
            progress
            for split, dataset in datasets.items()
            for progress in plan_shard(dataset, split, judged, run_root, shard)
        ]
        print_shard_progress(shard, done, "planned", json_output=options.json_output)
        return
    records: list[RunRecord] = []
    dumped: list[str] = []
    for split, dataset in datasets.items():
        of_split = with_reproductions(
            evaluate_together(dataset, split, judged, run_root), find_reproductions([run_root])
        )
        if options.explain_protocols:
            _explain(source.name, dataset, of_split, options)
        dumped += write_dumps(of_split, dataset, split, options.dump_results, space)
        records += of_split
    warn_of_caveats(record.run for record in records)
    sound = _show_runs(source.name, records, protocols, run_root, options)
    any_planned = any(record.summary.failed < record.summary.samples for record in records)
    print_next_steps(
        "; ".join([f"records: {', '.join(str(record.directory) for record in records)}", *dumped]),
        *(_list_next_steps(options, records) if any_planned else ()),
        json_output=options.json_output,
    )
    if not sound:
        raise typer.Exit(1)


def _load_file_planners_of(
    splits: Sequence[str],
    options: EvalOptions,
    opened: "Sequence[RecognisedFile]",
    open_split: "Callable[[str], DataSet]",
    settings: "EvalSettings",
) -> "tuple[str, list[PlannerFactory]]":
    """The split that plan and result files are for, the first whose samples they have, and their planners."""
    from adapters.plan_file import OtherSamplesError
    from benchmark.untrusted.files import RefusedFileError

    run_root = api.workspace(options.out).run_root()
    refused: list[InputError] = []
    for split in splits:
        dataset = open_split(split)
        try:
            chosen = settings.chosen(dataset, split)
            return split, load_file_planners(options, opened, dataset, split, chosen, run_root)
        except OtherSamplesError as error:
            refused.append(error)
        except RefusedFileError as error:
            if error.category not in _OF_OTHER_SAMPLES:
                raise
            refused.append(error)
    raise refused[0]


def _list_next_steps(options: EvalOptions, records: "Sequence[RunRecord]") -> Iterator[Step]:
    """Commands that make something of records, but for what there is already."""
    from benchmark.records.scene_pages import SPLIT_FILE, split_folder

    run, again = records[-1].run, repeat_data_options(options)
    if not (split_folder(api.workspace(options.out).sheet_root(), run.data.name, run.split) / SPLIT_FILE).is_file():
        yield f"sheets{format_options(split=run.split)}{again}", "draw the scenes for films and the site"
    yield suggest_leaderboard(options.out, records=[record.content_id for record in records])


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


def _require_one_split(options: EvalOptions) -> None:
    """Refuse files, whose plans are of one split, with several."""
    given = next((name for name in ("plans", "results") if getattr(options, name)), None)
    splits = tuple(dict.fromkeys(options.split))
    if is_given("split") and len(splits) > 1 and given is not None:
        raise InputError(f"--{given} applies to one split, and --split names {', '.join(splits)}; give one at a time")


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
    print_tables([table], wide=options.wide, verbose=options.verbose, err=options.json_output)
    for picture in pictures:
        typer.echo(f"{picture.path}: {picture.sentence}", err=options.json_output)


def _show_runs(
    data_name: str,
    records: "Sequence[RunRecord]",
    protocols: tuple[str, ...] | None,
    run_root: Path,
    options: EvalOptions,
) -> bool:
    """Print the tables of runs; whether all is well: a run that failed on samples is not unless that is allowed."""
    from benchmark.metrics.attacks import attack_rates_to_json
    from benchmark.metrics.effect import effect_to_json
    from benchmark.metrics.slices import select_kinds
    from benchmark.metrics.unchanged_records import find_unchanged_candidates, find_unchanged_record
    from leaderboard.tables.collision import run_tables
    from leaderboard.tables.slices import run_slices

    allow_partial, by = options.allow_partial, options.by or ()
    # The comparison table is shown unless tables are requested by name.
    against = find_unchanged_candidates(run_root, records) if options.json_output or protocols is None else []
    sliced = run_slices(data_name, records, select_kinds(by), protocols, allow_partial=allow_partial)
    if options.json_output:
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
        print_tables([*tables, *sliced], wide=options.wide, verbose=options.verbose)
    failed = [record for record in records if not record.complete]
    for record in failed:
        typer.echo(_describe_failures(record, allow_partial=allow_partial), err=True)
    return allow_partial or not failed


def _describe_failures(record: "RunRecord", *, allow_partial: bool) -> str:
    """Sentence on the samples that a planner failed on, and where their tracebacks are."""
    from benchmark.runs.units import FAILURES_FILE, find_first_failure

    failed, samples = record.summary.failed, pluralise(record.summary.samples, "sample")
    if failed == record.summary.samples:
        which, rates = f"all {samples} of {record.run.split}", "there are no rates; the file begins with the first one"
    else:
        which = f"{failed} of {samples}"
        rates = "the rates exclude them" if allow_partial else "--allow-partial prints the rates of the other samples"
    first, tracebacks = find_first_failure(record.rows), record.directory / FAILURES_FILE
    return f"{record.planner} failed on {which} (the first: {first}; all tracebacks: {tracebacks}); {rates}"
