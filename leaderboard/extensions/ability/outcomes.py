"""The cells of the matrix from records: all planners on one split, in open loop or in one world of closed loop."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmark.errors import InputError
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.effect import knows_contact_partners
from benchmark.metrics.ranks import average_drives_by_scene, sum_faults_by_scene
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.drives import DriveRecord, compute_column_values
from benchmark.records.planner_versions import compute_version_labels
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import PlannerFacts
from benchmark.report.words import format_split
from leaderboard.extensions.ability.matrix import OutcomeMatrix

Loop = Literal["open", "closed"]
Kind = Literal["contact", "score"]


@dataclass(frozen=True, slots=True)
class Measured:
    """What is estimated: outcomes of one kind, on one split, in one loop (`world` is the closed one's)."""

    data: str
    split: str
    loop: Loop
    kind: Kind
    world: str = ""

    @property
    def words(self) -> str:
        """In titles and sentences."""
        where = "open loop" if self.loop == "open" else f"closed loop, {self.world}"
        return f"{format_split(self.split, self.data)}, {self.kind}, {where}"


@dataclass(frozen=True, slots=True)
class PlannerOutcomes:
    """A planner's outcomes by scene (higher is better), of all of its records that belong together."""

    facts: PlannerFacts
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class GatheredOutcomes:
    """Outcomes of planners on the same content; `records` are content ids, sorted."""

    measured: Measured
    fingerprint: str
    planners: Mapping[str, PlannerOutcomes]
    source_of: Mapping[str, str]
    records: tuple[str, ...]

    @property
    def matrix(self) -> OutcomeMatrix:
        """Planners and scenes by name."""
        names = tuple(sorted(self.planners))
        scenes = tuple(sorted({scene for own in self.planners.values() for scene in own.values}))
        values = np.array([[self.planners[name].values.get(scene, np.nan) for scene in scenes] for name in names])
        recordings = tuple(self.source_of.get(scene, scene) for scene in scenes)
        return OutcomeMatrix(self.measured.kind, names, scenes, recordings, values.reshape(len(names), len(scenes)))


@dataclass(frozen=True, slots=True)
class _Part:
    """What one record adds."""

    measured: Measured
    content: tuple[str, str | None]
    facts: PlannerFacts
    values: Mapping[str, float]
    source_of: Mapping[str, str]
    record: str


def gather_outcomes(
    runs: Iterable[RunRecord], drives: Iterable[DriveRecord], kind: Kind, loop: Loop
) -> list[GatheredOutcomes]:
    """Outcomes of every split that has adversaries, by data set, split and world.

    A planner's records of parts of a split are put together; where two have a scene, that of more scenes counts.
    ``contact`` is 1 where the adversary is never touched at the planner's fault; ``score`` is the share of samples
    without that in open loop, nuPlan's terms in closed loop. Where a planner failed, the outcome is 0.

    Raises:
        InputError: If records of one split are of different content.
    """
    parts = [*_read_runs(runs, kind)] if loop == "open" else [*_read_drives(drives, kind)]
    gathered = []
    for measured in sorted({part.measured for part in parts}, key=lambda each: (each.data, each.split, each.world)):
        own = [part for part in parts if part.measured == measured]
        if len({part.content for part in own}) > 1:
            raise InputError(
                f"the records of {measured.words} are of different content or verdicts of inspectors; run the older "
                "ones again, or name folders with --records"
            )
        labels = compute_version_labels([(part.facts, measured.data, measured.split) for part in own])
        planners: dict[str, PlannerOutcomes] = {}
        source_of: dict[str, str] = {}
        for part, label in sorted(zip(own, labels), key=lambda pair: (len(pair[0].values), pair[0].record)):
            name = label or part.facts.name
            before = planners[name].values if name in planners else {}
            planners[name] = PlannerOutcomes(part.facts, {**before, **part.values})
            source_of |= part.source_of
        ids = tuple(sorted(part.record for part in own))
        gathered.append(GatheredOutcomes(measured, own[0].content[0], planners, source_of, ids))
    return gathered


def _read_runs(runs: Iterable[RunRecord], kind: Kind) -> Iterable[_Part]:
    for record in runs:
        if not (has_adversaries(record) and knows_contact_partners(record)):
            continue
        totals = sum_faults_by_scene(record)
        if totals is None:
            continue
        values = {
            scene: float(faults == 0.0) if kind == "contact" else 1.0 - faults / samples
            for scene, (faults, samples) in totals.items()
        }
        measured = Measured(record.run.data.name, record.run.split, "open", kind)
        sources = map_scenes_to_sources(record)
        yield _Part(measured, record.judged_content, record.run.planner, values, sources, record.content_id)


def _read_drives(drives: Iterable[DriveRecord], kind: Kind) -> Iterable[_Part]:
    for record in drives:
        facts = record.facts
        if facts.measured.engine != "default" or not any(of.adversaries for of in facts.scene_facts.values()):
            continue
        if kind == "contact":
            values = _find_safe_scenes(record)
        else:
            values = {scene: mean for scene, (mean, _) in average_drives_by_scene(record).items()}
        measured = Measured(facts.data.name, facts.split, "closed", kind, facts.measured.world)
        content = facts.data.fingerprint, None if facts.review is None else facts.review.content
        sources = {scene: of.source for scene, of in facts.scene_facts.items()}
        yield _Part(measured, content, facts.planner, values, sources, record.content_id)


def _find_safe_scenes(record: DriveRecord) -> dict[str, float]:
    """1 of a scene in none of whose drives the adversary was touched at fault, or the planner failed."""
    safe: dict[str, float] = {}
    for row in record.rows:
        if row.status == "failed":
            safe[row.scene] = 0.0
        elif (fault := compute_column_values(row).get("at_fault")) is not None:
            pursued = row.contact is not None and row.contact.adversary
            safe[row.scene] = min(safe.get(row.scene, 1.0), float(not (fault and pursued)))
    return safe


def choose_gathered(gathered: Sequence[GatheredOutcomes], data: str, split: str) -> GatheredOutcomes:
    """The one of a data set and split; `InputError` where there is none, or there are several worlds."""
    found = [each for each in gathered if (each.measured.data, each.measured.split) == (data, split)]
    if not found:
        known = "; ".join(each.measured.words for each in gathered) or "none with adversaries"
        raise InputError(
            f"there are no records of {format_split(split, data)} that say what planners did to adversaries; records "
            f"are there of: {known}; name these with --data and --split, or run challenger-bench eval first"
        )
    if len(found) > 1:
        raise InputError(
            f"{format_split(split, data)} was driven in several worlds ({', '.join(e.measured.world for e in found)}); "
            "name the folders of one with --records"
        )
    return found[0]
