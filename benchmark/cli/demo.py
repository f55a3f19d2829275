"""The demo of all four packages, for the command line and Python (`benchmark.demo`, `benchmark.full_demo`)."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json, print_next_steps, print_result, print_tables, repeat_out_option
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmark.datasets.roots import DataSet
    from benchmark.records.run import RunRecord
    from generation.pipeline.report import BuildReport

RESULTS = Path("docs/results")
"""Folder of the page of measured results and its numbers."""
FULL_DEMO_VEHICLES = 1
"""Most vehicles tried of each recorded scene for the ablation of ``demo --full``."""


def demo(
    out: Path = api.OUT, *, town_scenes: int = 4, workers: int = 0, say: "Callable[[str], None]" = api.notify
) -> "tuple[BuildReport, list[RunRecord]]":
    """The whole story on a small embedded town: generate, evaluate, sheets, leaderboard.

    Args:
        out: Folder for everything that is made; the leaderboard is in ``<out>/leaderboard``.
        town_scenes: Scenes of the town.
        workers: Processes; 0 takes all processors.
        say: Told what is being done.

    Returns:
        What was generated, and the records of the built-in planners on ``val`` and ``adv``.

    Raises:
        InputError: If nothing adversarial comes out, or the disk refuses.
    """
    from benchmark.datasets.roots import open_data as open_root
    from benchmark.machine.workers import LocalProcesses
    from benchmark.records.run import find_records
    from benchmark.records.scene_pages import find_scene_pages
    from benchmark.scene_pages.writing import SheetSettings
    from generation.pipeline.settings import BuildSettings
    from generation.pipeline.split import build_split
    from generation.search.presets import build_hyper_parameters
    from generation.sources.mini import TownSettings, build_town_data_set
    from leaderboard.build import write_leaderboard
    from leaderboard.frame.results import read_results

    space, processes = api.workspace(out), api.worker_count(workers)
    say(f"1/4 building {pluralise(town_scenes, 'scene')} of the embedded town")
    # Planners, tables and the site use key frames only; frames in between are drawn on request.
    settings = TownSettings(val_scenes=town_scenes, pictures="keyframes")
    town = build_town_data_set(out / "data" / "demo" / "val", settings, workers=processes)
    source = open_root(town, name="demo")
    search = BuildSettings(
        out=space.split_root("demo", "adv"),
        timings=space.timings_of(space.split_root("demo", "adv")),
        # Near adversaries are easy to see; the default keeps scenes of three of these four recordings, too.
        hyper=build_hyper_parameters("near", {"candidates": 64, "candidate_limit": 5}),
        per_scene=1,
        renderer=api.schematic_renderer(),
        frames="keyframes",
        executor=LocalProcesses(processes),
        keep_rounds=True,
    )
    say("2/4 generating adversarial scenes")
    report = build_split(source, "adv", search)
    say(report.summary())
    say("3/4 evaluating planners on val and adv")
    records = []
    for split in ("val", "adv"):
        dataset = api.open_split(source, split, out, workers=workers)
        records += _evaluate_built_in(dataset, split, out, processes)
        api.write_sheets(dataset, split, space.sheet_root(), SheetSettings(workers=processes, rounds=split == "adv"))
    say("4/4 writing the leaderboard")
    write_leaderboard(
        read_results(find_records(space.run_root()), sheets=find_scene_pages(space.sheet_root())), out / "leaderboard"
    )
    return report, records


def _evaluate_built_in(dataset: "DataSet", split: str, out: Path, processes: int) -> "list[RunRecord]":
    from adapters.models import baselines, miniatures
    from adapters.registry import planner_factory
    from benchmark.evaluation import EvalSettings, evaluate_together

    # One run of a planner whose rates are means over seeds would say little.
    single = [name for name, model in baselines().items() if model.draws == 1]
    planners, runs = (*single, *miniatures()), api.workspace(out).run_root()
    api.notify(f"{pluralise(len(planners), 'planner')} on {split}: {', '.join(planners)}")
    settings = EvalSettings(workers=processes, timings=api.workspace(out).timings_of(runs))
    return evaluate_together(dataset, split, [(planner_factory(name), settings) for name in planners], runs)


def full_demo(out: Path = api.OUT, to: Path = RESULTS, *, workers: int = 0) -> list[Path]:
    """Measure what docs/results shows: all splits of mini (adv is the newest frozen one), all planners, the ablation.

    Args:
        out: Folder for everything that is made.
        to: Folder of the page and its numbers.
        workers: Processes; 0 takes all processors.

    Returns:
        The page and its numbers.

    Raises:
        InputError: If something cannot be built, run or written.
    """
    from benchmark.datasets.roots import open_data as open_root
    from benchmark.machine.workers import LocalProcesses
    from benchmark.machine.workspace import EMBEDDED
    from generation.pipeline.ablation import run_ablation
    from generation.pipeline.settings import BuildSettings
    from generation.search.presets import build_hyper_parameters
    from leaderboard.results import write_results

    made_from, source, processes = (
        describe_sources(),
        api.open_data(EMBEDDED, workers=workers),
        api.worker_count(workers),
    )
    records = []
    for split in ("val", "val-r", "adv"):
        # Planners see key frames only; drawing the other frames would take most of the time.
        if split == "adv":
            # Not a split that was searched below the same folder: the page is about the frozen split.
            dataset = open_root(api.build_frozen_root(source, workers), name=source.name)
        else:
            dataset = api.open_split(source, split, out, workers=workers, frames="keyframes")
        records += _evaluate_built_in(dataset, split, out, processes)
    driver = api.planner_under_test("uniad-mini", data=EMBEDDED, workers=workers)
    study = api.workspace(out).ablation_root() / source.name / driver.factory.facts.name
    settings = BuildSettings(
        out=study,
        timings=api.workspace(out).timings_of(study),
        hyper=build_hyper_parameters("default", {"candidate_limit": FULL_DEMO_VEHICLES}),
        renderer=api.schematic_renderer(),
        frames="keyframes",
        executor=LocalProcesses(processes),
    )
    api.notify(f"ablation with {driver.factory.facts.name}")
    return write_results(source.name, records, [run_ablation(source, driver, settings)], made_from, to)


def stale_demo(to: Path = RESULTS) -> list[str]:
    """Why the results of `full_demo` are not what would be measured now: one sentence a reason, none if current."""
    from leaderboard.results import find_stale_results

    return find_stale_results(to, describe_sources())


def describe_sources() -> dict[str, Any]:
    """Sources that the measured results depend on: miniatures, town, frozen split, renderer, search and protocols."""
    from dataclasses import asdict

    from adapters.models import miniatures
    from benchmark.machine.storage import content_key, file_sha256
    from benchmark.protocols import PROTOCOLS, STANDARD
    from generation.search.adversary import ALGORITHM_VERSION
    from generation.search.definition import PackagedPrior
    from generation.search.presets import build_hyper_parameters
    from generation.sources.embedded import find_town
    from generation.splits.packaged import read_newest_split

    newest, renderer = read_newest_split("mini"), api.schematic_renderer()
    return {
        "weights": {name: file_sha256(miniature.packaged) for name, miniature in miniatures().items()},
        "configurations": {
            name: content_key(asdict(miniature.configuration()))[:12] for name, miniature in miniatures().items()
        },
        "town": find_town("mini").drawn_name(),
        "frozen split": [newest.name, newest.frozen.content_id],
        "search": [ALGORITHM_VERSION, build_hyper_parameters().fingerprint, FULL_DEMO_VEHICLES],
        "renderer": [renderer.name, renderer.version],
        "trajectory model": PackagedPrior(None, "cpu")().fingerprint,
        "protocols": {name: PROTOCOLS[name].version for name in STANDARD},
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """Options of ``demo``."""

    out: shared.Out = api.OUT
    town_scenes: Annotated[int, Option("Scenes of the embedded town.", min=1)] = 4
    full: Annotated[bool, Option("All splits of mini, all built-in planners, the ablation; write --to.", "Output")] = (
        False
    )
    check: Annotated[bool, Option("With --full: only say whether --to is current.", "Output")] = False
    to: Annotated[Path, Option("With --full: folder of the page and its numbers.", "Output")] = RESULTS
    workers: shared.Workers = 0
    wide: shared.Wide = False
    verbose: shared.Verbose = False
    json_output: shared.Json = False


@command(DemoOptions, panel="Run")
def demo_command(options: DemoOptions) -> None:
    """Tell the whole story on the embedded data: generate, evaluate, transfer, tables, site."""
    from benchmark.machine.path_checks import require_place, require_room

    if options.check and not options.full:
        raise InputError("--check applies only to demo --full; add --full or leave --check out")
    if options.check:
        stale = stale_demo(options.to)
        text = "\n".join(stale) or f"{options.to} is current"
        print_result({"stale": stale}, text, json_output=options.json_output)
        raise typer.Exit(1 if stale else 0)
    api.worker_count(options.workers)
    require_place(options.out, "--out")
    require_room(options.out, api.estimate_town_bytes(2 * options.town_scenes, frames="keyframes"), "the demo", "--out")
    if options.full:
        files = [str(path) for path in full_demo(options.out, options.to, workers=options.workers)]
        print_result({"files": files}, "\n".join(files), json_output=options.json_output)
        return
    from generation.search.verify import format_masked_steps
    from leaderboard.frame.runs import DataSetRuns
    from leaderboard.tables.collision import run_tables
    from leaderboard.tables.effect import effect_table
    from leaderboard.tables.transfer import transfer_matrices, transfer_table

    tell = partial(typer.echo, err=options.json_output)
    report, records = demo(options.out, town_scenes=options.town_scenes, workers=options.workers, say=tell)
    if options.json_output:
        print_json({"leaderboard": str(options.out / "leaderboard"), "generated": report.as_json()})
        return
    tell(f"{format_masked_steps(report.masked_steps)}\n" if options.verbose else "")
    caused = effect_table(DataSetRuns("demo", records))
    tables = [*(() if caused is None else (caused,)), *run_tables("demo", records, ("exact",), allow_partial=True)]
    tables += [transfer_table(name, matrix) for name, matrix in transfer_matrices(records, "adv").items()]
    print_tables(tables, wide=options.wide, verbose=options.verbose)
    leaderboard = options.out / "leaderboard"
    tell(f"site: {leaderboard / 'site' / 'index.html'}   tables: {leaderboard / 'README.md'}")
    again = f" --data demo{repeat_out_option(options.out)}"
    films, driven = Path("films"), api.workspace(options.out).drive_root() / "demo"
    film = (f"film --limit 1 --model uniad --model idm --to {films}{again}", "film of a scene")
    drive = (f"drive --limit 1 --model uniad --sensor schematic{again}", "closed loop: the plan is driven")
    print_next_steps(
        f"scenes: {options.out / 'data' / 'demo' / 'adv'}\n"
        f"your own planner: challenger-bench eval --model my_planner:MyPlanner{again} (docs/planners.md has the class)",
        None if films.exists() else film,
        None if driven.exists() else drive,
        json_output=options.json_output,
    )
