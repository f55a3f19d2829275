"""A build in shards (`benchmark.runs.units`): each searches its recordings, later draws its scenes."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.progress import Count
from benchmark.runs.units import FinishedShard, Shard
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import require_own_root
from generation.pipeline.recordings import ready_to_build, search_of
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import Selected, originals, searched, selected
from generation.pipeline.writing import WritingJob, unfinish_others, write_scenes
from generation.search.definition import Search
from generation.splits.building import frozen_jobs, ready_to_rebuild, said_of_frozen
from generation.splits.packaged import NamedSplit

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class BuiltShard:
    """Work of one shard of a build: ``searched`` its recorded scenes, or ``drawn`` its scenes of the new data set."""

    did: Literal["searched", "drawn"]
    finished: FinishedShard


def build_shard(source: DataSet, split: str, settings: BuildSettings, shard: Shard) -> BuiltShard:
    """Do a share of a build: search, or draw once everything is searched; no tables are written.

    `generation.pipeline.split.build_split` with the same settings does what is left.

    Args:
        settings: As of `build_split`, without a surrogate: it judges all scenes together.
        shard: Which share: every n-th recorded scene with all that is searched in it, every n-th scene that is drawn.
    """
    if settings.surrogate is not None:
        raise InputError(
            "a surrogate judges all scenes together; search in shards without --surrogate, and name it in the command "
            "that comes last, without --shard"
        )
    names = ready_to_build(source, split, settings)
    if split == "val-r":
        plan, jobs, files = originals(source, names, settings)
        return _drawn(source, plan, shard.part(jobs), len(jobs), files, settings)
    search = search_of(source, names, settings)
    prepared = _all_searched(source, split, search, names, settings)
    if prepared is None:
        mine = shard.part(names)
        searched(source, search, mine, settings, keep=True)
        return BuiltShard("searched", FinishedShard(settings.out, len(mine), len(names)))
    jobs = prepared.chosen.jobs
    return _drawn(source, prepared.plan, shard.part(jobs), len(jobs), prepared.files, settings)


def draw_frozen_shard(
    source: DataSet, split: NamedSplit, settings: BuildSettings, shard: Shard, *, as_split: str = "adv"
) -> BuiltShard:
    """Draw a share of a frozen split; `generation.splits.building.build_frozen` does what is left.

    Arguments and errors as there; a shard is every n-th scene.
    """
    plan, chosen, report = ready_to_rebuild(source, split, settings, as_split)
    jobs, _, _ = frozen_jobs(source, plan, shard.part(chosen), split)
    return _drawn(source, plan, jobs, len(chosen), said_of_frozen(report), settings)


def _drawn(
    source: DataSet,
    plan: DataSetPlan,
    mine: Sequence[WritingJob],
    count: int,
    files: dict[str, bytes],
    settings: BuildSettings,
) -> BuiltShard:
    # Before anything is written: it would make the root of somebody else look like one of ours.
    for variant in sorted({job.variant for job in mine}):
        require_own_root(plan, variant)
    unfinish_others(plan.root, files)
    write_scenes(plan, mine, source.scene, settings.where_rendered, timing=settings.timing / "rendering")
    return BuiltShard("drawn", FinishedShard(plan.root, len(mine), count))


def _all_searched(
    source: DataSet, split: str, search: Search, names: Sequence[str], settings: BuildSettings
) -> Selected | None:
    """Choice of the search, if every attempt is kept."""
    try:
        return selected(source, split, search, names, replace(settings, executor=_NothingLeft()), keep=False)
    except _SomethingLeft:
        return None


class _SomethingLeft(Exception):
    """An attempt is not kept."""


@dataclass(frozen=True, slots=True)
class _NothingLeft:
    """Stands where attempts are computed, to find out whether all of them are kept."""

    def map(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: Count | None = None,
    ) -> Iterator[Result]:
        """Nothing; raises `_SomethingLeft` if there is an item."""
        for _ in items:
            raise _SomethingLeft
        return iter(())
