"""A build in shards (`benchmark.runs.units`): each searches its recordings, later draws its scenes."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.progress import CountedUnits
from benchmark.records.seed_splits import strip_ego
from benchmark.runs.units import Shard, ShardProgress
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import require_own_root
from generation.pipeline.recordings import build_search, require_buildable
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import PreparedBuild, prepare_build, prepare_originals, run_search
from generation.pipeline.writing import WritingJob, mark_unfinished_if_changed, write_scenes
from generation.search.definition import Search
from generation.splits.building import build_frozen_jobs, build_report_files, require_rebuildable
from generation.splits.packaged import NamedSplit

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class BuiltShard:
    """Work of one shard of a build: ``searched`` its recorded scenes, or ``drawn`` its scenes of the new data set."""

    did: Literal["searched", "drawn"]
    finished: ShardProgress


def build_shard(source: DataSet, split: str, settings: BuildSettings, shard: Shard) -> BuiltShard:
    """Do every n-th share of a build: search, or draw once everything is searched; no tables are written.

    `generation.pipeline.split.build_split` with the same settings does what is left; a surrogate is refused, because it
    judges all scenes together.
    """
    if settings.surrogate is not None:
        raise InputError(
            "a surrogate needs all scenes together; search in shards without --surrogate, and give it to the command "
            "that runs last, without --shard"
        )
    names = require_buildable(source, split, settings)
    if strip_ego(split) == "val-r":
        plan, jobs, _, files = prepare_originals(source, split, names, settings)
        return _draw_part(source, plan, shard.part(jobs), len(jobs), files, settings)
    search = build_search(source, names, settings)
    prepared = _find_finished_search(source, split, search, names, settings)
    if prepared is None:
        mine = shard.part(names)
        run_search(source, search, mine, settings, keep=True)
        return BuiltShard("searched", ShardProgress(settings.out, len(mine), len(names)))
    jobs = prepared.chosen.jobs
    return _draw_part(source, prepared.plan, shard.part(jobs), len(jobs), prepared.files, settings)


def draw_frozen_shard(
    source: DataSet, split: NamedSplit, settings: BuildSettings, shard: Shard, *, as_split: str = "adv"
) -> BuiltShard:
    """Draw every n-th scene of a frozen split; `generation.splits.building.build_frozen` does what is left."""
    plan, chosen, report = require_rebuildable(source, split, settings, as_split)
    jobs, _, _ = build_frozen_jobs(source, plan, shard.part(chosen), split)
    return _draw_part(source, plan, jobs, len(chosen), build_report_files(report), settings)


def _draw_part(
    source: DataSet,
    plan: DataSetPlan,
    mine: Sequence[WritingJob],
    count: int,
    files: dict[str, bytes],
    settings: BuildSettings,
) -> BuiltShard:
    # Before anything is written: writing would make a foreign root look like one of ours.
    for variant in sorted({job.variant for job in mine}):
        require_own_root(plan, variant)
    mark_unfinished_if_changed(plan.root, files)
    write_scenes(plan, mine, source.scene, settings.where_rendered, timing=settings.timing / "rendering")
    return BuiltShard("drawn", ShardProgress(plan.root, len(mine), count))


def _find_finished_search(
    source: DataSet, split: str, search: Search, names: Sequence[str], settings: BuildSettings
) -> PreparedBuild | None:
    try:
        return prepare_build(
            source, split, search, names, replace(settings, executor=_CachedOnlyExecutor()), keep=False
        )
    except _MissingAttemptError:
        return None


class _MissingAttemptError(Exception):
    """An attempt is not kept."""


@dataclass(frozen=True, slots=True)
class _CachedOnlyExecutor:
    """Stands where attempts are computed, to find out whether all of them are kept."""

    def map(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: CountedUnits | None = None,
    ) -> Iterator[Result]:
        """Nothing; raises `_MissingAttemptError` if there is an item."""
        for _ in items:
            raise _MissingAttemptError
        return iter(())
