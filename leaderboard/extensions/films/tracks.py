"""Plans of each planner in one scene, sample by sample, with their verdicts."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.records.planner_versions import label_versions
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord, resolve_protocol
from benchmark.records.scene_pages import ScenePage
from benchmark.report.cells import UNDEFINED
from benchmark.report.overlays import CollisionParty, PlanOverlay, build_plan_overlay
from benchmark.report.palette import PlannerStyle, choose_planner_style
from benchmark.report.placement import frame_seconds
from benchmark.report.words import format_split


@dataclass(frozen=True, slots=True)
class SampleTally:
    """Counted samples of a planner, and how many collide, by whom they touch first; none is left out."""

    counted: int
    touches: Mapping[CollisionParty, int]

    def words(self, *, adversaries: bool) -> str:
        """``3 of 14 hit it, 2 another``: the latter with `adversaries`; a dash where the record names no one."""
        if not adversaries:
            return f"{self.touches.get(CollisionParty.ANYBODY, 0)} of {self.counted} collide"
        if self.touches.get(CollisionParty.UNKNOWN):
            return f"{UNDEFINED} of {self.counted} hit it"
        others = self.touches.get(CollisionParty.OTHER, 0)
        return f"{self.touches.get(CollisionParty.ADVERSARY, 0)} of {self.counted} hit it, {others} another"


@dataclass(frozen=True, slots=True)
class PlannerTrack:
    """Plans of one planner in one scene by frame, with (T,) times of frames; a `miniature` ranks nothing."""

    name: str
    style: PlannerStyle
    protocol: str
    miniature: bool
    plans: Mapping[int, PlanOverlay]
    seconds: Floats

    def at(self, frame: int) -> PlanOverlay | None:
        """Its last plan, or ``None`` before the first one."""
        past = [planned_frame for planned_frame in self.plans if planned_frame <= frame]
        if not past:
            return None
        last = max(past)
        return replace(self.plans[last], age_s=float(self.seconds[frame] - self.seconds[last]))

    def tally_until(self, frame: int) -> SampleTally:
        """Tally of the samples up to a frame."""
        counted = [
            plan.verdict
            for planned_frame, plan in self.plans.items()
            if planned_frame <= frame and plan.verdict.counted
        ]
        return SampleTally(len(counted), Counter(verdict.whom for verdict in counted if verdict.collides))


def build_planner_tracks(
    sheet: ScenePage, records: Sequence[RunRecord], models: Sequence[str], protocol: str
) -> tuple[PlannerTrack, ...]:
    """Tracks of planners in a scene, in the order in which they are named; ``native`` judges each by its own protocol.

    Other modes and forecasts are drawn of the first one only: those of several planners cannot be told apart. Refused
    is a planner without a record of the scene, with several, or with one of other data than the sheet.
    """
    tracks = []
    for place, name in enumerate(dict.fromkeys(models)):
        record = _find_record(sheet, records, name)
        judge = resolve_protocol(record, protocol)
        rows = {row.sample_token: row for row in record.rows if row.scene == sheet.scene}
        style = choose_planner_style(place)
        plans = {
            frame: replace(build_plan_overlay(sheet, frame, rows[token], judge, name, style), details=place == 0)
            for frame, token in zip(sheet.keyframes, sheet.sample_tokens)
            if token in rows
        }
        _require_same_samples(sheet, record, rows)
        tracks.append(
            PlannerTrack(name, style, judge, record.run.planner.miniature, plans, np.asarray(frame_seconds(sheet)))
        )
    return tuple(tracks)


def _find_record(sheet: ScenePage, records: Sequence[RunRecord], name: str) -> RunRecord:
    here = [record for record in records if (record.run.data.name, record.run.split) == (sheet.data.name, sheet.split)]
    known = [record for record in label_versions(here) if sheet.scene in record.run.scenes]
    candidates = [record for record in known if record.planner == name] or [
        record for record in known if record.run.planner.name == name
    ]
    # A run of the whole split takes precedence over runs of some of its scenes.
    preferred = [record for record in candidates if record.covers_split] or candidates
    if not preferred:
        there = f"; there are {', '.join(sorted({record.planner for record in known}))}" if known else ""
        raise InputError(
            f"no run record of {name} has scene {sheet.scene} of {format_split(sheet.split, sheet.data.name)}{there}; "
            f"run challenger-bench eval --split {sheet.split} --model {name} for that data set"
        )
    if len(preferred) > 1:
        raise InputError(
            f"{name} ran {len(preferred)} times on {format_split(sheet.split, sheet.data.name)} "
            f"({', '.join(str(record.directory) for record in preferred)}); name one of "
            f"{', '.join(e.planner for e in preferred)} with --model, or the folder of one run with --records"
        )
    return preferred[0]


def _require_same_samples(sheet: ScenePage, record: RunRecord, rows: Mapping[str, SampleRow]) -> None:
    same = record.run.data.fingerprint == sheet.data.fingerprint
    if not same or not set(rows) <= set(sheet.sample_tokens):
        raise InputError(
            f"{record.directory} ran on other content than the sheet of {sheet.scene} shows (the data fingerprints or "
            f"samples differ); run challenger-bench sheets and challenger-bench eval again for split {sheet.split}"
        )
