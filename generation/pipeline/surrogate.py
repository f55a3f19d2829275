"""A planner in the loop: keep only the scenes in which it collides (appendix "Attack Transferability").

The survivors are written as a data set of their own below the output and evaluated like any other; those that the
planner fails are taken over from there, pictures included.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import write_bytes, writing_to
from benchmark.metrics.effect import find_attributed_collisions
from benchmark.metrics.transfer import find_adversary_failures
from benchmark.records.run import RunRecord
from benchmark.report.words import pluralise
from benchmark.runs.units import FAILURES_FILE, find_first_failure
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.plan import STATE_FOLDER
from generation.nuscenes_writer.scenes import claim_files, read_stored_fragment

if TYPE_CHECKING:
    from benchmark.runs.plan_rows import PlannerFactory

PROTOCOL = "exact"
"""Protocol that defines a collision."""


@dataclass(frozen=True, slots=True)
class PlannerUnderTest:
    """A planner that judges generated scenes, drawn if it looks at images; no result depends on ``workers``."""

    factory: "PlannerFactory"
    images: bool = True
    workers: int = 1


@dataclass(frozen=True, slots=True)
class SurrogateResult:
    """Judgement of a planner on generated scenes.

    ``failed`` scenes, by their names in the evaluated data set, are those in which it touches the adversary first in at
    least one sample; ``colliding_samples`` are those whose first contact within 3 s is with the adversary.
    """

    planner: str
    failed: frozenset[str]
    scenes: int
    samples: int
    colliding_samples: int
    record: Path

    def as_json(self, root: Path) -> dict[str, Any]:
        """The judgement as JSON values, the record's place relative to the root of the build."""
        return {
            "planner": self.planner,
            "protocol": PROTOCOL,
            "scenes": self.scenes,
            "scenes_failed": len(self.failed),
            "samples": self.samples,
            "colliding_samples": self.colliding_samples,
            "record": self.record.relative_to(root).as_posix(),
        }


def build_staging_plan(plan: DataSetPlan, planner: PlannerUnderTest) -> DataSetPlan:
    """The data set that a planner is judged on: as the final one, but hidden below it; with images if it looks."""
    renderer = plan.renderer if planner.images else None
    return replace(plan, root=plan.root / STATE_FOLDER / "surrogate" / "data", renderer=renderer)


def evaluate_surrogate(
    plan: DataSetPlan, keys: Sequence[str], planner: PlannerUnderTest, runs: Path, *, name: str, seed: int
) -> SurrogateResult:
    """Finish a data set of written scenes and run a planner on it, which is refused if it fails on any sample."""
    finish_data_set(plan, keys)
    data = open_data(plan.root, version=plan.version, name=name)
    settings = EvalSettings(protocols=(PROTOCOL,), workers=planner.workers, seed=seed)
    return read_surrogate_result(evaluate(data, plan.split, planner.factory, runs, settings))


def read_surrogate_result(record: RunRecord) -> SurrogateResult:
    """The judgement that a run record holds."""
    require_all_planned(record)
    verdicts = find_adversary_failures(record)
    return SurrogateResult(
        planner=record.planner,
        failed=frozenset(scene for scene, failed in verdicts.items() if failed),
        scenes=len(verdicts),
        samples=int(record.columns.counted(PROTOCOL).sum()),
        colliding_samples=int(find_attributed_collisions(record).sum()),
        record=record.directory,
    )


def require_all_planned(record: RunRecord) -> None:
    """Refuse a run in which the planner raised: a sample without a plan is neither a collision nor none."""
    if record.summary.failed:
        raise InputError(
            f"{record.planner} raised on {record.summary.failed} of {pluralise(record.summary.samples, 'sample')}, so "
            f"it is unknown which scenes it passes; the first: {find_first_failure(record.rows)}; all tracebacks are "
            f"in {record.directory / FAILURES_FILE}; fix the planner, or render images if it needs them, then run the "
            "same command again"
        )


def reuse_scenes(staging: DataSetPlan, plan: DataSetPlan, keys: Sequence[str]) -> None:
    """Put finished scenes into another data set; `write_scene` then renames them and has nothing to draw."""
    for key in keys:
        fragment = read_stored_fragment(staging, key)
        if fragment is None or read_stored_fragment(plan, key) is not None:
            continue
        claim_files(plan, fragment["key"], fragment["variant"], fragment["name"], fragment["files"])
        source, target = staging.data_root(fragment["variant"]), plan.data_root(fragment["variant"])
        for path in fragment["files"]:
            _link(source / path, target / path)
        write_bytes(plan.map_path(fragment["map"]), staging.map_path(fragment["map"]).read_bytes())
        plan.fragments.put(key, fragment)


def _link(source: Path, target: Path) -> None:
    """The same file in two places; a copy where the disk has no links."""
    if target.exists() and target.samefile(source):
        return
    temporary = target.with_name(f".{target.name}.part")
    with writing_to(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.unlink(missing_ok=True)
            temporary.hardlink_to(source)
        except OSError:
            write_bytes(target, source.read_bytes(), durable=False)
            return
        temporary.replace(target)
