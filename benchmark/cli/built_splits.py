"""Splits built by one ``generate`` command: one split, or one for each of several seeds; searched for, or frozen."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark import api
from benchmark.cli.output import (
    find_records_of,
    is_newer,
    print_next_steps,
    print_shard_progress,
    repeat_data_options,
)
from benchmark.cli.settings import is_given
from benchmark.errors import InputError
from benchmark.records.seed_splits import RECORDED_EGO, format_ego_split, parse_seed
from benchmark.report.words import format_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.api import DataSource, SourcePreview
    from benchmark.cli.generate_options import GenerateOptions
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workers import Executor
    from benchmark.runs.units import Shard
    from generation.pipeline.settings import BuildSettings
    from generation.splits.packaged import NamedSplit

SEARCH_OPTIONS: Final = (
    "freeze", "source_split", "adversaries", "surrogate", "surrogate_checkpoint", "vehicles", "per_scene", "top",
    "candidates", "rounds", "parked", "preset", "keep_unsolvable", "changes", "denoiser", "calls", "dropout", "samples",
    "device", "together", "keep_rounds", "profile", "ego",
)  # fmt: skip
"""Options of ``generate`` that say nothing to a split that is built from a frozen one."""


@dataclass(frozen=True, slots=True)
class SplitToBuild:
    """One split of a command: frozen to the file ``freeze``, or built from ``frozen`` without a search."""

    split: str
    seed: int
    freeze: Path | None = None
    frozen: "NamedSplit | None" = None


@dataclass(frozen=True, slots=True)
class BuildOutcome:
    """Outcome of one split: for people, and as JSON."""

    text: str
    said: Mapping[str, Any]


def list_splits_to_build(options: "GenerateOptions", data: "DataSource") -> tuple[SplitToBuild, ...]:
    """Splits that a command builds, one without ``--seeds``; recordings are opened only to compare edited scenes."""
    from generation.splits.format import require_freezable
    from generation.splits.packaged import (
        format_seed_path,
        parse_seeds,
        read_frozen_of_seed,
        read_frozen_split,
        require_town,
    )

    split, seed, from_file, freeze = options.split, options.seed, options.from_file, options.freeze
    if from_file is not None:
        edited = is_edited(from_file)
        _require_no_search(split, but=("freeze",) if edited else ())
        if edited:
            if options.seeds is not None:
                raise InputError("--seeds applies only to a search, and edited scenes are not searched; leave it out")
            if freeze is not None:
                require_freezable(split, freeze)
            from generation.splits.edited import build_edited_split, read_edited

            # Checked before the recordings, which may have to be built.
            files = read_edited(Path(from_file))
            return (SplitToBuild(split, seed, freeze, build_edited_split(data.open(), Path(from_file), files)),)
    if options.seeds is None:
        splits: tuple[SplitToBuild, ...] = (
            SplitToBuild(split, seed, freeze, None if from_file is None else read_frozen_split(from_file)),
        )
    else:
        if split != "adv":
            raise InputError(f"--seeds builds one adv split per seed, not {split}; leave --split out")
        if is_given("seed"):
            raise InputError("--seed and --seeds exclude each other; give only one of them")
        splits = tuple(
            SplitToBuild(
                f"adv-seed-{split_seed}",
                split_seed,
                None if freeze is None else format_seed_path(freeze, split_seed),
                None if from_file is None else read_frozen_of_seed(Path(from_file), split_seed),
            )
            for split_seed in parse_seeds(options.seeds)
        )
    for split_to_build in splits:
        if split_to_build.frozen is not None:
            require_town(split_to_build.frozen, data.name)
        if split_to_build.freeze is not None:
            require_freezable(split_to_build.split, split_to_build.freeze)
    return splits


def name_after_ego(wanted: "Sequence[SplitToBuild]", ego: str) -> tuple[SplitToBuild, ...]:
    """The same splits, called after who drives their ego: the search's, or a frozen split's own."""
    named = []
    for one in wanted:
        driver = ego if one.frozen is None else one.frozen.frozen.search.ego or RECORDED_EGO
        if driver != RECORDED_EGO and parse_seed(one.split) is not None:
            raise InputError("--seeds builds splits of recorded egos; leave --seeds or --ego out")
        named.append(replace(one, split=format_ego_split(one.split, driver)))
    return tuple(named)


def require_trajectory_model(device: str, denoiser: Path | None) -> None:
    """Refuse a trajectory model that could not run."""
    from benchmark.machine.path_checks import require_file

    api.require_devices(device)
    require_file(denoiser, "--denoiser")


def require_cluster(place: "Executor", ahead: "SourcePreview") -> None:
    """Refuse a cluster that does not answer before minutes go into what is built for it here."""
    from benchmark.machine.ray_cluster import RayCluster, require_answer

    if ahead.builds and isinstance(place, RayCluster) and place.address is not None:
        require_answer(place.address)


def is_edited(from_file: str) -> bool:
    """Whether ``--from`` names ScenarioNet files of edited scenes: one, or a folder of them."""
    from generation.splits.packaged import list_packaged_splits

    path = Path(from_file)
    return from_file not in list_packaged_splits() and (path.suffix.lower() == ".pkl" or path.is_dir())


def list_frozen_scenes(
    wanted: "Sequence[SplitToBuild]", names: tuple[str, ...] | None, limit: int | None
) -> tuple[str, ...]:
    """Names of the scenes that frozen splits give, all or those that were asked for."""
    chosen = [
        split_to_build.frozen.chosen(names, limit) for split_to_build in wanted if split_to_build.frozen is not None
    ]
    return tuple(scene.name for of_split in chosen for scene, _ in of_split)


def build_split_of_command(
    source: "DataSet",
    one: SplitToBuild,
    settings: "BuildSettings",
    unlike: "Sequence[str]",
    options: "GenerateOptions",
) -> BuildOutcome:
    """Build a split; what is said of it names where the preset departs from its name and where the time went."""
    if one.frozen is not None:
        from generation.splits.building import build_frozen

        if one.freeze is not None and not settings.dry_run:
            from generation.splits.format import write_frozen

            write_frozen(one.freeze, one.frozen.frozen)
        built = build_frozen(source, one.frozen, settings, as_split=one.split)
        return BuildOutcome(built.summary(verbose=options.verbose), built.as_json())
    from generation.pipeline.split import build_split

    report = build_split(source, one.split, settings)
    runtime = report.runtime if options.profile else None
    departures = {"departures": list(unlike)} if unlike else {}
    timed = {} if runtime is None else {"runtime": runtime.model_dump()}
    table = "" if runtime is None else "\n" + runtime.table().plain(indent="  ", least=(10, 9, 9, 9)).rstrip("\n")
    text = "\n".join([report.summary(verbose=options.verbose), *unlike]) + table
    return BuildOutcome(text, report.as_json() | departures | timed)


def build_shards(
    source: "DataSet",
    wanted: "Sequence[SplitToBuild]",
    settings: "Sequence[BuildSettings]",
    shard: "Shard",
    *,
    json_output: bool,
) -> None:
    """Do one shard of each split and say what comes next."""
    from generation.pipeline.shards import build_shard, draw_frozen_shard

    finished_shards = []
    for split_to_build, split_settings in zip(wanted, settings, strict=True):
        if split_to_build.frozen is not None:
            finished_shards.append(
                draw_frozen_shard(source, split_to_build.frozen, split_settings, shard, as_split=split_to_build.split)
            )
        else:
            finished_shards.append(build_shard(source, split_to_build.split, split_settings, shard))
    for did, when in (
        ("searched", "once all shards are done; with --shard it draws in shards"),
        ("drawn", "once all shards are done"),
    ):
        shards_of_step = [progress.finished for progress in finished_shards if progress.did == did]
        if shards_of_step:
            print_shard_progress(shard, shards_of_step, did, when, json_output=json_output)


def require_shardable(shard: "Shard | None", surrogate: str | None, executor: "Executor") -> None:
    """Refuse a shard where all scenes have to be together, or a cluster shares work out itself."""
    if shard is None:
        return
    if surrogate is not None:
        raise InputError(
            "--surrogate evaluates all scenes together; search in shards without it, and add it to the "
            "last command, the one without --shard"
        )
    from benchmark.machine.workers import LocalProcesses

    if not isinstance(executor, LocalProcesses):
        raise InputError("a Ray cluster distributes the work itself; leave --shard or --executor ray out")


def print_built_splits(
    wanted: "Sequence[SplitToBuild]", settings: "Sequence[BuildSettings]", data_name: str, options: "GenerateOptions"
) -> None:
    """Say where the built splits are, and what comes next."""
    from benchmark.machine.workspace import is_finished

    roots, files = (
        ", ".join(map(str, places))
        for places in zip(*((split_settings.out, split_settings.freeze) for split_settings in settings))
    )
    split, root = wanted[0].split, settings[0].out
    # Written anew only if they change.
    pictures, made = options.out / "pictures" / data_name / split, [*root.glob("*.json")]
    show = (f"data show {shlex.quote(str(root))}{format_options(to=pictures)}", "draw a picture of each scene")
    # Without --split a planner runs on the unchanged recordings too.
    named = format_options(split=None if split == "adv" else split, model="idm") + repeat_data_options(options)
    evaluate = (f"eval{named}", "a planner on it; yours: docs/planners.md")
    judged = [file for file in find_records_of(options.out, data_name, split, "idm") if is_newer(file, made)]
    steps = (None if is_newer(pictures, made) else show, None if judged else evaluate)
    print_next_steps(
        f"data set: {roots}" + ("" if wanted[0].freeze is None else f"; frozen split: {files}"),
        *(steps if is_finished(root) else ()),
        json_output=options.json_output,
    )


def _require_no_search(split: str, but: tuple[str, ...] = ()) -> None:
    """Refuse options of the search beside a frozen split."""
    if split != "adv":
        raise InputError(f"--from always builds split adv, not {split}; leave --split out")
    for name in SEARCH_OPTIONS:
        if name not in but and is_given(name):
            option = {"changes": "set"}.get(name, name).replace("_", "-")
            raise InputError(f"--{option} applies only to a search, and --from does not search; leave one of them out")
