"""``demo``: the whole story on the embedded data."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark import api
from benchmark.cli.options import JsonOption, OutOption, WorkersOption, print_json
from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workspace import Workspace
    from benchmark.records.run import RunRecord


FULL_DEMO_PER_SCENE, FULL_DEMO_VEHICLES = 3, 5
"""Of each recorded scene in ``demo --full``: most variants in ``adv``, and most vehicles tried for the ablation."""


def demo_command(
    out: OutOption = api.OUT,
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
    from benchmark.datasets.roots import open_data
    from benchmark.machine.workers import LocalProcesses
    from benchmark.metrics.transfer import transfer
    from benchmark.records.scenes import find_sheets
    from benchmark.sheets.writing import SheetSettings
    from generation.build.settings import BuildSettings
    from generation.search.hyperparameters import HyperParameters
    from generation.sources.mini import TownSettings, build_town
    from leaderboard.build import write_leaderboard
    from leaderboard.tables.collision import collision_table
    from leaderboard.tables.rows import in_table_order
    from leaderboard.tables.transfer import transfer_table

    space, processes = api.workspace(out), api.worker_count(workers)

    def tell(text: str) -> None:
        typer.echo(text, err=json_output)

    tell(f"1/4 building {town_scenes} scenes of the embedded town")
    town = TownSettings(val_scenes=town_scenes)
    source = open_data(build_town(space.out / "data" / "demo" / "val", town, workers=processes), name="demo")
    settings = BuildSettings(
        out=space.split_root("demo", "adv"),
        hyper=HyperParameters(candidates=64, candidate_limit=5),
        per_scene=1,
        renderer=api.schematic_renderer(),
        frames="keyframes",
        executor=LocalProcesses(processes),
        keep_rounds=True,
    )
    tell("2/4 generating adversarial scenes")
    report = api.build_split(source, "adv", settings)
    tell(report.summary())
    tell("3/4 evaluating planners on val and adv")
    records = []
    for split in ("val", "adv"):
        dataset = api.open_split(source, split, out, workers=workers)
        records += _evaluate_demo(dataset, split, space, processes)
        sheet_settings = SheetSettings(workers=processes, rounds=split == "adv")
        api.write_sheets(dataset, split, space.sheet_root(), sheet_settings)
    tell("4/4 writing the leaderboard")
    write_leaderboard(api.records_below(out, None), out / "leaderboard", sheets=find_sheets(space.sheet_root()))
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
    from adapters.models import baselines, miniatures
    from adapters.registry import planner_factory
    from benchmark.evaluation import EvalSettings, evaluate

    records = []
    for name in (*baselines(), *miniatures()):
        typer.echo(f"{name} on {split}", err=True)
        settings = EvalSettings(workers=processes)
        records.append(evaluate(dataset, split, planner_factory(name), space.run_root(), settings))
    return records


def _full_demo(out: Path, to: Path, workers: int, *, check: bool, json_output: bool) -> None:
    """Measure what docs/results shows, or say why it is not current."""
    from benchmark.machine.workers import LocalProcesses
    from benchmark.machine.workspace import EMBEDDED
    from generation.build.ablation import ablate
    from generation.build.settings import BuildSettings
    from generation.search.hyperparameters import HyperParameters
    from leaderboard.results import stale_results, write_results

    made_from = _results_from()
    if check:
        stale = stale_results(to, made_from)
        print_json({"stale": stale}) if json_output else typer.echo("\n".join(stale) or f"{to} is current")
        raise typer.Exit(1 if stale else 0)
    source, processes = api.open_data(EMBEDDED, tables=None, workers=workers), api.worker_count(workers)
    records = []
    for split in ("val", "val-r", "adv"):
        # Planners see key frames only; the others would take most of the time.
        dataset = api.open_split(source, split, out, workers=workers, frames="keyframes", per_scene=FULL_DEMO_PER_SCENE)
        records += _evaluate_demo(dataset, split, api.workspace(out), processes)
    driver = api.planner_under_test("uniad-mini", data=EMBEDDED, workers=workers)
    settings_of_build = BuildSettings(
        out=out / "ablation" / source.name / driver.factory.facts.name,
        hyper=HyperParameters(candidate_limit=FULL_DEMO_VEHICLES),
        renderer=api.schematic_renderer(),
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
    from adapters.models import miniatures
    from benchmark.machine.storage import file_sha256
    from benchmark.protocols import PROTOCOLS
    from generation.search.adversary import ALGORITHM_VERSION
    from generation.search.definition import PackagedPrior
    from generation.search.hyperparameters import HyperParameters
    from generation.sources.mini import TownSettings

    return {
        "weights": {name: file_sha256(each.packaged) for name, each in miniatures().items()},
        "town": TownSettings().folder_name("mini"),
        "search": [ALGORITHM_VERSION, HyperParameters().fingerprint, FULL_DEMO_PER_SCENE, FULL_DEMO_VEHICLES],
        "trajectory model": PackagedPrior(None, "cpu")().fingerprint,
        "protocols": {name: definition.version for name, definition in PROTOCOLS.items()},
    }
