"""``drive``: planners in closed loop."""

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from benchmark import api
from benchmark.cli.caveats import warn_of_caveats
from benchmark.cli.options import (
    AddressOption,
    CategoriesOption,
    DataOption,
    DryRunOption,
    ExecutorName,
    ExecutorOption,
    FrameName,
    ImageFormatName,
    ImageFormatOption,
    JsonOption,
    LimitOption,
    MemoryLimitOption,
    OutOption,
    PlanFrameOption,
    ScenesOption,
    SeedOption,
    ShardOption,
    SplitOption,
    TablesOption,
    WideOption,
    WorkersOption,
    executor_of,
    name_list,
    print_json,
    say_plan,
)
from benchmark.cli.shards import say_shard
from benchmark.cli.what_next import same_place, say_next
from benchmark.errors import InputError

if TYPE_CHECKING:
    from adapters.registry import NamedPlanner
    from benchmark.datasets.roots import DataSet
    from benchmark.records.drives import DriveRecord
    from benchmark.runs.driving import DriveSettings
    from benchmark.runs.units import Shard

BASELINES: Final = ("stop", "constant-velocity", "constant-velocity-on-path", "log-replay", "idm")
"""Planners that every table has: without them no number of closed loop says much."""
TOGETHER: Final = 20
"""Drives side by side in a process, of planners that need no images: what more would bring is lost in what it holds."""
STEP_MS: Final = 100
LONGEST_LATENCY_MS: Final = 3000


class EngineName(StrEnum):
    """Who drives plans."""

    DEFAULT = "default"
    CODE = "neuroncap@code"
    PAPER = "neuroncap@paper"


class AgentsName(StrEnum):
    """How the others behave."""

    REPLAY = "replay"
    IDM = "idm"
    ADVERSARY = "adversary"


class KnowsName(StrEnum):
    """What an adversary expects of the ego."""

    PLAN = "plan"
    MOTION = "motion"
    NOTHING = "nothing"


class OthersName(StrEnum):
    """How those behave who are beside an adversary."""

    REPLAY = "replay"
    IDM = "idm"


class ScenariosName(StrEnum):
    """What scenes are driven with, in NeuroNCAP's engine."""

    RECORDED = "recorded"
    OWN = "own"
    OFFICIAL = "official"


class UntilName(StrEnum):
    """What ends a drive before its time."""

    CONTACT = "contact"
    FAULT = "fault"


def drive_command(
    model: Annotated[
        list[str],
        typer.Option(
            "--model", metavar="<str>", help="Planner name, package.module:Class or http://HOST:PORT; may be repeated."
        ),
    ] = [],  # noqa: B006 - typer reads the default, nothing changes it
    split: SplitOption = "adv",
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    categories: CategoriesOption = None,
    engine: Annotated[
        EngineName, typer.Option(help="Who drives the plans (docs/closed-loop.md).")
    ] = EngineName.DEFAULT,
    agents: Annotated[
        AgentsName,
        typer.Option(help="The others: their tracks, keeping distance, or one of them challenges the ego."),
    ] = AgentsName.REPLAY,
    adversary_knows: Annotated[
        KnowsName, typer.Option(help="adversary: expects that the ego drives its plan, keeps its motion, or stays.")
    ] = KnowsName.MOTION,
    adversary_every: Annotated[float, typer.Option(help="adversary: seconds between its plans, at most 3.")] = 1.0,
    adversary_others: Annotated[
        OthersName, typer.Option(help="adversary: how everybody else behaves.")
    ] = OthersName.REPLAY,
    adversary_rounds: Annotated[
        int | None, typer.Option(min=0, help="adversary: refinement rounds of its search; 5 if not given.")
    ] = None,
    adversary_candidates: Annotated[
        int | None, typer.Option(min=1, help="adversary: candidates of each round; 256 if not given.")
    ] = None,
    adversary_tracks: Annotated[
        Path | None,
        typer.Option(help="adversary: drives the tracks of this record of drives once more, and plans nothing."),
    ] = None,
    keep_considered: Annotated[
        bool,
        typer.Option("--keep-considered", help="adversary: keep what it considers, for films and the site."),
    ] = False,
    sensor: Annotated[
        str, typer.Option(help="What cameras see: none, schematic or http://HOST:PORT; blind planners have none.")
    ] = "none",
    image_format: ImageFormatOption = None,
    frame: PlanFrameOption = None,
    accept_torch_tensors: Annotated[
        bool, typer.Option("--accept-torch-tensors", help="A renderer's pictures may be saved tensors (pickles).")
    ] = False,
    scenarios: Annotated[
        ScenariosName, typer.Option(help="neuroncap: scenes as they are, or scenarios put into them.")
    ] = ScenariosName.RECORDED,
    runs: Annotated[int, typer.Option(min=1, help="Runs of each scene; one where nothing is drawn.")] = 1,
    latency: Annotated[int, typer.Option(min=0, help="Milliseconds after which a plan takes effect.")] = 0,
    until: Annotated[
        UntilName,
        typer.Option(help="What ends a drive: any contact, or one that is the ego's fault (others who touch it go)."),
    ] = UntilName.CONTACT,
    timeout: Annotated[float, typer.Option(min=0.001, max=86_400.0, help="Seconds that a plan may take.")] = 120.0,
    baselines: Annotated[
        bool, typer.Option("--baselines/--no-baselines", help="Also the five that every table has.")
    ] = True,
    memory_limit: MemoryLimitOption = None,
    device: Annotated[
        str | None,
        typer.Option(
            help="Where a network runs: cpu, cuda, cuda:1, or cuda:0,cuda:1 for a process on each; else the first GPU."
        ),
    ] = None,
    precision: Annotated[str | None, typer.Option(help="Of a network: float32 or bfloat16.")] = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    shard: ShardOption = None,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    executor: ExecutorOption = ExecutorName.LOCAL,
    address: AddressOption = None,
    wide: WideOption = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Drive planners in closed loop: the plan is driven and the world answers; the same command resumes."""
    from benchmark.cli.preflight_data_sets import require_data
    from benchmark.cli.preflight_names import require_categories, require_models, supervision_of
    from benchmark.cli.preflight_over_http import require_frame, require_servers
    from benchmark.cli.preflight_places import require_place
    from benchmark.machine.several_devices import require_one_device, workers_for
    from benchmark.runs.units import Shard

    _require_engine(engine, agents, latency, scenarios, until)
    budget = (adversary_every, adversary_rounds, adversary_candidates)
    about_adversary = (adversary_knows, adversary_others, *budget, keep_considered)
    if agents is not AgentsName.ADVERSARY and about_adversary != _USUAL_ADVERSARY:
        raise InputError(
            f"--agents {agents.value} has no adversary; add --agents adversary or leave --adversary-... and "
            "--keep-considered out"
        )
    names = tuple(dict.fromkeys([*model, *(BASELINES if baselines else ())]))
    if not names:
        raise InputError("name a planner with --model (for example constant-velocity), or leave --no-baselines out")
    require_categories(categories)
    require_models(model, checkpoint, data=data, device=device, precision=precision)
    supervision = replace(supervision_of(model, None, memory_limit), sample_s=timeout)
    for each in model:
        _require_sight(api.model_that_runs(each, checkpoint, data=data), sensor)
    require_frame(model, None if frame is None else frame.value)
    require_servers(model, image_format, sensor, tensors=accept_torch_tensors)
    mine = None if shard is None else Shard.named(shard)
    if executor is not ExecutorName.LOCAL:
        require_one_device(device, "a Ray cluster gives its tasks GPUs itself")
    place = executor_of(executor, address, workers_for(workers, device))
    ahead = require_data(data, tables, split, out, scenes=name_list(scenes), limit=limit)
    require_place(out, "--out")
    if dry_run and ahead.builds:
        then = f"drive {', '.join(names)} through {ahead.counted()} of {split}"
        say_plan(ahead.plan(then), json_output=json_output)
        return
    # A little longer than the drive itself waits, so that who is late is late for one reason.
    over_http = {
        "image_format": (image_format or ImageFormatName.TORCH).value,
        "deadline_s": timeout + 5.0,
        "frame": (frame or FrameName.EGO).value,
    }
    # Planners first: a stranger's class may not be importable, and data may take minutes to build.
    factories = [
        api.load_planner(
            each,
            checkpoint if each in model else None,
            data=data,
            seed=seed,
            device=device,
            precision=precision,
            over_http=over_http,
            supervision=supervision,
        )
        if each in model
        else api.load_planner(each, data=data)
        for each in names
    ]
    source = api.open_data(data, tables=tables, workers=workers, out=out, categories=categories)
    dataset = api.open_split(source, split, out, workers=workers)
    how = api.drive_settings(
        split,
        engine=engine.value,
        agents=agents.value,
        adversary_knows=adversary_knows.value,
        adversary_every_s=adversary_every,
        adversary_others=adversary_others.value,
        adversary_rounds=adversary_rounds,
        adversary_candidates=adversary_candidates,
        adversary_tracks=adversary_tracks,
        keep_considered=keep_considered,
        sensor=sensor,
        accept_torch_tensors=accept_torch_tensors,
        latency_ms=latency,
        scenarios=scenarios.value,
        until=until.value,
        runs=runs,
        scenes=name_list(scenes),
        limit=limit,
        executor=place,
        timeout_s=timeout,
        seed=seed,
    )
    root = api.workspace(out).drive_root()
    how = replace(how, timings=api.workspace(out).timings_of(root))
    if dry_run:
        from benchmark.runs.drive_estimate import estimate

        said = [estimate(dataset, split, each, _settings_of(each, how), root) for each in factories]
        say_plan(said, json_output=json_output)
        return
    if mine is not None:
        again = same_place(data, out, tables, categories)
        _drive_shard(dataset, split, factories, root, how, mine, json_output=json_output, again=again)
        return
    records = _driven(dataset, split, factories, root, how)
    warn_of_caveats(record.facts for record in records)
    sound = _show(records, wide=wide, json_output=json_output)
    say_next(
        f"records: {', '.join(str(record.directory) for record in records)}",
        (f"eval --split {split}{same_place(data, out, tables, categories)}", "the same planners in open loop"),
        json_output=json_output,
    )
    if not sound:
        raise typer.Exit(1)


_USUAL_ADVERSARY: Final = (KnowsName.MOTION, OthersName.REPLAY, 1.0, None, None, False)
"""What says nothing about an adversary."""


def _require_engine(
    engine: EngineName, agents: AgentsName, latency: int, scenarios: ScenariosName, until: UntilName
) -> None:
    """Refuse what NeuroNCAP's engine has not, and a latency that no engine has."""
    if engine is not EngineName.DEFAULT:
        if agents is not AgentsName.REPLAY:
            raise InputError(
                f"actors of {engine.value} never react; leave --agents {agents.value} out or take --engine default"
            )
        if latency:
            raise InputError(f"{engine.value} has no latency; leave --latency out or take --engine default")
        if until is not UntilName.CONTACT:
            raise InputError(
                f"every contact ends a run of {engine.value}; leave --until {until.value} out or take --engine default"
            )
    elif scenarios is not ScenariosName.RECORDED:
        raise InputError(f"--scenarios {scenarios.value} are of NeuroNCAP's engine; add --engine neuroncap@code")
    if latency % STEP_MS or latency > LONGEST_LATENCY_MS:
        raise InputError(
            f"--latency {latency} is no multiple of {STEP_MS} ms up to {LONGEST_LATENCY_MS}: the engine's steps are "
            f"{STEP_MS} ms and a plan is 3 s long"
        )


def _require_sight(name: str, sensor: str) -> None:
    """Refuse to drive a planner blindly that looks at images, or is sent some."""
    if sensor == "none" and api.looks_at_images(name):
        raise InputError(f"{name} looks at images, and --sensor none has none; add --sensor schematic")


def _drive_shard(
    data: "DataSet",
    split: str,
    factories: "Sequence[NamedPlanner]",
    root: Path,
    how: "DriveSettings",
    shard: "Shard",
    *,
    json_output: bool,
    again: str,
) -> None:
    """Drive one shard and say what is left to do."""
    from benchmark.runs.driving import drive_shard

    groups = [[each for each in factories if _looks_at_nothing(each)]]
    groups += [[each] for each in factories if not _looks_at_nothing(each)]
    found = []
    for group in filter(None, groups):
        found += drive_shard(data, split, group, root, _settings_of(group[0], how), shard)
    step = (f"drive{again}", "with the same options and no --shard, when all shards are")
    say_shard(shard, found, "driven", step, json_output=json_output)


def _driven(
    data: "DataSet", split: str, factories: "Sequence[NamedPlanner]", root: Path, how: "DriveSettings"
) -> "list[DriveRecord]":
    """Records in the order of the planners; built-in ones that look at nothing are driven side by side."""
    from benchmark.runs.driving import drive_planners, drive_split

    beside = [place for place, each in enumerate(factories) if _looks_at_nothing(each)]
    records: dict[int, DriveRecord] = {}
    if beside:
        own = _settings_of(factories[beside[0]], how)
        records |= zip(beside, drive_planners(data, split, [factories[place] for place in beside], root, own))
    for place, each in enumerate(factories):
        if place not in records:
            records[place] = drive_split(data, split, each, root, how)
    return [records[place] for place in range(len(factories))]


def _looks_at_nothing(planner: "NamedPlanner") -> bool:
    return api.looks_at_images(planner.name) is False


def _settings_of(planner: "NamedPlanner", how: "DriveSettings") -> "DriveSettings":
    """How a planner is driven: those that look at nothing have no sensor, and company."""
    from benchmark.closed_loop.sensors import NoSensor

    return replace(how, sensor=NoSensor(), together=TOGETHER) if _looks_at_nothing(planner) else how


def _show(records: "Sequence[DriveRecord]", *, wide: bool, json_output: bool) -> bool:
    """Print the tables; whether no planner failed."""
    from leaderboard.tables.drives import drive_tables, said_of_failures

    if json_output:
        print_json(
            [
                {
                    "directory": str(record.directory),
                    "planner": record.planner,
                    "status": record.facts.status,
                    "measured": record.facts.measured.model_dump(mode="json"),
                    "runs": record.facts.runs,
                    **record.summary.model_dump(mode="json", by_alias=True),
                }
                for record in records
            ]
        )
    else:
        for table in drive_tables(records):
            typer.echo(table.plain(wide=wide))
    partial = [record for record in records if not record.complete]
    for record in partial:
        typer.echo(f"{said_of_failures(record)}; no number counts them", err=True)
    return not partial
