"""An evaluation in shards, for whoever has job arrays and no cluster: each plans its scenes, `merge` judges them all.

The plans of a scene are kept under a content key, as by any evaluation; a merged run is an evaluation that finds all
plans, so it has the bytes of one that was never cut.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate_together, runs_of
from benchmark.machine.progress import Count, progress
from benchmark.machine.storage import only_writer
from benchmark.machine.workers import single_threaded
from benchmark.planning import Observation, Plan, Planner, SceneInfo, remembers_across_scenes
from benchmark.records.planner_cost import SceneCost, cost_path, gather_costs, note_cost, shard_cost_path
from benchmark.records.planner_versions import PLANS_SHA256
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.plan_rows import PlannerFactory, kept_rows, plan_scene, rows_path, scene_key
from benchmark.runs.shards import Shard, ShardFacts, forget_shards, shard_folder, sharded_runs, whole_run, write_shard

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class PlannedShard:
    """What a shard did.

    Attributes:
        directory: Run directory.
        planned: How many scenes it planned or found planned.
        scenes: How many the whole run has.
    """

    directory: Path
    planned: int
    scenes: int


def plan_shard(
    data: "DataSet",
    split: str,
    planners: Sequence[tuple[Planner | PlannerFactory, EvalSettings]],
    out: Path,
    shard: Shard,
) -> list[PlannedShard]:
    """Plan the scenes of one shard, in this process; nothing is judged and no record is written.

    Args:
        data: The data set.
        split: Which of its splits.
        planners: Planners, or factories, each with its settings.
        out: Folder of run directories.
        shard: Which scenes.

    Returns:
        What was done, for each planner.

    Raises:
        InputError: As of `benchmark.evaluation.evaluate`; for planners that remember across scenes; if another command
            plans the same shard.
    """
    single_threaded()
    found = []
    for run, ready, factory, settings, scenes in runs_of(data, split, planners, out):
        if remembers_across_scenes(ready):
            raise InputError(
                f"{ready.name} remembers across scenes, so that the whole split is planned in one process; leave "
                "--shard out"
            )
        mine = shard.part(scenes)
        with only_writer(shard_folder(run.directory, shard)):
            label = f"{run.planner.name} on {split}, shard {shard}"
            costs: dict[str, SceneCost | None] = {}
            for scene in progress(mine, total=len(mine), label=label, count=Count()):
                key = scene_key(run.fingerprint, split, scene, run.planner)
                planned = plan_scene(ready, data, scene, rows_path(run.directory, scene), key, fresh=settings.fresh)
                costs[scene] = planned.cost
            if settings.timings is not None and PLANS_SHA256 not in run.planner.settings:
                whole = cost_path(settings.timings, out, run.directory)
                note_cost(shard_cost_path(whole, shard.number, shard.of), run.planner, costs)
            write_shard(
                run.directory,
                ShardFacts(
                    number=shard.number,
                    of=shard.of,
                    planned=list(mine),
                    planner=run.planner,
                    data=data.name,
                    fingerprint=run.fingerprint,
                    split=split,
                    scenes=list(scenes),
                    protocols=list(settings.protocols),
                    seed=settings.seed,
                    plans_from=_as_json(getattr(factory, "plans_from", None)),
                ),
            )
        found.append(PlannedShard(run.directory, len(mine), len(scenes)))
    return found


def merge_shards(
    root: Path,
    open_split: Callable[[str], "DataSet"],
    data_name: str,
    *,
    workers: int = 1,
    timings: Path | None = None,
) -> Iterator[RunRecord]:
    """Judge the runs below a folder that were planned in shards, and write their records; no planner runs.

    Args:
        root: Where to look.
        open_split: Opens the data set that holds a split.
        data_name: Name of the data set; runs on others are left alone.
        workers: Number of processes that judge.
        timings: Folder in which the shards noted what their planner cost, if they did.

    Yields:
        Records, the same as of evaluations that were never cut, by path.

    Raises:
        InputError: If there is nothing to merge, a shard is missing or not of the same run, its plans are damaged, or
            the data set is another.
    """
    runs = [(directory, facts) for directory in sharded_runs(root) if (facts := whole_run(directory, data_name))]
    if not runs:
        raise InputError(
            f"no shards of runs on {data_name} are below {root}; plan some with: challenger-bench eval --shard 1/2, or "
            "name the data set that they ran on with --data"
        )
    for directory, facts in runs:
        data = open_split(facts.split)
        _require_plans(directory, facts, data)
        settings = EvalSettings(tuple(facts.protocols), tuple(facts.scenes), None, workers, facts.seed)
        whole = replace(settings, scenes=None) if facts.scenes == list(data.scene_names(facts.split)) else settings
        kept = KeptPlans(facts.planner, facts.plans_from)
        # Frozen attributes are no writable ones, as the protocol of planners has them; nobody writes to either.
        factory = cast("PlannerFactory", kept)
        if timings is not None:
            gather_costs(cost_path(timings, _root_of(directory), directory), facts.planner, facts.of)
        yield from evaluate_together(data, facts.split, [(factory, whole)], _root_of(directory))
        forget_shards(directory)


def _require_plans(directory: Path, facts: ShardFacts, data: "DataSet") -> None:
    if facts.fingerprint != data.fingerprint():
        raise InputError(
            f"the shards in {directory} ran on other content of {facts.data} than {data.root} holds (the data "
            "fingerprints differ); open the data set that they ran on with --data, or run them again"
        )
    for place, scene in enumerate(facts.scenes):
        key = scene_key(facts.fingerprint, facts.split, scene, facts.planner)
        if kept_rows(rows_path(directory, scene), key) is None:
            shard = f"{place % facts.of + 1}/{facts.of}"
            raise InputError(
                f"{directory}: the plans of {scene} are missing or damaged, which shard {shard} makes; run the same "
                f"eval command with --shard {shard} again"
            )


def _root_of(directory: Path) -> Path:
    """Folder of run directories: data set, split and planner are below it."""
    return directory.parents[2]


def _as_json(plans_from: Any) -> dict[str, Any] | None:
    if plans_from is None:
        return None
    return dict(plans_from.model_dump(mode="json") if hasattr(plans_from, "model_dump") else plans_from)


@dataclass(frozen=True, slots=True)
class KeptPlans:
    """Stands where a planner's factory stands, for a run of which all plans are there.

    Attributes:
        facts: Who planned.
        plans_from: Of plans from a file, where they come from.
    """

    facts: PlannerFacts
    plans_from: dict[str, Any] | None

    def __call__(self) -> "NobodyPlans":
        """The planner that is never asked."""
        return NobodyPlans(self.facts.name)


@dataclass(frozen=True, slots=True)
class NobodyPlans:
    """A planner that is never asked.

    Attributes:
        name: Name of the planner that was.
    """

    name: str

    def reset(self, scene: SceneInfo) -> None:
        """Plans that vanish between the check and their use end the command."""
        raise InputError(f"the plans of {scene.name} were removed while they were merged; run the shards again")

    def plan(self, observation: Observation) -> Plan:
        """Never asked, because `reset` comes first."""
        raise InputError(f"the plans of {observation.scene} were removed while they were merged; run the shards again")
