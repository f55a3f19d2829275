"""Command that repeats the paper's ablation: ``run_ablation``."""

from dataclasses import dataclass
from typing import Annotated

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.built_splits import require_cluster, require_trajectory_model
from benchmark.cli.options import list_hyper_parameters, make_executor, parse_image_size, parse_name_list
from benchmark.cli.output import print_next_steps, print_plan, print_result, suggest_leaderboard
from benchmark.cli.settings import Option, command


@dataclass(frozen=True, slots=True, kw_only=True)
class AblateOptions:
    """Options of ``run_ablation``."""

    model: Annotated[str, Option("Planner that has to drive.", "Planner")] = "constant-velocity"
    checkpoint: shared.Checkpoint = None
    sample_limit: shared.SampleLimit = None
    memory_limit: shared.MemoryLimit = None
    data: shared.Data = "mini"
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    source_split: Annotated[str, Option("Split of the data set to start from.", "Input")] = "val"
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    vehicles: Annotated[int | None, Option("Vehicles to try per scene, at most.", "Search", min=1)] = None
    candidates: Annotated[int | None, Option("Candidates per planning step.", "Search", min=4, max=65536)] = None
    preset: shared.Preset = "default"
    changes: shared.Set = None
    denoiser: shared.Denoiser = None
    device: shared.Devices = "cpu"
    together: shared.Together = 1
    size: shared.Size = "448x256"
    seed: shared.Seed = 0
    workers: shared.Workers = 0
    executor: shared.Executor = "local"
    address: shared.Address = None
    wide: shared.Wide = False
    json_output: shared.Json = False
    dry_run: shared.DryRun = False

    @staticmethod
    def reserved() -> "frozenset[str]":
        """Names that ``--set`` leaves to the search: its hyper-parameters."""
        return list_hyper_parameters()


@command(AblateOptions, panel="Advanced")
def ablate_command(options: AblateOptions) -> None:
    """Run the paper's ablation: full search, without refinement (MTR), without scoring (TS), without both."""
    from benchmark.machine.path_checks import require_place
    from benchmark.machine.several_devices import count_workers, require_one_device
    from benchmark.machine.storage import sanitise_file_name
    from generation.search.differences_from_paper import format_differences
    from generation.search.presets import build_hyper_parameters, build_trajectory_model

    shortcuts = {"candidate_limit": options.vehicles, "candidates": options.candidates}
    hyper = build_hyper_parameters(options.preset, shortcuts, options.changes or ())
    driver = api.PlannerSource.of(options, device=None).require()
    require_trajectory_model(options.device, options.denoiser)
    if options.executor != "local":
        require_one_device(options.device, "a Ray cluster assigns GPUs to its tasks")
    drawing, scenes = api.schematic_renderer(parse_image_size(options.size)), parse_name_list(options.scenes)
    place = make_executor(options.executor, options.address, count_workers(options.workers, options.device))
    data = api.DataSource.of(options)
    ahead = data.require_source(options.source_split, scenes, options.limit)
    require_place(options.out, "--out")
    if options.dry_run and ahead.builds:
        next_step = (
            f"search {ahead.counted()} four times, with {options.model} driving; --dry-run estimates the time once "
            "they are built"
        )
        print_plan(
            [*ahead.plan(next_step), *format_differences(options.preset, hyper)], json_output=options.json_output
        )
        return
    require_cluster(place, ahead)
    from generation.pipeline.ablation import estimate_ablation, run_ablation
    from generation.pipeline.settings import BuildSettings

    planner, source, space = driver.under_test(options.workers), data.open(), api.workspace(options.out)
    study = space.ablation_root() / source.name / sanitise_file_name(planner.factory.facts.name)
    settings = BuildSettings(
        out=study,
        timings=space.timings_of(study),
        hyper=hyper,
        prior=build_trajectory_model(options.preset, options.denoiser, options.device),
        source_split=options.source_split,
        scenes=scenes,
        limit=options.limit,
        renderer=drawing,
        frames="keyframes",
        seed=options.seed,
        executor=place,
        together=options.together,
    )
    if options.dry_run:
        estimate = estimate_ablation(source, planner, settings)
        print_plan([estimate, *format_differences(options.preset, hyper)], json_output=options.json_output)
        return
    report = run_ablation(source, planner, settings)
    report_json = report.model_dump(mode="json", by_alias=True)
    print_result(report_json, report.table().plain(wide=options.wide), json_output=options.json_output)
    print_next_steps(
        f"study: {settings.out}",
        suggest_leaderboard(options.out, *settings.out.glob("*.json")),
        json_output=options.json_output,
    )
