"""Everything that a leaderboard shows, read once: the runs of each data set, and records of all other kinds."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmark.errors import InputError
from benchmark.records.ablation import AblationReport
from benchmark.records.challenge import ChallengeScores
from benchmark.records.drives import DriveRecord
from benchmark.records.quality import QualityRecord
from benchmark.records.run import RunRecord
from benchmark.records.scene_pages import NO_SCENE_PAGES, ScenePages
from leaderboard.frame.runs import DataSetRuns
from leaderboard.results import select_runs


@dataclass(frozen=True, slots=True)
class LeaderboardResults:
    """Results that a leaderboard is made from; `frames` have at most one run for each planner and split.

    `abilities` are an extension's, whose ``list_scene_facts`` has a term and words for pages of scenes.
    """

    frames: tuple[DataSetRuns, ...]
    drives: Sequence[DriveRecord] = ()
    quality: Sequence[QualityRecord] = ()
    sheets: ScenePages = field(default_factory=lambda: NO_SCENE_PAGES)
    ablations: Sequence[AblationReport] = ()
    challenges: Sequence[ChallengeScores] = ()
    abilities: Sequence[Any] = ()

    @property
    def runs(self) -> list[RunRecord]:
        """Run records that stand in tables."""
        return [record for frame in self.frames for record in frame.given]


def build_frames(records: Sequence[RunRecord]) -> tuple[DataSetRuns, ...]:
    """A frame of each data set, by its name, of the records that `select_runs` keeps.

    Two records of one planner and split that would share a row, or records of one split on different data, are an
    `InputError`.
    """
    if not records:
        raise InputError("there are no run records for tables; run challenger-bench eval first")
    chosen = select_runs(records)
    names = sorted({record.run.data.name for record in chosen})
    return tuple(DataSetRuns(name, [run for run in chosen if run.run.data.name == name], chosen) for name in names)


def read_results(
    records: Sequence[RunRecord],
    quality: Sequence[QualityRecord] = (),
    sheets: ScenePages = NO_SCENE_PAGES,
    ablations: Sequence[AblationReport] = (),
    drives: Sequence[DriveRecord] = (),
    challenges: Sequence[ChallengeScores] = (),
    abilities: Sequence[Any] = (),
) -> LeaderboardResults:
    """Results of records of every kind; run records may be missing only if there is anything else."""
    others = bool(quality or sheets.splits or ablations or drives or challenges)
    frames = build_frames(records) if records or not others else ()
    return LeaderboardResults(frames, drives, quality, sheets, ablations, challenges, abilities)
