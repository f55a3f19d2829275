"""Is a stranger's folder of run records fit for a leaderboard: everything it claims, computed again from its plans.

A record holds the plans, so nothing in it has to be believed: hashes, coverage and samples are compared with the data
set, every plan is judged anew, and the rates are summed up anew. What cannot be checked from outside, that the named
model made the plans from the images, is said as what it is: `Level.NOTE`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.errors import InputError
from benchmark.pdm.definition import DEFINITION, VERSION
from benchmark.protocols import PROTOCOLS
from benchmark.records.row_schema import OutcomeRow, SampleRow
from benchmark.records.run import RunRecord, load_record, summarise
from benchmark.records.run_schema import DrivingSummary, ProtocolSummary, SceneFacts
from benchmark.report.words import counted
from benchmark.runs.judging import plan_of
from benchmark.runs.rescoring import judged_anew, record_directories, require_same_data

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

SAME_M = 0.05
"""Plans that are nowhere farther than this from the recorded future were not made without seeing it. Where a plan is of
the rear axle, turning it into one of the lidar costs some of it."""
SAME_M_S = 0.01
"""Speeds that are this close are the same: processors differ in the last bits of a fit."""
_LATER = frozenset({"recorded_adversary", "recorded", "before_mask", "left_out"})
"""Columns and facts of verdicts that records of the same protocol version need not have yet."""
MOVES_M = 1.0
"""A recording that never goes farther than this says nothing about it: whoever stands still is right."""


class Level(StrEnum):
    """What a finding means: an error keeps a record out, a note is for the reader."""

    ERROR = "error"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a submission, or worth knowing.

    Attributes:
        directory: Of the record, or of the submission.
        level: Whether it keeps the record out.
        sentence: What, and what to do.
    """

    directory: Path
    level: Level
    sentence: str

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"directory": str(self.directory)}


def check_submission(
    folder: Path, data_name: str, open_split: Callable[[str], "DataSet"]
) -> tuple[list[RunRecord], list[Finding]]:
    """Check every record below a folder; one that is bad does not stop the others. Nothing is written.

    Args:
        folder: The submission.
        data_name: Name of the data set that records must be of.
        open_split: Opens the data set that holds a split; asked once for each split.

    Returns:
        Records without an error, and all findings by record.

    Raises:
        InputError: If there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; name the one that holds the submitted run records")
    directories = record_directories(folder)
    if not directories:
        return [], [
            Finding(folder, Level.ERROR, "holds no run record (run.json, samples.jsonl, summary.json); submit what "
                    "challenger-bench eval writes below OUT/runs")
        ]  # fmt: skip
    opened: dict[str, DataSet] = {}
    sound: list[RunRecord] = []
    findings: list[Finding] = []
    for directory in directories:
        found: list[Finding] = []
        try:
            record = load_record(directory)
            found += [Finding(directory, level, says) for level, says in _claims(record, data_name)]
            if record.run.data.name == data_name:
                if record.run.split not in opened:
                    opened[record.run.split] = open_split(record.run.split)
                data = opened[record.run.split]
                found += [Finding(directory, level, says) for level, says in _computed_anew(record, data)]
        except InputError as error:
            findings += [*found, Finding(directory, Level.ERROR, str(error))]
            continue
        findings += found
        if all(finding.level is not Level.ERROR for finding in found):
            sound.append(record)
    return sound, [*findings, *_twice(sound)]


def _claims(record: RunRecord, data_name: str) -> Iterator[tuple[Level, str]]:
    """What a record says of itself, without the data set."""
    run = record.run
    if run.data.name != data_name:
        yield Level.ERROR, f"is of the data set {run.data.name}, not {data_name}; open that one with --data"
    if not record.covers_split:
        yield (
            Level.ERROR,
            f"ran on {len(run.scenes)} of {counted(run.scenes_in_split, 'scene')} of {run.split}; run eval "
            "without --scenes and "
            "--limit",
        )
    if not record.complete:
        yield (
            Level.ERROR,
            f"has no plan for {record.summary.failed} of {counted(record.summary.samples, 'sample')}; the "
            "errors are in "
            "samples.jsonl",
        )
    unknown = sorted(set(run.protocols) - set(PROTOCOLS))
    if unknown:
        yield Level.ERROR, f"is judged by {', '.join(unknown)}, which this version does not know; run rescore"
    if record.stale_protocols:
        yield Level.ERROR, f"is judged by other versions of {', '.join(record.stale_protocols)}; run rescore"
    if record.missing_protocols:
        yield Level.ERROR, f"is not judged by {', '.join(record.missing_protocols)}; run rescore"
    if record.summary.driving is not None and record.summary.driving.version != VERSION:
        yield Level.ERROR, f"is judged by another version of {DEFINITION}; run rescore"
    if run.planner.weights_sha256 is None and run.planner.code_sha256 is None:
        yield Level.NOTE, "names neither weights nor code (plans from a file): nobody can tell which model planned"
    if run.planner.privileged:
        yield Level.NOTE, "is privileged: the planner saw boxes, the map or the recorded future, and tables say so"
    source = run.environment.get("source")
    if isinstance(source, dict) and source.get("dirty"):
        yield Level.NOTE, "was made with uncommitted changes to challenger-bench"


def _computed_anew(record: RunRecord, data: "DataSet") -> Iterator[tuple[Level, str]]:
    """Whether the data set and the plans give what the record says."""
    run = record.run
    require_same_data(record.directory, record.run, data)
    scenes = list(data.scene_names(run.split))
    if run.scenes_in_split != len(scenes) or (record.covers_split and sorted(run.scenes) != sorted(scenes)):
        yield (
            Level.ERROR,
            f"does not have the {counted(len(scenes), 'scene')} of {run.split} of {data.root}; run eval again",
        )
        return
    names = tuple(name for name in run.protocols if name in PROTOCOLS and name not in record.stale_protocols)
    anew = [row for scene in run.scenes for row in judged_anew(record, data, scene, names)]
    if len(anew) != len(record.rows):
        yield Level.ERROR, f"has {counted(len(record.rows), 'sample')}, its scenes have {len(anew)}; run eval again"
        return
    different = [row for row, computed in zip(record.rows, anew) if not _says_the_same(row, computed, names)]
    if different:
        first = different[0]
        yield (
            Level.ERROR,
            f"says other verdicts than its plans have on {len(different)} of {counted(len(anew), 'sample')}, "
            "first on sample "
            f"{first.sample_token} of {first.scene}; run challenger-bench rescore",
        )
    versions, facts = {name: run.protocols[name] for name in names}, data.scene_facts(run.scenes)
    if others := _other_facts(record, facts):
        yield Level.ERROR, f"says of {others[0]} what the data set does not say; run challenger-bench rescore"
    summary = summarise(anew, versions, seed=run.seed, scene_facts=facts)
    for name in names:
        claimed = record.summary.protocols.get(name)
        if claimed is None:
            yield Level.ERROR, f"has no rates under {name}; run challenger-bench rescore"
        elif claimed != _as_of(claimed, summary.protocols[name]):
            yield Level.ERROR, _other_rate(name, claimed, summary.protocols[name])
    yield from _driving_anew(record, anew, summary.driving)
    if not run.planner.privileged and _follows_the_recording(record.rows):
        yield (
            Level.NOTE,
            f"plans the recorded future itself (to {SAME_M} m, on every sample) and is not privileged: ask how",
        )


def _says_the_same(row: SampleRow, computed: SampleRow, protocols: Sequence[str]) -> bool:
    judged = {"outcomes", "disagreements", "driving", "place", "speed_m_s"}
    return (
        row.model_dump(exclude=judged) == computed.model_dump(exclude=judged)
        and _same_circumstances(row, computed)
        and all(_same_verdict(row.outcomes.get(name), computed.outcomes.get(name)) for name in protocols)
        and all(row.disagreements.get(name) == computed.disagreements.get(name) for name in protocols)
    )


def _same_circumstances(said: SampleRow, computed: SampleRow) -> bool:
    """Whether a row says the place and speed that the data have; an older one says neither."""
    if said.speed_m_s is None or computed.speed_m_s is None:
        return said.place is None or said.place == computed.place
    return said.place == computed.place and abs(said.speed_m_s - computed.speed_m_s) <= SAME_M_S


def _other_facts(record: RunRecord, found: Mapping[str, SceneFacts]) -> list[str]:
    """Scenes of which a record says something else than the data set; what either does not say is no fault."""

    def other(facts: SceneFacts, here: SceneFacts) -> bool:
        # Whether somebody judged a scene is no content of a data set, and who did not cannot contradict.
        asked = ((said, value) for said, value in facts if said != "judgement" or here.judgement is not None)
        return any(value is not None and value != getattr(here, said) for said, value in asked)

    return [name for name, facts in record.run.scene_facts.items() if name in found and other(facts, found[name])]


def _same_verdict(said: OutcomeRow | None, computed: OutcomeRow | None) -> bool:
    """Whether two verdicts are equal; a record that was written before a column was kept cannot have it."""
    if said is None or computed is None:
        return said is computed
    steps = {name: column for name, column in computed.steps.items() if name in said.steps or name not in _LATER}
    facts = {name: fact for name, fact in computed.facts.items() if name in said.facts or name not in _LATER}
    return said == computed.model_copy(update={"steps": steps, "facts": facts})


def _as_of(claimed: ProtocolSummary, found: ProtocolSummary) -> ProtocolSummary:
    """What a record that has no count of masked steps, or none of adversaries' ones, could say."""
    counts = ("mask_removed_steps", "mask_removed_for_adversary")
    return found.model_copy(update={name: None for name in counts if getattr(claimed, name) is None})


def _driving_anew(
    record: RunRecord, anew: Sequence[SampleRow], found: DrivingSummary | None
) -> Iterator[tuple[Level, str]]:
    claimed = record.summary.driving
    if claimed is None and found is not None:
        yield Level.ERROR, "has no driving scores; run challenger-bench rescore"
    if claimed is None or claimed.version != VERSION:
        return
    different = [row for row, computed in zip(record.rows, anew) if row.driving != computed.driving]
    first = f", first on sample {different[0].sample_token} of {different[0].scene}" if different else ""
    if different or claimed != found:
        yield Level.ERROR, f"claims other driving scores than its plans give{first}; run challenger-bench rescore"


def _other_rate(name: str, claimed: ProtocolSummary, found: ProtocolSummary) -> str:
    for column, by_horizon in found.columns.items():
        for horizon, rate in by_horizon.items():
            said = claimed.columns.get(column, {}).get(horizon)
            if said is None or said.value != rate.value:
                value = None if said is None else said.value
                return (
                    f"claims {column} {horizon} = {value} under {name}, and its plans give {rate.value}; run "
                    "challenger-bench rescore"
                )
    return f"claims other counts or intervals under {name} than its plans give; run challenger-bench rescore"


def _follows_the_recording(rows: Sequence[SampleRow]) -> bool:
    """Whether all plans of samples with a whole future are that future."""
    plans = [(plan_of(row.plan.model_dump()), row) for row in rows if row.plan is not None and row.complete]
    recorded = [np.array(row.recorded_future, float)[:, :2] for _, row in plans]
    if max((float(np.abs(future).max()) for future in recorded), default=0.0) < MOVES_M:
        return False
    planned = [plan.waypoints_in_lidar(row.lidar_ahead_m) for plan, row in plans]
    return max(float(np.abs(plan - future).max()) for plan, future in zip(planned, recorded)) < SAME_M


def _twice(records: Sequence[RunRecord]) -> Iterator[Finding]:
    """Two records that would be one row of a table."""
    seen: dict[tuple[Any, ...], Path] = {}
    for record in records:
        run = record.run
        key = (run.data.name, run.split, run.planner.model_dump_json(exclude={"published_as", "miniature"}))
        first = seen.setdefault(key, record.directory)
        if first != record.directory:
            yield Finding(
                record.directory,
                Level.ERROR,
                f"is the same planner on the same split as {first}; keep one of them",
            )
