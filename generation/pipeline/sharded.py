"""A build in shards, for whoever has job arrays and no cluster: each searches its recordings, later draws its scenes.

An attempt, and a drawn scene, is kept in a file of its own that is named by its content. The build that comes last
finds all of them, so it has the bytes of one that was never cut.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeVar, cast

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.progress import Count
from benchmark.machine.storage import only_writer
from benchmark.runs.kept_shards import (
    DRAWING,
    SEARCH,
    Division,
    FinishedShard,
    division_of,
    note_done,
    require_undivided,
)
from benchmark.runs.shards import Shard, shard_folder
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import require_own_root
from generation.pipeline.settings import BuildSettings
from generation.pipeline.shard_notes import drawing_folder, drawing_work, search_folder, search_work, work_of_jobs
from generation.pipeline.split import originals, ready_to_build, search_of, searched, selected
from generation.pipeline.writing import WritingJob, unfinish_others, write_scenes
from generation.search.definition import Search, Unit
from generation.splits.building import frozen_jobs, ready_to_rebuild, said_of_frozen
from generation.splits.packaged import NamedSplit

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class BuiltShard:
    """What a shard of a build did.

    Attributes:
        did: ``searched`` its recorded scenes, or ``drawn`` its scenes of the new data set.
        finished: How many of how many.
    """

    did: Literal["searched", "drawn"]
    finished: FinishedShard


def build_shard(source: DataSet, split: str, settings: BuildSettings, shard: Shard) -> BuiltShard:
    """Do a share of a build: search, or draw once the shards of the search are all done; no tables are written.

    `generation.pipeline.split.build_split` with the same settings finishes, and names a shard that is missing.

    Args:
        source: Recorded scenes.
        split: As of `build_split`.
        settings: As of `build_split`, without a surrogate: it judges all scenes together.
        shard: Which share: every n-th recorded scene with all that is searched in it, every n-th scene that is drawn.

    Returns:
        What was done.

    Raises:
        InputError: As of `build_split`; if there is a surrogate, another command does the same shard, shards are of
            another division, or the work of another shard is gone, which is named.
    """
    if settings.surrogate is not None:
        raise InputError(
            "a surrogate judges all scenes together; search in shards without --surrogate, and name it in the command "
            "that comes last, without --shard"
        )
    names = ready_to_build(source, split, settings)
    if split == "val-r":
        plan, jobs, files = originals(source, names, settings)
        return _drawn(source, plan, jobs, files, settings, shard)
    search = search_of(source, names, settings)
    work = search_work(search, names, settings)
    division = _searched(settings, work)
    if division is None or _left_to_search(source, search, names, settings, shard, division):
        return _search(source, search, names, settings, shard, work)
    nobody = _NothingLeft(partial(_gone, settings, names, division.of))
    made = selected(source, split, search, names, replace(settings, executor=nobody), keep=False)
    return _drawn(source, made.plan, made.chosen.jobs, made.files, settings, shard)


def draw_frozen_shard(
    source: DataSet, split: NamedSplit, settings: BuildSettings, shard: Shard, *, as_split: str = "adv"
) -> BuiltShard:
    """Draw a share of a frozen split; `generation.splits.building.build_frozen` finishes.

    Args:
        source: The recordings.
        split: The frozen split.
        settings: As of `build_frozen`.
        shard: Which share: every n-th scene.
        as_split: As of `build_frozen`.

    Returns:
        What was done.

    Raises:
        InputError: As of `build_frozen`, and as of `build_shard`.
    """
    plan, chosen, report = ready_to_rebuild(source, split, settings, as_split)
    jobs, _, _ = frozen_jobs(source, plan, shard.part(chosen), split)
    scenes = [[frozen.name, variant] for frozen, variant in chosen]
    work = drawing_work(source, plan, scenes, chosen[0][0].source)
    return _draw(source, plan, jobs, len(chosen), said_of_frozen(report), settings, shard, work)


def _searched(settings: BuildSettings, work: str) -> Division | None:
    """The shards of this very search, if all of them are done."""
    try:
        division = division_of(search_folder(settings.out), SEARCH, work)
    except InputError:
        # Of other options, or damaged: shards of this search are to come, and write their notes anew.
        return None
    return None if division is None or division.missing else division


def _left_to_search(
    source: DataSet,
    search: Search,
    names: Sequence[str],
    settings: BuildSettings,
    shard: Shard,
    division: Division,
) -> bool:
    """Whether something of a shard's own search is gone although it was done."""
    if shard.of != division.of:
        return False

    def gone(scene: str) -> InputError:
        return _GoneError(scene)

    try:
        searched(source, search, shard.part(names), replace(settings, executor=_NothingLeft(gone)), keep=False)
    except _GoneError:
        return True
    return False


def _search(
    source: DataSet, search: Search, names: Sequence[str], settings: BuildSettings, shard: Shard, work: str
) -> BuiltShard:
    folder, mine = search_folder(settings.out), shard.part(names)
    require_undivided(folder, SEARCH, shard)
    with only_writer(shard_folder(folder, shard)):
        searched(source, search, mine, settings, keep=True)
        note_done(folder, SEARCH, shard, mine, work)
    return BuiltShard("searched", FinishedShard(settings.out, len(mine), len(names)))


def _drawn(
    source: DataSet,
    plan: DataSetPlan,
    jobs: Sequence[WritingJob],
    files: dict[str, bytes],
    settings: BuildSettings,
    shard: Shard,
) -> BuiltShard:
    work = work_of_jobs(source, plan, jobs)
    return _draw(source, plan, shard.part(jobs), len(jobs), files, settings, shard, work)


def _draw(
    source: DataSet,
    plan: DataSetPlan,
    mine: Sequence[WritingJob],
    count: int,
    files: dict[str, bytes],
    settings: BuildSettings,
    shard: Shard,
    work: str,
) -> BuiltShard:
    folder = drawing_folder(plan.root)
    require_undivided(folder, DRAWING, shard)
    # Before the first note: it would make the root of somebody else look like one of ours.
    for variant in sorted({job.variant for job in mine}):
        require_own_root(plan, variant)
    with only_writer(shard_folder(folder, shard)):
        unfinish_others(plan.root, files)
        write_scenes(plan, mine, source.scene, settings.where_rendered, timing=settings.timing / "rendering")
        note_done(folder, DRAWING, shard, [job.name for job in mine], work)
    return BuiltShard("drawn", FinishedShard(plan.root, len(mine), count))


class _GoneError(InputError):
    """An attempt that was kept is not there any more."""


def _gone(settings: BuildSettings, names: Sequence[str], of: int, scene: str) -> InputError:
    number = names.index(scene) % of + 1
    return InputError(
        f"{settings.out}: attempts in {scene} are missing or damaged, which shard {number}/{of} searched; run the same "
        f"generate command with --shard {number}/{of} again"
    )


@dataclass(frozen=True, slots=True)
class _NothingLeft:
    """Stands where attempts are computed, when all of them have been.

    Attributes:
        gone: The error of an attempt that is not there, by name of its recorded scene.
    """

    gone: Callable[[str], InputError]

    def map(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: Count | None = None,
    ) -> Iterator[Result]:
        """Nothing; raises `InputError` if there is an item: the scene and unit of an attempt."""
        for item in items:
            _, unit = cast("Sequence[tuple[Scene, Unit]]", item)[0]
            raise self.gone(unit.scene_name)
        return iter(())
