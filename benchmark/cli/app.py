"""The command line: the one place that knows all packages, and imports them only inside the command that needs them."""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from benchmark import __version__
from benchmark.cli.options import (
    AddressOption,
    AskedLook,
    AskedLookOption,
    CallsOption,
    DataOption,
    DenoiserOption,
    DeviceOption,
    DrawnSize,
    DrawnSizeOption,
    DropoutOption,
    DryRunOption,
    ExecutorName,
    ExecutorOption,
    FilmFormatName,
    FilmFormatOption,
    FilmLayoutName,
    FilmLayoutOption,
    Frames,
    FramesOption,
    JsonOption,
    Layout,
    LimitOption,
    LosslessOption,
    NormalisationOption,
    OutOption,
    Preset,
    PresetOption,
    QuickRendererName,
    RecordsOption,
    RenderDeviceOption,
    RendererName,
    ScenesOption,
    SeedOption,
    SetOption,
    SheetPictures,
    SizeOption,
    SpeedOption,
    SplitOption,
    TablesOption,
    TogetherOption,
    Verifiable,
    WeightsFolderOption,
    WorkersOption,
    WrittenSize,
    WrittenSizeOption,
    executor_of,
    image_size,
    name_list,
    print_json,
    worker_count,
)
from benchmark.errors import InputError

if TYPE_CHECKING:
    from adapters.checkpoints.importing import ImportedWeights
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workspace import Workspace
    from benchmark.records.run import RunRecord
    from benchmark.runs.plan_rows import PlannerFactory
    from benchmark.sheets.writing import SheetSettings, WrittenSheets
    from benchmark.verification.checks import Check
    from benchmark.weights.hub import HubWeights
    from generation.build.report import BuildReport
    from generation.build.split import BuildSettings
    from generation.build.surrogate import PlannerUnderTest
    from generation.search.attempts import PriorFactory
    from generation.search.hyperparameters import HyperParameters

app = typer.Typer(
    name="challenger-bench",
    help="Adversarial driving scenes from nuScenes-format data, and driving models measured on them.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
data_app = typer.Typer(help="Look at, check, import and build data sets.", no_args_is_help=True)
train_app = typer.Typer(help="Train the small models that this package carries.", no_args_is_help=True)
app.add_typer(data_app, name="data")
app.add_typer(train_app, name="train")
weights_app = typer.Typer(help="Official weights of the native models.", no_args_is_help=True)
app.add_typer(weights_app, name="weights")
leaderboard_app = typer.Typer(help="Write the tables (Markdown, LaTeX, CSV, JSON) from run records; check submissions.")
app.add_typer(leaderboard_app, name="leaderboard")


OUT = Path("challenger-out")


FULL_DEMO_PER_SCENE, FULL_DEMO_VEHICLES = 3, 5
"""Of each recorded scene in ``demo --full``: most variants in ``adv``, and most vehicles tried for the ablation."""


def main() -> None:
    """Run the command line; errors of the user are one sentence and exit code 2."""
    debug = "--debug" in sys.argv
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    command = typer.main.get_command(app)
    try:
        code = command.main(arguments, prog_name="challenger-bench", standalone_mode=False)
    except InputError as error:
        if debug:
            raise
        code = _fail(str(error))
    except typer.TyperException as error:
        message = str(error.format_message() if hasattr(error, "format_message") else error)
        # The help that stands in for a missing command has many lines and is no error to explain.
        code = _fail(message) if "\n" not in message else _help(message)
    except (KeyboardInterrupt, typer.Abort):
        typer.echo("interrupted; finished work is kept, the same command goes on", err=True)
        code = 130
    sys.exit(code if isinstance(code, int) else 0)


def _fail(sentence: str) -> int:
    typer.echo(f"error: {sentence}", err=True)
    return 2


def _help(text: str) -> int:
    typer.echo(text, err=True)
    return 2


@app.callback(invoke_without_command=True)
def _top(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        typer.echo(__version__)
        raise typer.Exit


@app.command("generate")
def generate_command(
    split: SplitOption = "adv",
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    source_split: Annotated[str, typer.Option(help="Split of the data set to start from.")] = "val",
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    adversaries: Annotated[int, typer.Option(min=1, help="Adversaries in each scene.")] = 1,
    surrogate: Annotated[str | None, typer.Option(help="Keep only scenes in which this planner collides.")] = None,
    surrogate_checkpoint: Annotated[Path | None, typer.Option(help="Weights of the surrogate.")] = None,
    vehicles: Annotated[int | None, typer.Option(min=1, help="Vehicles to try per scene, at most.")] = None,
    per_scene: Annotated[int | None, typer.Option(min=1, help="Keep at most so many variants of a scene.")] = None,
    top: Annotated[int | None, typer.Option(min=1, help="Keep only the so many most challenging scenes.")] = None,
    candidates: Annotated[int | None, typer.Option(min=4, max=65536, help="Candidates per planning step.")] = None,
    rounds: Annotated[int | None, typer.Option(min=0, help="Refinement rounds per planning step.")] = None,
    parked: Annotated[bool, typer.Option(help="Also try vehicles that never move.")] = False,
    preset: PresetOption = Preset.DEFAULT,
    changes: SetOption = None,
    denoiser: DenoiserOption = None,
    calls: CallsOption = None,
    dropout: DropoutOption = False,
    device: DeviceOption = "cpu",
    together: TogetherOption = 1,
    layout: Annotated[Layout, typer.Option(help="One root with suffixed names, or one root per variant.")] = (
        Layout.SUFFIXED
    ),
    renderer: Annotated[RendererName, typer.Option(help="Who draws the images.")] = RendererName.SCHEMATIC,
    size: SizeOption = "448x256",
    render_size: DrawnSizeOption = DrawnSize.SMALL,
    written_size: WrittenSizeOption = WrittenSize.MODEL,
    prompt_look: AskedLookOption = AskedLook.RECORDED,
    lossless: LosslessOption = False,
    weights_folder: WeightsFolderOption = None,
    render_device: RenderDeviceOption = "auto",
    tflops: SpeedOption = None,
    frames: FramesOption = Frames.ALL,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    executor: ExecutorOption = ExecutorName.LOCAL,
    address: AddressOption = None,
    profile: Annotated[bool, typer.Option(help="Say where the time went, beside the paper's table.")] = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Build a split, adv or val-r, from recorded scenes; the same command resumes."""
    from generation.build.split import BuildSettings, source_scenes

    _require_generated(split)
    shortcuts = {"candidate_limit": vehicles, "candidates": candidates, "rounds": rounds, "parked": parked or None}
    hyper = _hyper_parameters(preset, shortcuts, changes)
    under_test = _planner_under_test(surrogate, surrogate_checkpoint, data, seed, workers)
    drawing, place = _renderer(renderer, size), executor_of(executor, address, workers)
    rendering = None
    if renderer is RendererName.MAGICDRIVE:
        from generation.render.magicdrive.command import magicdrive_renderer, rendering_executor

        drawing = magicdrive_renderer(
            _workspace(out).rendering_root(),
            weights_folder,
            drawn_size=render_size.value,
            written_size=written_size.value,
            look=prompt_look.value,
            device=render_device,
            seed=seed,
            tera_operations=tflops,
            estimates_only=dry_run,
        )
        # Estimates for a GPU are wanted on machines that have none.
        rendering = None if dry_run else rendering_executor(place, render_device)
    # Last: the embedded data set takes minutes to build the first time, and a mistyped option should not.
    source = _open_source(data, tables, workers)
    settings = BuildSettings(
        out=_workspace(out).split_root(source.name, split),
        hyper=hyper,
        prior=_prior(preset, denoiser, device, calls, dropout=dropout),
        source_split=source_split,
        scenes=name_list(scenes),
        limit=limit,
        adversaries=adversaries,
        surrogate=under_test,
        per_scene=per_scene,
        total=top,
        layout=layout.value,
        renderer=drawing,
        frames=frames.value,
        lossless=lossless,
        seed=seed,
        executor=place,
        rendering=rendering,
        together=together,
        dry_run=dry_run,
    )
    if renderer is RendererName.MAGICDRIVE:
        typer.echo(drawing.estimate(source.scene(source_scenes(source, settings)[0])).plain(), err=True)
    report = _generate(source, split, settings)
    runtime = report.runtime if profile else None
    if json_output:
        print_json(report.as_json() | ({} if runtime is None else {"runtime": runtime.as_json()}))
        return
    typer.echo(report.summary())
    if runtime is not None:
        typer.echo(runtime.plain())


@app.command("ablate")
def ablate_command(
    model: Annotated[str, typer.Option("--model", help="Planner that has to drive.")] = "constant-velocity",
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    source_split: Annotated[str, typer.Option(help="Split of the data set to start from.")] = "val",
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    vehicles: Annotated[int | None, typer.Option(min=1, help="Vehicles to try per scene, at most.")] = None,
    candidates: Annotated[int | None, typer.Option(min=4, max=65536, help="Candidates per planning step.")] = None,
    preset: PresetOption = Preset.DEFAULT,
    changes: SetOption = None,
    denoiser: DenoiserOption = None,
    device: DeviceOption = "cpu",
    together: TogetherOption = 1,
    size: SizeOption = "448x256",
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    executor: ExecutorOption = ExecutorName.LOCAL,
    address: AddressOption = None,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """The paper's ablation: full search, without refinement (MTR), without scoring (TS), without both."""
    from benchmark.machine.storage import file_name
    from generation.build.ablation import ablate, ablation_estimate
    from generation.build.split import BuildSettings

    planner = _planner_under_test(model, checkpoint, data, seed, workers)
    assert planner is not None
    hyper = _hyper_parameters(preset, {"candidate_limit": vehicles, "candidates": candidates}, changes)
    drawing, place = _renderer(RendererName.SCHEMATIC, size), executor_of(executor, address, workers)
    source = _open_source(data, tables, workers)
    settings = BuildSettings(
        out=out / "ablation" / source.name / file_name(planner.factory.facts.name),
        hyper=hyper,
        prior=_prior(preset, denoiser, device, None, dropout=False),
        source_split=source_split,
        scenes=name_list(scenes),
        limit=limit,
        renderer=drawing,
        frames="keyframes",
        seed=seed,
        executor=place,
        together=together,
    )
    if dry_run:
        typer.echo(ablation_estimate(source, planner, settings))
        return
    report = ablate(source, planner, settings)
    if json_output:
        print_json(report.model_dump(mode="json", by_alias=True))
    else:
        typer.echo(report.plain())


@app.command("eval")
def eval_command(
    model: Annotated[
        list[str], typer.Option("--model", help="Planner name or package.module:Class; may be repeated.")
    ] = [],  # noqa: B006 - typer reads the default, nothing changes it
    split: SplitOption = "val",
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    plans: Annotated[Path | None, typer.Option(help="Plan file (CSV, Parquet, JSON) instead of a model.")] = None,
    device: Annotated[
        str | None, typer.Option(help="Where a network runs: cpu, cuda, cuda:1; the first GPU if there is one.")
    ] = None,
    precision: Annotated[str | None, typer.Option(help="Of a network: float32 or bfloat16.")] = None,
    native: Annotated[
        str | None, typer.Option(help="With --plans: the protocol of the repository that the planner comes from.")
    ] = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    allow_partial: Annotated[
        bool, typer.Option("--allow-partial", help="Print rates even where the planner failed on samples.")
    ] = False,
    protocol: Annotated[
        list[str] | None,
        typer.Option(help="Tables to print: a protocol, native or all; may be repeated. Records always hold all."),
    ] = None,
    explain_protocols: Annotated[
        bool,
        typer.Option("--explain-protocols", help="Where each protocol differs from exact, why, and pictures of it."),
    ] = False,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Run planners on a split, write run records, and print the table."""
    from adapters.registry import planner_factory
    from benchmark.evaluation import EvalSettings, evaluate

    if not model and plans is None:
        raise InputError("name a planner with --model (for example constant-velocity) or a plan file with --plans")
    if native is not None and plans is None:
        raise InputError("--native belongs to --plans; planners that --model names say it themselves")
    shown = _protocols_to_show(protocol)
    source = _open_source(data, tables, workers)
    dataset = _open_split(source, split, out, workers)
    settings = EvalSettings(scenes=name_list(scenes), limit=limit, seed=seed, workers=worker_count(workers))
    factories: list[PlannerFactory] = [
        planner_factory(
            _model_on(data, name, checkpoint), checkpoint=checkpoint, seed=seed, device=device, precision=precision
        )
        for name in model
    ]
    if plans is not None:
        from adapters.plan_file import plan_file_factory

        chosen = settings.chosen(dataset, split)
        factories.append(plan_file_factory(plans, dataset, split, scenes=chosen, native=native))
    if dry_run:
        count = len(settings.chosen(dataset, split))
        typer.echo(f"would run {', '.join(factory.facts.name for factory in factories)} on {count} scenes of {split}")
        return
    run_root = _workspace(out).run_root()
    records = [evaluate(dataset, split, factory, run_root, settings) for factory in factories]
    if explain_protocols:
        _explain(source.name, dataset, records, _workspace(out), json_output=json_output)
    _show_runs(source.name, records, shown, allow_partial=allow_partial, json_output=json_output)


@app.command("rescore")
def rescore_command(
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    records: RecordsOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Judge the stored plans of run records anew under every protocol, without running a planner."""
    from benchmark.protocols import PROTOCOLS
    from benchmark.runs.rescoring import rescore_all

    source = _open_source(data, tables, workers)
    space = _workspace(out)
    folders = records or [space.run_root()]
    results = [
        result
        for folder in folders
        for result in rescore_all(folder, lambda split: space.open_split(source, split), source.name, tuple(PROTOCOLS))
    ]
    if json_output:
        print_json([{"directory": str(result.directory), "says": result.sentence} for result in results])
    else:
        for result in results:
            typer.echo(f"{result.directory}: {result.sentence}")
    raise typer.Exit(1 if any(result.failed for result in results) else 0)


@app.command("transfer")
def transfer_command(
    split: SplitOption = "adv",
    out: OutOption = OUT,
    records: RecordsOption = None,
    protocol: Annotated[str, typer.Option(help="Whose verdicts count; native: of each planner's own.")] = "exact",
    data: Annotated[str | None, typer.Option("--data", help="Only records of the data set of this name.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Write a heat map to this .png or .svg file.")] = None,
    json_output: JsonOption = False,
) -> None:
    """Who else fails the scenes that one planner fails: the surrogate-filtered matrix, from run records."""
    from benchmark.metrics.transfer import transfer
    from benchmark.records.planner_versions import labelled
    from leaderboard.figures.heat_map import write_heat_map
    from leaderboard.tables.collision import in_table_order
    from leaderboard.tables.transfer import agreement_table, transfer_table

    known = [record for record in labelled(_records(out, records)) if record.run.split == split]
    found = [record for record in known if record.covers_split]
    for record in known:
        if not record.covers_split:
            typer.echo(f"left out: {record.directory} holds a part of the split only", err=True)
    names = sorted({record.run.data.name for record in found})
    wanted = [data] if data is not None else names
    matrices = {
        name: transfer(in_table_order([r for r in found if r.run.data.name == name]), protocol=protocol)
        for name in wanted
        if name in names
    }
    if not matrices:
        raise InputError(
            f"no complete run records of split {split!r} below {', '.join(map(str, records or [out / 'runs']))}"
            f"{'' if data is None else f' for data set {data!r}'}; run challenger-bench eval --split {split} first"
        )
    if figure is not None:
        if len(matrices) > 1:
            raise InputError(f"--figure draws one matrix and there are {', '.join(matrices)}; choose one with --data")
        write_heat_map(next(iter(matrices.values())), figure)
    if json_output:
        print_json({name: asdict(matrix) for name, matrix in matrices.items()})
        return
    for name, matrix in matrices.items():
        typer.echo(transfer_table(name, matrix).plain())
        typer.echo(agreement_table(name, matrix).plain())


@app.command("quality")
def quality_command(
    split: SplitOption = "val",
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    masks: Annotated[
        str, typer.Option(help="Source of masks: grounded-sam2 (the paper's), sam2-boxes, boxes (no network).")
    ] = "grounded-sam2",
    frames: FramesOption = Frames.KEYFRAMES,
    lossless: Annotated[bool, typer.Option("--lossless", help="Score the PNG frames beside the split's own.")] = False,
    weights_folder: WeightsFolderOption = None,
    device: Annotated[str, typer.Option(help="Where networks run: cpu, cuda, cuda:1; the first GPU if any.")] = "auto",
    batch: Annotated[int, typer.Option(min=1, help="Pictures that go through a network together.")] = 16,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Subject consistency and imaging quality of a split's videos; the same command goes on."""
    from benchmark.quality.definition import Definition, mask_source
    from benchmark.quality.measure import QualitySettings, measure_quality, plan_of
    from leaderboard.tables.quality import quality_tables

    files: Literal["own", "lossless"] = "lossless" if lossless else "own"
    definition = Definition(mask_source(masks), frames.value, files, batch=batch)
    settings = QualitySettings(definition, weights_folder, device, name_list(scenes), limit, workers)
    dataset = _open_split(_open_source(data, tables, workers), split, out, workers)
    if dry_run:
        typer.echo(plan_of(dataset, split, settings))
        return
    record = measure_quality(dataset, split, _workspace(out).quality_root(), settings)
    if json_output:
        facts = record.facts.model_dump(mode="json", by_alias=True, include={"definition", "weights", "summary"})
        print_json({"directory": str(record.directory), **facts})
    else:
        typer.echo(quality_tables([record])[0].plain())


@app.command("sheets")
def sheets_command(
    split: SplitOption = "val",
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    pictures: Annotated[
        SheetPictures, typer.Option(help="Pictures of all cameras at 2 Hz keyframes, at all 12 Hz frames, or none.")
    ] = SheetPictures.KEYFRAMES,
    cell_width: Annotated[int, typer.Option(help="Width of one camera in them, pixels; never enlarged.")] = 320,
    rounds: Annotated[bool, typer.Option("--rounds", help="Search again, to show the rounds of refinement.")] = False,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Write scene sheets: what films, pictures and the site show of a split; the same command goes on."""
    from benchmark.sheets.writing import SheetSettings, plan_of

    settings = SheetSettings(pictures.value, cell_width, name_list(scenes), limit, worker_count(workers))
    source, root = _open_source(data, tables, workers), _workspace(out).sheet_root()
    dataset = _open_split(source, split, out, workers)
    if dry_run:
        typer.echo(plan_of(dataset, split, root, settings))
        return
    written, traced = _write_sheets(source, dataset, split, root, settings, rounds=rounds)
    if json_output:
        print_json(written.as_json() | ({} if traced is None else {"traced": traced}))
        return
    typer.echo(written.sentence())
    if traced is not None:
        typer.echo(f"rounds of refinement of {traced} scenes")


def _write_sheets(
    source: "DataSet", dataset: "DataSet", split: str, root: Path, settings: "SheetSettings", *, rounds: bool
) -> "tuple[WrittenSheets, int | None]":
    """Sheets of a split, and the number of scenes whose search was traced, if that was asked for."""
    from benchmark.sheets.writing import write_sheets
    from generation.build.profile import kept_runtime
    from generation.nuscenes_writer.plan import STATE_FOLDER

    runtime = kept_runtime(dataset.root / STATE_FOLDER)
    written = write_sheets(dataset, split, root, settings, runtime=None if runtime is None else runtime.as_json())
    if not rounds:
        return written, None
    from generation.search.trace import write_traces

    names = [each.scene for each in written.scenes]
    return written, len(write_traces(dataset, source, split, root, names, workers=settings.workers))


@leaderboard_app.callback(invoke_without_command=True)
def leaderboard_command(
    context: typer.Context,
    out: OutOption = OUT,
    records: RecordsOption = None,
    to: Annotated[Path | None, typer.Option(help="Folder of the tables, if not <out>/leaderboard.")] = None,
    site: Annotated[bool, typer.Option("--site/--no-site", help="Whether to write the site too.")] = True,
    check: Annotated[bool, typer.Option("--check", help="Only say whether the written tables are current.")] = False,
    json_output: JsonOption = False,
) -> None:
    """Write tables (Markdown, LaTeX, CSV, JSON), figures and site from run records, scene sheets and studies."""
    if context.invoked_subcommand is not None:
        return
    from benchmark.records.ablation import find_ablations
    from benchmark.records.quality import find_quality
    from benchmark.records.scenes import find_sheets
    from leaderboard.build import stale_files, write_leaderboard

    space, folder = _workspace(out), to or out / "leaderboard"
    quality, sheets = find_quality(space.quality_root()), find_sheets(space.sheet_root())
    ablations = find_ablations(space.out / "ablation")
    no_runs = bool(quality or sheets.splits or ablations) and records is None and not space.run_root().exists()
    found = [] if no_runs else _records(out, records)
    if check:
        stale = stale_files(found, folder, quality, sheets, ablations, site=site)
        if json_output:
            print_json({"stale": stale})
        else:
            typer.echo("\n".join(stale) or f"{folder} is current")
        raise typer.Exit(1 if stale else 0)
    written = write_leaderboard(found, folder, quality, sheets, ablations, site=site)
    if json_output:
        print_json({"files": [str(path) for path in written]})
    else:
        typer.echo(
            f"{len(written)} files in {folder}; start with {folder / ('site/index.html' if site else 'README.md')}"
        )


@leaderboard_app.command("submit-check")
def submit_check_command(
    folder: Annotated[Path, typer.Argument(help="Folder of submitted run records.")],
    data: DataOption = "mini",
    out: OutOption = OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Check a stranger's run records: hashes, coverage, samples, and every number computed anew from the plans."""
    from benchmark.runs.submissions import Level, check_submission

    source, space = _open_source(data, tables, workers), _workspace(out)
    sound, findings = check_submission(folder, source.name, lambda split: space.open_split(source, split))
    if json_output:
        print_json(
            {"sound": [str(record.directory) for record in sound], "findings": [found.as_json() for found in findings]}
        )
    else:
        for found in findings:
            typer.echo(f"{found.level}: {found.directory}: {found.sentence}")
        for record in sound:
            typer.echo(f"fit: {record.directory}: {record.planner} on {record.run.split}, {len(record.rows)} samples")
    raise typer.Exit(1 if any(found.level is Level.ERROR for found in findings) else 0)


@app.command("film")
def film_command(
    to: Annotated[Path, typer.Option(help="Folder to write to.")],
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    model: Annotated[list[str] | None, typer.Option("--model", help="Planner to show; may be repeated.")] = None,
    data: DataOption = "mini",
    split: SplitOption = "adv",
    out: OutOption = OUT,
    records: RecordsOption = None,
    layout: FilmLayoutOption = FilmLayoutName.BOTH,
    form: FilmFormatOption = FilmFormatName.WEBM,
    begin_s: Annotated[float, typer.Option("--from", help="First moment, seconds.")] = 0.0,
    end_s: Annotated[float | None, typer.Option("--until", help="Last moment, seconds.")] = None,
    fps: Annotated[float, typer.Option(help="Frames a second; the film is as fast as the scene.")] = 12.0,
    width: Annotated[int, typer.Option(help="Width of the frames in pixels, which are 16:9.")] = 1280,
    extent: Annotated[float, typer.Option(help="Half the width of what is seen from above, metres.")] = 24.0,
    north_up: Annotated[bool, typer.Option("--north-up", help="North points up, not the ego's heading.")] = False,
    candidates: Annotated[bool, typer.Option(help="Whether to draw what the search chose from.")] = True,
    protocol: Annotated[str, typer.Option(help="Whose verdicts are shown; native: of each planner's own.")] = "exact",
    json_output: JsonOption = False,
) -> None:
    """Film scenes from their sheets: cameras, view from above, plans and verdicts of planners (docs/films.md)."""
    from benchmark.protocols import protocol as known_protocol
    from leaderboard.films.film import FilmLayout, FilmSettings
    from leaderboard.films.filming import FilmFormat, planner_folder, sheet_folders, write_film

    judge = protocol if protocol == "native" else known_protocol(protocol).name
    shown, target, space = FilmLayout(layout.value), FilmFormat(form.value), _workspace(out)
    settings = FilmSettings(shown, judge, begin_s, end_s, fps, width, extent, not north_up, candidates)
    folders = sheet_folders(space.sheet_root(), data, split, name_list(scenes))[:limit]
    plans = _records(out, records or [planner_folder(space.run_root(), data, split)]) if model else []
    films = []
    for folder in folders:
        films.append(str(write_film(folder, plans, model or [], to, target, settings, watch=_watch)))
        typer.echo(films[-1], err=json_output)
    if json_output:
        print_json({"films": films})


def _watch(items: Iterable[Any], total: int, label: str) -> Iterable[Any]:
    from benchmark.machine.workers import progress

    return progress(items, total=total, label=label)


@app.command("verify")
def verify_command(
    what: Annotated[Verifiable, typer.Argument(help="What to compare.")],
    golden: Annotated[Path | None, typer.Option(help="Directory of golden numbers, if not the built-in set.")] = None,
    model: Annotated[str | None, typer.Option(help="With model: which one, for example vad-tiny.")] = None,
    json_output: JsonOption = False,
) -> None:
    """Compare numerics with golden numbers; exit code 1 if any differ by more than they may."""
    from benchmark.verification.checks import report

    if what is Verifiable.MODEL:
        checks = _verify_model(model, golden)
    elif model is not None:
        raise InputError("--model belongs to verify model; leave it out")
    else:
        checks = _numerics(what)(golden)
    if json_output:
        print_json([check.as_json() for check in checks])
    else:
        typer.echo(report(checks))
    raise typer.Exit(0 if all(check.ok for check in checks) else 1)


def _numerics(what: Verifiable) -> "Callable[[Path | None], list[Check]]":
    """What compares physics, scoring, denoiser or protocols with golden numbers, or with the built-in ones."""
    if what is Verifiable.PHYSICS:
        from generation.verification.physics import verify_physics

        return verify_physics
    if what is Verifiable.SCORING:
        from generation.verification.scoring import verify_scoring

        return verify_scoring
    if what is Verifiable.DENOISER:
        from generation.verification.denoiser import verify_denoiser

        return verify_denoiser
    from benchmark.protocols.verification import verify_protocols

    return verify_protocols


def _verify_model(model: str | None, golden: Path | None) -> "list[Check]":
    from adapters.verification.models import VERIFIED_MODELS, verify_model
    from generation.verification.magicdrive import verify_magicdrive

    if model not in (*VERIFIED_MODELS, "magicdrive"):
        missing = "verify model needs --model" if model is None else f"no model {model!r} can be verified"
        raise InputError(f"{missing}; known are {', '.join(VERIFIED_MODELS)}, magicdrive")
    if golden is None:
        raise InputError("verify model needs --golden, a directory of numbers of the official code; none is built in")
    return verify_magicdrive(golden) if model == "magicdrive" else verify_model(model, golden)


@app.command("demo")
def demo_command(
    out: OutOption = OUT,
    town_scenes: Annotated[int, typer.Option(min=1, help="Scenes of the embedded town.")] = 4,
    full: Annotated[
        bool, typer.Option("--full", help="All splits of mini, all built-in planners, the ablation; write --to.")
    ] = False,
    check: Annotated[bool, typer.Option("--check", help="With --full: only say whether --to is current.")] = False,
    to: Annotated[Path, typer.Option(help="With --full: folder of the page and its numbers.")] = Path("docs/results"),
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """The whole story on the embedded data: generate, evaluate, transfer, tables."""
    if check and not full:
        raise InputError("--check belongs to demo --full, whose results it looks at")
    if full:
        _full_demo(out, to, workers, check=check, json_output=json_output)
        return
    from benchmark.machine.workers import LocalProcesses
    from benchmark.metrics.transfer import transfer
    from benchmark.records.scenes import find_sheets
    from benchmark.sheets.writing import SheetSettings
    from generation.build.split import BuildSettings
    from generation.search.hyperparameters import HyperParameters
    from generation.sources.mini import TownSettings, build_town
    from leaderboard.build import write_leaderboard
    from leaderboard.tables.collision import collision_table, in_table_order
    from leaderboard.tables.transfer import transfer_table

    space, processes = _workspace(out), worker_count(workers)

    def tell(text: str) -> None:
        typer.echo(text, err=json_output)

    tell(f"1/4 building {town_scenes} scenes of the embedded town")
    town = TownSettings(val_scenes=town_scenes)
    source = _open_data(build_town(space.out / "data" / "demo" / "val", town, workers=processes), None, "demo")
    settings = BuildSettings(
        out=space.split_root("demo", "adv"),
        hyper=HyperParameters(candidates=64, candidate_limit=5),
        per_scene=1,
        renderer=_renderer(RendererName.SCHEMATIC, "448x256"),
        frames="keyframes",
        executor=LocalProcesses(processes),
    )
    tell("2/4 generating adversarial scenes")
    report = _generate(source, "adv", settings)
    tell(report.summary())
    tell("3/4 evaluating planners on val and adv")
    records = []
    for split in ("val", "adv"):
        dataset = _open_split(source, split, out, workers)
        records += _evaluate_demo(dataset, split, space, processes)
        sheet_settings = SheetSettings(workers=processes)
        _write_sheets(source, dataset, split, space.sheet_root(), sheet_settings, rounds=split == "adv")
    tell("4/4 writing the leaderboard")
    write_leaderboard(_records(out, None), out / "leaderboard", sheets=find_sheets(space.sheet_root()))
    if json_output:
        print_json({"leaderboard": str(out / "leaderboard"), "generated": report.as_json()})
        return
    tell("")
    tell(collision_table("demo", "exact", records).plain())
    adversarial = in_table_order([record for record in records if record.run.split == "adv"])
    tell(transfer_table("demo", transfer(adversarial)).plain())
    tell(f"site: {out / 'leaderboard' / 'site' / 'index.html'}   tables: {out / 'leaderboard' / 'README.md'}")


def _evaluate_demo(dataset: "DataSet", split: str, space: "Workspace", processes: int) -> "list[RunRecord]":
    """Records of the baselines and of the miniatures."""
    from adapters.registry import BUILT_IN, MINIATURES, planner_factory
    from benchmark.evaluation import EvalSettings, evaluate

    records = []
    for name in (*BUILT_IN, *MINIATURES):
        typer.echo(f"{name} on {split}", err=True)
        settings = EvalSettings(workers=processes)
        records.append(evaluate(dataset, split, planner_factory(name), space.run_root(), settings))
    return records


def _full_demo(out: Path, to: Path, workers: int, *, check: bool, json_output: bool) -> None:
    """Measure what docs/results shows, or say why it is not current."""
    from benchmark.machine.workers import LocalProcesses
    from benchmark.machine.workspace import EMBEDDED
    from generation.build.ablation import ablate
    from generation.build.split import BuildSettings
    from generation.search.hyperparameters import HyperParameters
    from leaderboard.results import stale_results, write_results

    made_from = _results_from()
    if check:
        stale = stale_results(to, made_from)
        print_json({"stale": stale}) if json_output else typer.echo("\n".join(stale) or f"{to} is current")
        raise typer.Exit(1 if stale else 0)
    source, processes = _open_source(EMBEDDED, None, workers), worker_count(workers)
    records = []
    for split in ("val", "val-r", "adv"):
        # Planners see key frames only; the others would take most of the time.
        dataset = _open_split(source, split, out, workers, frames="keyframes", per_scene=FULL_DEMO_PER_SCENE)
        records += _evaluate_demo(dataset, split, _workspace(out), processes)
    driver = _planner_under_test("uniad-mini", None, EMBEDDED, 0, workers)
    assert driver is not None
    settings_of_build = BuildSettings(
        out=out / "ablation" / source.name / driver.factory.facts.name,
        hyper=HyperParameters(candidate_limit=FULL_DEMO_VEHICLES),
        renderer=_renderer(RendererName.SCHEMATIC, "448x256"),
        frames="keyframes",
        executor=LocalProcesses(processes),
    )
    typer.echo(f"ablation with {driver.factory.facts.name}", err=True)
    report = ablate(source, driver, settings_of_build)
    written = write_results(source.name, records, [report], made_from, to)
    if json_output:
        print_json({"files": [str(path) for path in written]})
    else:
        typer.echo("\n".join(map(str, written)))


def _results_from() -> dict[str, Any]:
    """What the measured results depend on: weights, town, search and protocols."""
    from adapters.miniatures import MINIATURES
    from benchmark.machine.storage import file_sha256
    from benchmark.protocols import PROTOCOLS
    from generation.search.adversary import ALGORITHM_VERSION
    from generation.search.attempts import PackagedPrior
    from generation.search.hyperparameters import HyperParameters
    from generation.sources.mini import TownSettings

    return {
        "weights": {name: file_sha256(each.packaged) for name, each in MINIATURES.items()},
        "town": TownSettings().folder_name("mini"),
        "search": [ALGORITHM_VERSION, HyperParameters().fingerprint, FULL_DEMO_PER_SCENE, FULL_DEMO_VEHICLES],
        "trajectory model": PackagedPrior(None, "cpu")().fingerprint,
        "protocols": {name: definition.version for name, definition in PROTOCOLS.items()},
    }


@app.command("doctor")
def doctor_command(out: OutOption = OUT, json_output: JsonOption = False) -> None:
    """Whether this machine computes correctly and has what is needed."""
    from benchmark.machine.environment import checks

    found = checks(out)
    if json_output:
        print_json([{"check": check.name, "ok": check.ok, "says": check.sentence} for check in found])
    else:
        for check in found:
            typer.echo(f"{'ok  ' if check.ok else 'FAIL'}  {check.name}: {check.sentence}")
    raise typer.Exit(0 if all(check.ok for check in found) else 1)


@data_app.command("info")
def data_info_command(
    root: Annotated[str, typer.Argument(help="mini or the root of a data set.")] = "mini",
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """What a data set holds: splits, scenes, samples, annotations, fingerprint."""
    from benchmark.datasets.contents import contents

    found = contents(_open_source(root, tables, workers))
    if json_output:
        print_json(found)
        return
    for name, value in found.items():
        typer.echo(f"{name}: {value}")


@data_app.command("stats")
def data_stats_command(
    root: Annotated[str, typer.Argument(help="mini or the root of a data set, generated ones included.")] = "mini",
    split: Annotated[str | None, typer.Option(help="Only this split; every row of the tables if not given.")] = None,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """The paper's data-set table for any split, and what generated adversaries do where."""
    from benchmark.datasets.statistics import statistics
    from benchmark.machine.workspace import EMBEDDED

    folder = _open_source(root, tables, workers).root if root == EMBEDDED else Path(root)
    found = statistics(folder, split=split, version=tables)
    if json_output:
        print_json(found.as_json())
    else:
        typer.echo(found.plain())


@data_app.command("show")
def data_show_command(
    root: Annotated[str, typer.Argument(help="mini or the root of a data set, generated ones included.")],
    to: Annotated[Path, typer.Option(help="Folder for the pictures.")],
    conditions: Annotated[bool, typer.Option("--conditions", help="Draw what MagicDriveDiT would be told.")] = False,
    tables: TablesOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    workers: WorkersOption = 0,
) -> None:
    """Draw each scene: from above over time, and the camera that sees the adversary best."""
    from generation.render.magicdrive.condition_pictures import write_condition_pictures
    from generation.render.pictures import write_pictures
    from generation.render.schematic import SchematicRenderer

    dataset = _open_source(root, tables, workers)
    names = (name_list(scenes) or dataset.scene_names(None))[:limit]
    write = write_condition_pictures if conditions else write_pictures
    written = write(dataset, names, to, SchematicRenderer())
    typer.echo(f"{len(written)} pictures in {to}")


@data_app.command("check")
def data_check_command(
    root: Annotated[Path, typer.Argument(help="Root of a data set.")],
    tables: TablesOption = None,
    json_output: JsonOption = False,
) -> None:
    """Look for faults in the tables and files of a data set."""
    from benchmark.datasets.integrity import check_tables

    faults = check_tables(root, version=tables)
    errors = sum(fault.severity == "error" for fault in faults)
    if json_output:
        rows = [{"severity": f.severity, "table": f.table, "token": f.token, "says": f.sentence} for f in faults]
        print_json({"errors": errors, "faults": rows})
    else:
        for fault in faults:
            typer.echo(f"{fault.severity}: {fault.table}: {fault.sentence}")
        typer.echo(f"{errors} errors, {len(faults) - errors} warnings in {root}")
    raise typer.Exit(1 if errors else 0)


@data_app.command("import")
def data_import_command(
    form: Annotated[str, typer.Argument(help="Form of the recordings: scenarionet.")],
    source: Annotated[Path, typer.Argument(help="A file or a folder of recordings.")],
    out: Annotated[Path, typer.Option("--out", help="Root of the data set to write.")],
    renderer: Annotated[QuickRendererName, typer.Option(help="Who draws the images (these recordings have none).")] = (
        QuickRendererName.SCHEMATIC
    ),
    size: SizeOption = "448x256",
    frames: FramesOption = Frames.ALL,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Bring recordings of another form into nuScenes format."""
    from generation.sources.importing import ImportSettings, import_scenarionet

    if form != "scenarionet":
        raise InputError(f"cannot import {form!r}; the form that can be imported is scenarionet")
    width, height = image_size(size)
    settings = ImportSettings(width, height, frames.value, images=renderer is not QuickRendererName.NONE)
    names = import_scenarionet(source, out, settings, workers=worker_count(workers))
    if json_output:
        print_json({"root": str(out), "scenes": names})
    else:
        typer.echo(f"{len(names)} scenes in {out}: {', '.join(names)}")


@data_app.command("build")
def data_build_command(
    root: Annotated[Path | None, typer.Option(help="Where to; the user's cache if not given.")] = None,
    town_scenes: Annotated[int, typer.Option(help="Evaluation scenes.")] = 10,
    train_scenes: Annotated[int, typer.Option(help="Training scenes.")] = 0,
    size: SizeOption = "448x256",
    frames: FramesOption = Frames.ALL,
    renderer: Annotated[QuickRendererName, typer.Option(help="Who draws the images.")] = QuickRendererName.SCHEMATIC,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
) -> None:
    """Build the embedded town, with any number of scenes; the same command resumes."""
    from benchmark.machine.workspace import EMBEDDED, cache_root
    from generation.sources.mini import TownSettings, build_town

    width, height = image_size(size)
    images = renderer is not QuickRendererName.NONE
    settings = TownSettings(town_scenes, train_scenes, seed, width, height, frames.value, images)
    target = root or cache_root() / settings.folder_name(EMBEDDED)
    typer.echo(str(build_town(target, settings, workers=worker_count(workers))))


@train_app.command("denoiser")
def train_denoiser_command(
    tracks: Annotated[
        Path, typer.Option(help="Folder of track files (.npz), nuPlan databases (.db) or nuScenes roots.")
    ],
    out: Annotated[Path, typer.Option(help="Weights file to write; log and progress lie beside it.")],
    steps: Annotated[int | None, typer.Option(min=1, help="Optimisation steps.")] = None,
    held_out: Annotated[str | None, typer.Option(help="Sources that only check, separated by commas.")] = None,
    seed: SeedOption = 0,
) -> None:
    """Train the trajectory model and describe it; the same command resumes."""
    from generation.diffusion.bank import write_bank
    from generation.diffusion.training.card import write_model_card
    from generation.diffusion.training.loop import TrainingConfig, train_denoiser

    default = TrainingConfig(tracks=tracks, out=out, seed=seed)
    checking = default.held_out if held_out is None else name_list(held_out) or ()
    weights = train_denoiser(replace(default, steps=steps or default.steps, held_out=checking))
    write_bank(weights)
    typer.echo(f"{weights}, {write_model_card(weights, tracks)}")


@train_app.command("planner")
def train_planner_command(
    model: Annotated[str, typer.Option("--model", help="A miniature (uniad-mini, ...) or image-encoder.")],
    data: Annotated[Path, typer.Option(help="Root of a data set in nuScenes format.")],
    out: Annotated[Path, typer.Option(help="Weights file to write; log, progress and card lie beside it.")],
    split: SplitOption = "train",
    steps: Annotated[int | None, typer.Option(help="Steps of all parts together, instead of the usual.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Instead of the usual.")] = None,
    image_encoder: Annotated[Path | None, typer.Option(help="Weights of train planner --model image-encoder.")] = None,
    start_from: Annotated[
        Path | None, typer.Option(help="Weights to start from, where names and shapes agree.")
    ] = None,
    judged_on: Annotated[Path | None, typer.Option(help="Data set whose split val gives the scores.")] = None,
    seed: SeedOption = 0,
    device: DeviceOption = "auto",
    workers: WorkersOption = 0,
) -> None:
    """Train a miniature of a native model on a data set; the same command resumes."""
    from adapters.training.planners import PlannerTraining, train_planner

    processes, start = worker_count(workers), (image_encoder, start_from, judged_on)
    print_json(
        train_planner(PlannerTraining(model, data, split, out, steps, seed, learning_rate, *start, device, processes))
    )


@train_app.command("judge")
def train_judge_command(
    weights: Annotated[Path, typer.Argument(help="Weights file of train planner, with its .json beside it.")],
    data: Annotated[Path, typer.Option(help="Data set whose split val gives the scores.")],
) -> None:
    """Measure a trained miniature again; writes its facts and its card anew."""
    from adapters.training.planners import judge_again

    print_json(judge_again(weights, data))


@train_app.command("ego-status")
def train_ego_status_command(
    tracks: Annotated[Path, typer.Option(help="Folder of track files (npz).")],
    out: Annotated[Path, typer.Option(help="Weights file to write (safetensors).")],
    seed: SeedOption = 0,
) -> None:
    """Train the planner that sees its own motion and the command only."""
    from adapters.training.ego_status import train_ego_status

    print_json(train_ego_status(tracks, out, seed=seed))


@weights_app.command("list")
def weights_list_command(json_output: JsonOption = False) -> None:
    """Official files, where to get them, and what has been imported."""
    from adapters.checkpoints.cache import weights_folder
    from adapters.checkpoints.listing import known_weights
    from benchmark.weights.hub import known_hub_weights

    official, published = known_weights(weights_folder()), known_hub_weights(_hub_weights())
    if json_output:
        print_json([*(entry.as_json() for entry in official), *(entry.as_json() for entry in published)])
        return
    for text in (*(entry.plain() for entry in official), *(entry.plain() for entry in published)):
        typer.echo(text)


@weights_app.command("import")
def weights_import_command(
    path: Annotated[Path, typer.Argument(help="An official .pth file, or a folder of published weights.")],
    model: Annotated[str | None, typer.Option(help="What it must be for; found out if not given.")] = None,
    normalisation: NormalisationOption = None,
    anchors: Annotated[
        Path | None, typer.Option(help="Of weights anchors, or UniAD's .pkl, for weights that come without.")
    ] = None,
    json_output: JsonOption = False,
) -> None:
    """Check an official checkpoint without running anything in it, and keep its weights."""
    from adapters.checkpoints.importing import import_checkpoint
    from benchmark.weights.hub import hub_weights_at, import_folder

    published = hub_weights_at(_hub_weights(), path, model)
    if published is not None:
        _tell_kept(published, import_folder(published, path), json_output=json_output)
        return
    found = import_checkpoint(path, model, normalisation=normalisation, anchors=anchors)
    _tell_imported(found, json_output=json_output)


@weights_app.command("fetch")
def weights_fetch_command(
    name: Annotated[str, typer.Argument(help="Model or file name, as weights list has them.")],
    normalisation: NormalisationOption = None,
    json_output: JsonOption = False,
) -> None:
    """Fetch an official file, or a folder of published weights, from the internet and import it."""
    from adapters.checkpoints.cache import weights_folder
    from adapters.checkpoints.fetching import fetch_official
    from adapters.checkpoints.official import official_file
    from benchmark.weights.hub import fetch

    published = next((entry for entry in _hub_weights() if entry.name == name), None)
    if published is not None:
        _tell_kept(published, fetch(published), json_output=json_output)
        return
    found = fetch_official(official_file(name), weights_folder(), normalisation=normalisation)
    _tell_imported(found, json_output=json_output)


@weights_app.command("anchors")
def weights_anchors_command(
    model: Annotated[str, typer.Option(help="sparsedrive or diffusiondrive.")],
    data: DataOption,
    out: Annotated[Path, typer.Option("--out", help="File of anchors to write (.safetensors).")],
    split: SplitOption = "train",
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Compute anchors from a data set by k-means, for weights that come without them."""
    from adapters.checkpoints.anchor_files import write_anchors

    source = _open_source(data, tables, workers)
    made = write_anchors(model, source, split, out).as_json()
    if json_output:
        print_json(made)
        return
    counts = ", ".join(f"{count} {what}" for what, count in made["sightings"].items())
    typer.echo(f"{made['path']}: anchors of {model} from {counts}")


def _hub_weights() -> "tuple[HubWeights, ...]":
    """Published weights that are kept as folders, of every command that uses such."""
    from benchmark.quality.weights import QUALITY_WEIGHTS
    from generation.render.magicdrive.weights import MAGICDRIVE_WEIGHTS

    return (*MAGICDRIVE_WEIGHTS, *QUALITY_WEIGHTS)


def _tell_kept(weights: "HubWeights", folder: Path, *, json_output: bool) -> None:
    if json_output:
        print_json({"model": weights.name, "path": str(folder)})
    else:
        typer.echo(f"{folder}: {weights.name}, for {weights.used_by}")


def _tell_imported(found: "ImportedWeights", *, json_output: bool) -> None:
    facts = found.provenance.model_dump(mode="json")
    if json_output:
        print_json({"path": str(found.path), "tensors": found.tensors, "parameters": found.parameters, **facts})
        return
    typer.echo(
        f"{found.path}: {found.provenance.model}, {found.tensors} tensors, {found.parameters / 1e6:.1f} M numbers, "
        f"pixel values {found.provenance.normalisation} (said by: {found.provenance.normalisation_from})"
    )


def _open_data(root: Path, tables: str | None, name: str | None) -> "DataSet":
    from benchmark.datasets.roots import open_data

    return open_data(root, version=tables, name=name)


def _open_source(data: str, tables: str | None, workers: int) -> "DataSet":
    """The data set that ``--data`` names; the embedded one is built into the cache the first time."""
    from benchmark.machine.workspace import EMBEDDED, cache_root, is_finished

    if data != EMBEDDED:
        return _open_data(Path(data), tables, None)
    from generation.sources.mini import TownSettings, build_town

    settings = TownSettings()
    root = cache_root() / settings.folder_name(EMBEDDED)
    if not is_finished(root):
        typer.echo(f"building the embedded data set in {root} (once, about two minutes)", err=True)
    return _open_data(build_town(root, settings, workers=worker_count(workers)), None, EMBEDDED)


def _open_split(source: "DataSet", split: str, out: Path, workers: int, **settings: Any) -> "DataSet":
    """The data set that holds a split; missing splits of the embedded data are generated on the spot.

    Further settings are those of `generation.build.split.BuildSettings`.
    """
    from benchmark.machine.workspace import EMBEDDED

    def build() -> None:
        from benchmark.machine.workers import LocalProcesses
        from generation.build.split import BuildSettings

        typer.echo(f"generating split {split} of the embedded data set (once, some minutes)", err=True)
        renderer = _renderer(RendererName.SCHEMATIC, "448x256")
        target = _workspace(out).split_root(source.name, split)
        executor = LocalProcesses(worker_count(workers))
        _generate(source, split, BuildSettings(out=target, renderer=renderer, executor=executor, **settings))

    return _workspace(out).open_split(source, split, build=build if source.name == EMBEDDED else None)


def _generate(source: "DataSet", split: str, settings: "BuildSettings") -> "BuildReport":
    from generation.build.split import build_split

    _require_generated(split)
    return build_split(source, cast(Literal["adv", "val-r"], split), settings)


def _require_generated(split: str) -> None:
    if split not in ("adv", "val-r"):
        raise InputError(f"cannot generate split {split!r}; the splits that can be generated are val-r and adv")


def _protocols_to_show(names: list[str] | None) -> tuple[str, ...] | None:
    """What ``--protocol`` asks for; ``None`` is the default: exact, and the planners' own where they have one."""
    from benchmark.protocols import PROTOCOLS, protocol

    if names is None:
        return None
    if "all" in names:
        return tuple(PROTOCOLS)
    return tuple(dict.fromkeys(name if name == "native" else protocol(name).name for name in names))


def _explain(
    data_name: str, dataset: "DataSet", records: "Sequence[RunRecord]", space: "Workspace", *, json_output: bool
) -> None:
    """Where protocols differ from exact on these runs: the table, and a picture of the clearest case of each cause."""
    from benchmark.protocols.explain.pictures import explain
    from leaderboard.tables.disagreement import disagreement_table

    split = records[0].run.split
    folder = space.out / "explained" / data_name / split
    pictures = explain(records, dataset, folder)
    typer.echo(disagreement_table(data_name, split, records).plain(), err=json_output)
    for picture in pictures:
        typer.echo(f"{picture.path}: {picture.sentence}", err=json_output)


def _show_runs(
    data_name: str,
    records: "Sequence[RunRecord]",
    protocols: tuple[str, ...] | None,
    *,
    allow_partial: bool,
    json_output: bool,
) -> None:
    """Print the tables of runs; a run that failed on samples is an error unless allowed, and then said."""
    from leaderboard.tables.collision import collision_table, native_table

    partial = [record for record in records if not record.complete]
    if json_output:
        rows = [
            {"directory": str(r.directory), "status": r.run.status, **r.summary.model_dump(mode="json")}
            for r in records
        ]
        print_json(rows)
    shown = records if allow_partial else [record for record in records if record.complete]
    if not json_output and shown:
        own = any(record.run.planner.native_protocol for record in shown)
        for name in protocols or (("exact", "native") if own else ("exact",)):
            table = native_table(data_name, shown) if name == "native" else collision_table(data_name, name, shown)
            typer.echo(table.plain())
    for record in partial:
        typer.echo(
            f"{record.planner} failed on {record.summary.failed} of {record.summary.samples} samples "
            f"(tracebacks in {record.directory}); "
            + ("rates leave them out" if allow_partial else "--allow-partial prints the rates of the others"),
            err=True,
        )
    if partial and not allow_partial:
        raise typer.Exit(1)


def _records(out: Path, folders: list[Path] | None) -> "list[RunRecord]":
    """Every record below the folders, each once."""
    from benchmark.records.run import find_records

    found = [record for folder in folders or [_workspace(out).run_root()] for record in find_records(folder)]
    return list({record.directory.resolve(): record for record in found}.values())


def _workspace(out: Path) -> "Workspace":
    from benchmark.machine.workspace import Workspace

    return Workspace(out)


def _hyper_parameters(preset: Preset, shortcuts: dict[str, Any], changes: list[str] | None) -> "HyperParameters":
    """Settings of the search: the preset, options that name one setting, and changes by text, each over the last."""
    from generation.search.hyperparameters import HyperParameters

    start = HyperParameters.paper() if preset is Preset.PAPER else HyperParameters()
    return replace(start, **{name: value for name, value in shortcuts.items() if value is not None}).changed(
        changes or []
    )


def _prior(preset: Preset, weights: Path | None, device: str, calls: int | None, *, dropout: bool) -> "PriorFactory":
    """The trajectory model; with the paper's preset nothing that it draws is drawn again."""
    from generation.diffusion.prior import SamplerSettings
    from generation.search.attempts import PackagedPrior

    literal = preset is Preset.PAPER
    return PackagedPrior(weights, device, SamplerSettings(mutation_steps=calls, drivable=not literal, dropout=dropout))


def _planner_under_test(
    name: str | None, checkpoint: Path | None, data: str, seed: int, workers: int
) -> "PlannerUnderTest | None":
    """A planner that decides about generated scenes."""
    from adapters.registry import BLIND, planner_factory
    from generation.build.surrogate import PlannerUnderTest

    if name is None:
        if checkpoint is not None:
            raise InputError("--surrogate-checkpoint belongs to --surrogate; name the planner that it is for")
        return None
    factory = planner_factory(_model_on(data, name, checkpoint), checkpoint=checkpoint, seed=seed)
    return PlannerUnderTest(factory, images=name not in BLIND, workers=worker_count(workers))


def _model_on(data: str, name: str, checkpoint: Path | None) -> str:
    """The model that runs: on the embedded data a miniature, where the full one has no weights."""
    from adapters.miniatures import stand_in

    chosen = stand_in(name, checkpoint, data)
    if chosen != name:
        typer.echo(f"there are no weights for {name}: {chosen} runs in its place (docs/miniatures.md)", err=True)
    return chosen


def _renderer(name: RendererName, size: str) -> Any:
    from generation.render.schematic import SchematicRenderer

    width, height = image_size(size)
    return SchematicRenderer(width, height) if name is RendererName.SCHEMATIC else None
