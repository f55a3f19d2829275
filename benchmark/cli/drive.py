"""``drive``: planners in closed loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.drive_splits import choose_drive_splits, plan_splits
from benchmark.cli.options import make_executor, parse_name_list, parse_shard
from benchmark.cli.output import (
    Step,
    find_records_of,
    print_json,
    print_next_steps,
    print_plan,
    print_shard_progress,
    print_tables,
    repeat_data_options,
    warn_of_caveats,
)
from benchmark.cli.settings import Option, command, take_options
from benchmark.errors import InputError
from benchmark.machine.address import find_scheme, is_address
from benchmark.report.words import format_options

if TYPE_CHECKING:
    from adapters.registry import NamedPlanner
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workers import Executor
    from benchmark.records.drives import DriveRecord
    from benchmark.runs.driving import DriveSettings

BASELINES: Final = ("stop", "constant-velocity", "constant-velocity-on-path", "log-replay", "idm")
"""Planners that every table has: without them no number of closed loop says much."""
TOGETHER: Final = 20
"""Drives side by side in a process, of planners that need no images: what more would bring is lost in what it holds."""
STEP_MS: Final = 100
LONGEST_LATENCY_MS: Final = 3000


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions:
    """Options of ``drive``."""

    EXTENDED: ClassVar = ("planner",)

    RARE: ClassVar = (
        *("tables", "categories", "adversary_every", "adversary_others", "adversary_rounds", "adversary_candidates"),
        *("adversary_tracks", "keep_considered", "image_format", "frame", "accept_torch_tensors", "scenarios"),
        *("target", "timeout", "memory_limit", "precision", "address", "cameras", "driving_side", "plan_hz"),
    )

    model: shared.Models = ()
    split: shared.Splits = ("adv",)
    data: shared.Data = "mini"
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    out: shared.Out = api.OUT
    json_output: shared.Json = False
    dry_run: shared.DryRun = False
    wide: shared.Wide = False
    verbose: shared.Verbose = False
    sensor: Annotated[str, Option("Cameras: none, schematic or http://HOST:PORT.", "Planner")] = "none"
    checkpoint: shared.Checkpoint = None
    device: shared.NetworkDevices = None
    baselines: Annotated[
        bool, Option("Also the five that every table has.", "Planner", names="--baselines/--no-baselines")
    ] = True
    engine: Annotated[
        Literal["default", "neuroncap@code", "neuroncap@paper"],
        Option("Who drives the plans (docs/closed-loop.md).", "Search", offers=("engine", ("default",))),
    ] = "default"
    window: Annotated[
        Literal["encounter", "scene"] | None,
        Option("Of adversarial scenes: from 3 s before the adversary departs (the default), or all.", "Search"),
    ] = None
    agents: Annotated[
        str | None,
        Option(
            "The others: replay (their tracks), idm (they keep distance, adversaries do not; default of adversarial "
            "scenes), adversary (one challenges the ego), or grpc://HOST:PORT.",
            "Search",
            metavar="[replay|idm|adversary|grpc://HOST:PORT]",
        ),
    ] = None
    adversary_knows: Annotated[
        Literal["plan", "motion", "motion-only", "nothing"],
        Option(
            "adversary: expects that the ego drives its plan, keeps its motion (on its route, or only), or stays.",
            "Search",
        ),
    ] = "motion"
    latency: Annotated[int, Option("Delay before a plan takes effect, ms.", "Search", min=0)] = 0
    plan_hz: Annotated[
        Literal["2", "10"],
        Option("How often planners are asked in a second; policies are trained for theirs.", "Search"),
    ] = "2"
    until: Annotated[
        Literal["contact", "fault", "fault@nuplan"],
        Option(
            "What ends a drive: any contact, or one that is the ego's fault by fault@1 or nuPlan's rule (others go).",
            "Search",
        ),
    ] = "contact"
    runs: Annotated[int, Option("Runs of each scene; one where nothing is drawn.", "Search", min=1)] = 1
    workers: shared.Workers = 0
    seed: shared.Seed = 0
    executor: shared.Executor = "local"
    address: shared.Address = None
    shard: shared.Shard = None
    tables: shared.Tables = None
    categories: shared.Categories = None
    driving_side: shared.DrivingSide = None
    cameras: shared.Cameras = None
    adversary_every: Annotated[float, Option("adversary: seconds between its plans, at most 3.", "Search")] = 1.0
    adversary_others: Annotated[
        Literal["replay", "idm"], Option("adversary: how everybody else behaves.", "Search")
    ] = "replay"
    adversary_rounds: Annotated[
        int | None, Option("adversary: refinement rounds of its search; 5 if not given.", "Search", min=0)
    ] = None
    adversary_candidates: Annotated[
        int | None, Option("adversary: candidates of each round; 256 if not given.", "Search", min=1)
    ] = None
    adversary_tracks: Annotated[
        Path | None,
        Option("adversary: drives the tracks of this record of drives once more, and plans nothing.", "Search"),
    ] = None
    keep_considered: Annotated[bool, Option("adversary: keep what it considers, for films and the site.", "Output")] = (
        False
    )
    scenarios: Annotated[
        str,
        Option(
            "neuroncap: scenes as they are (recorded), or scenarios put into them: own, official, or FILE.yaml of "
            "NeuroNCAP.",
            "Search",
        ),
    ] = "recorded"
    target: Annotated[
        Literal["adversary", "none"],
        Option("neuroncap, recorded scenes: whom the reference speed is relative to; NeuroNCAP has none.", "Search"),
    ] = "adversary"
    image_format: shared.ImageFormat = None
    frame: shared.PlanFrame = None
    accept_torch_tensors: Annotated[
        bool, Option("A renderer's pictures may be saved tensors (pickles).", "Planner")
    ] = False
    timeout: Annotated[float, Option("Seconds that a plan may take.", "Planner", min=0.001, max=86_400.0)] = 120.0
    memory_limit: shared.MemoryLimit = None
    precision: shared.Precision = None

    @staticmethod
    def from_record(members: "Mapping[str, Any]") -> "dict[str, Any] | None":
        """Settings of a record of drives."""
        from benchmark.cli.record_settings import read_drive_options

        return read_drive_options(members)


@command(DriveOptions, panel="Run")
def drive_command(options: DriveOptions) -> None:
    """Drive planners in closed loop: the plan is driven and the world answers; the same command resumes."""
    from benchmark.machine.path_checks import require_place
    from benchmark.machine.several_devices import count_workers, require_one_device

    _require_engine(options)
    names = tuple(dict.fromkeys([*options.model, *(BASELINES if options.baselines else ())]))
    if not names:
        raise InputError("name a planner with --model (for example constant-velocity), or leave --no-baselines out")
    # A little longer than the drive's own limit, so that a late planner is reported for one reason only.
    own = take_options("planner", [find_scheme(name) or name for name in options.model])
    planners = api.PlannerSource.of(options, deadline_s=options.timeout + 5.0, of_extensions=own).require()
    supervision = replace(planners.supervision, sample_s=options.timeout)
    for planner in planners.runnable_names:
        if options.sensor == "none" and api.uses_images(planner):
            raise InputError(f"{planner} needs images, and --sensor none provides none; add --sensor schematic")
    planners.require_frame()
    planners.require_servers(options.sensor, tensors=options.accept_torch_tensors)
    shard = parse_shard(options.shard)
    if options.executor != "local":
        require_one_device(options.device, "a Ray cluster assigns GPUs to its tasks")
    place = make_executor(options.executor, options.address, count_workers(options.workers, options.device))
    data, scenes = api.DataSource.of(options), parse_name_list(options.scenes)
    taken = choose_drive_splits(data, options.split, scenes, options.limit)
    require_place(options.out, "--out")
    taken.say()
    building = {split: ahead for split, ahead in taken.ahead.items() if ahead.builds}
    if options.dry_run and building:
        drives = (
            ahead.plan(f"drive {', '.join(names)} through {ahead.counted()} of {split}")
            for split, ahead in building.items()
        )
        print_plan([*dict.fromkeys(line for lines in drives for line in lines)], json_output=options.json_output)
        return
    # Planners first: importing a class of another package may fail, and data may take minutes to build.
    loaded = dict(zip(options.model, planners.load(supervision)))
    factories = [
        loaded[planner] if planner in loaded else api.load_planner(planner, data=options.data) for planner in names
    ]
    space = api.workspace(options.out)
    root = space.drive_root()
    jobs = [
        (dataset, split, replace(how, timings=space.timings_of(root)))
        for dataset, split, how in plan_splits(
            data,
            [*taken.ahead],
            lambda split, adversarial: _settings(options, split, scenes, place, adversarial=adversarial),
            paired=options.engine == "default" and options.agents in (None, "replay", "idm"),
        )
    ]
    if options.dry_run:
        from benchmark.runs.drive_estimate import estimate_driving

        estimates = [
            estimate_driving(dataset, split, planner, _settings_of(planner, how), root)
            for dataset, split, how in jobs
            for planner in factories
        ]
        print_plan(estimates, json_output=options.json_output)
        return
    if shard is not None:
        from benchmark.runs.driving import drive_shard

        groups = [[planner for planner in factories if _is_blind(planner)]]
        groups += [[planner] for planner in factories if not _is_blind(planner)]
        done = [
            progress
            for dataset, split, how in jobs
            for group in filter(None, groups)
            for progress in drive_shard(dataset, split, group, root, _settings_of(group[0], how), shard)
        ]
        print_shard_progress(shard, done, "driven", json_output=options.json_output)
        return
    records = [
        record for dataset, split, how in jobs for record in _drive_planners(dataset, split, factories, root, how)
    ]
    warn_of_caveats(record.facts for record in records)
    sound = _show(records, options)
    print_next_steps(
        f"records: {', '.join(str(record.directory) for record in records)}",
        _suggest_evaluation(options, list(zip(names * len(jobs), records))),
        json_output=options.json_output,
    )
    if not sound:
        raise typer.Exit(1)


def _suggest_evaluation(options: DriveOptions, driven: "Sequence[tuple[str, DriveRecord]]") -> Step:
    """The step to open loop, of planners that drove, as they were given, and have no record there."""
    lacking = [
        (record.facts.split, name)
        for name, record in driven
        if record.complete
        and not find_records_of(options.out, record.facts.data.name, record.facts.split, record.facts.planner.name)
    ]
    splits, missing = (list(dict.fromkeys(column)) for column in zip(*lacking)) if lacking else ([], [])
    served = {"image_format": options.image_format, "frame": options.frame} if any(map(is_address, missing)) else {}
    given = format_options(split=splits, model=missing, checkpoint=options.checkpoint, **served)
    step = (f"eval{given}{repeat_data_options(options)}", "evaluate the same planners in open loop")
    return step if missing else None


def _settings(
    options: DriveOptions, split: str, scenes: tuple[str, ...] | None, place: "Executor", *, adversarial: bool
) -> "DriveSettings":
    same = (
        *("engine", "agents", "window", "adversary_knows", "adversary_others", "adversary_rounds", "limit", "seed"),
        *("adversary_candidates", "adversary_tracks", "keep_considered", "sensor", "accept_torch_tensors", "until"),
        *("scenarios", "target", "runs"),
    )
    return api.drive_settings(
        split,
        adversarial=adversarial,
        adversary_every_s=options.adversary_every,
        latency_ms=options.latency,
        plan_hz=int(options.plan_hz),
        timeout_s=options.timeout,
        scenes=scenes,
        executor=place,
        **{name: getattr(options, name) for name in same},
    )


def _require_engine(options: DriveOptions) -> None:
    """Refuse what engines of extensions have not, a latency that no engine has, and an adversary that there is not."""
    engine, latency = options.engine, options.latency
    if engine != "default":
        if options.agents not in (None, "replay"):
            raise InputError(
                f"road users of {engine} never react; leave --agents {options.agents} out or use --engine default"
            )
        if latency:
            raise InputError(f"{engine} does not simulate latency; leave --latency out or use --engine default")
        if options.plan_hz != "2":
            raise InputError(
                f"planners are asked every half second in {engine}; leave --plan-hz {options.plan_hz} out or use "
                "--engine default"
            )
        if options.until != "contact":
            raise InputError(
                f"every collision ends a run of {engine}; leave --until {options.until} out or use --engine default"
            )
        api.require_engine(engine, options.scenarios, options.target)
    elif (options.scenarios, options.target) != ("recorded", "adversary"):
        given = f"--target {options.target}" if options.scenarios == "recorded" else f"--scenarios {options.scenarios}"
        raise InputError(f"{given} needs NeuroNCAP's engine; add --engine neuroncap@code")
    if latency % STEP_MS or latency > LONGEST_LATENCY_MS:
        raise InputError(
            f"--latency {latency} is not a multiple of {STEP_MS} ms up to {LONGEST_LATENCY_MS}: the engine's steps are "
            f"{STEP_MS} ms and a plan is 3 s long"
        )
    usual = DriveOptions()
    about_adversary = ("knows", "others", "every", "rounds", "candidates")
    of_adversary = (*(f"adversary_{name}" for name in about_adversary), "keep_considered")
    if options.agents != "adversary" and any(getattr(options, name) != getattr(usual, name) for name in of_adversary):
        raise InputError(
            f"--agents {options.agents or 'replay'} has no adversary; use --agents adversary, or leave --adversary-... "
            "and --keep-considered out"
        )


def _drive_planners(
    data: "DataSet", split: str, factories: "Sequence[NamedPlanner]", root: Path, how: "DriveSettings"
) -> "list[DriveRecord]":
    """Records in the order of the planners; built-in ones that look at nothing are driven side by side."""
    from benchmark.runs.driving import drive_planners, drive_split

    blind_places = [place for place, planner in enumerate(factories) if _is_blind(planner)]
    records: dict[int, DriveRecord] = {}
    # They come last: another planner may turn out to need images, and is refused at its first plan.
    for place, planner in enumerate(factories):
        if place not in blind_places:
            records[place] = drive_split(data, split, planner, root, how)
    if blind_places:
        blind_settings = _settings_of(factories[blind_places[0]], how)
        records |= zip(
            blind_places,
            drive_planners(data, split, [factories[place] for place in blind_places], root, blind_settings),
        )
    return [records[place] for place in range(len(factories))]


def _is_blind(planner: "NamedPlanner") -> bool:
    return api.uses_images(planner.name) is False


def _settings_of(planner: "NamedPlanner", how: "DriveSettings") -> "DriveSettings":
    """How a planner is driven: those that look at nothing have no sensor, and company."""
    from benchmark.closed_loop.observation_builder import NoSensor

    return replace(how, sensor=NoSensor(), together=TOGETHER) if _is_blind(planner) else how


def _show(records: "Sequence[DriveRecord]", options: DriveOptions) -> bool:
    """Print the tables; whether no planner failed."""
    from benchmark.metrics.drive_effect import drive_effect_to_json
    from benchmark.records.drives import ROWS_FILE
    from leaderboard.tables.drives import describe_failures, drive_tables

    if options.json_output:
        print_json(
            [
                {
                    "directory": str(record.directory),
                    "planner": record.planner,
                    "status": record.facts.status,
                    "measured": record.facts.measured.model_dump(mode="json"),
                    "runs": record.facts.runs,
                    **drive_effect_to_json(record, records),
                    **record.summary.model_dump(mode="json", by_alias=True),
                }
                for record in records
            ]
        )
    else:
        print_tables(drive_tables(records), wide=options.wide, verbose=options.verbose)
    partial = [record for record in records if not record.complete]
    for record in partial:
        rows = record.directory / ROWS_FILE
        typer.echo(f"{describe_failures(record)}; no score includes them; {rows} has each failure", err=True)
    return not partial
