"""Is a stranger's folder of records fit for a leaderboard: everything it claims, computed again from its plans.

A record holds the plans, so nothing in it has to be believed: hashes, coverage and samples are compared with the data
set, every plan is judged or driven anew, and every number is summed up anew. What cannot be checked from outside, that
the named model made the plans from the images, is said as what it is: the planner's identity is checked for planners of
this version, otherwise only declared. `benchmark.metrics.leaks` compares plans with the future that it must not see.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmark.closed_loop.simulation_config import interpolate_recorded_poses
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.scene_assessments import collect_realism
from benchmark.datasets.scene_facts import find_frozen_split
from benchmark.errors import InputError
from benchmark.extensions.submissions.recomputed import (
    FindingLevel,
    GradedSentence,
    SubmissionFinding,
    check_protocols,
    recompute_drives,
    recompute_run,
)
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.metrics.leaks import LeakFigures, LeakSample, compute_leak_figures
from benchmark.planning import Plan, PlanFrame
from benchmark.protocols import PROTOCOLS, find_protocol
from benchmark.records.attempts import read_generated_facts
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord, load_record
from benchmark.records.run_schema import PlannerFacts, RecordFacts, RunFacts, SceneFacts
from benchmark.records.store import DRIVE_FILE
from benchmark.report.words import pluralise
from benchmark.runs.judging import parse_plan
from benchmark.runs.rescoring import OpenedDataSets, find_record_directories, open_as_recorded
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from benchmark.untrusted.files import to_one_line

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_FORWARD: Final = np.array([0.0, 1.0])
"""Of the lidar's frame."""
NEAR_M: Final = 0.5
"""A driven car that is no farther from where the recorded one was then may be compared with its future."""
NEAR_RAD: Final = 0.17
"""The same of its heading."""
_PLANNED_US: Final = round(1e6 * PLAN_STEP_S) * np.arange(1, PLAN_STEPS + 1)
_BEFORE_US: Final = round(1e6 * PLAN_STEP_S) * np.array([-2, -1, 0])


def check_leaks(record: RunRecord | DriveRecord, data: "DataSet") -> Iterator[GradedSentence]:
    """Signs that plans knew the recorded future, one finding at most; none of privileged planners."""
    facts = record.run if isinstance(record, RunRecord) else record.facts
    if facts.planner.privileged:
        return
    if suspicions := compute_record_leaks(record, data).suspicions:
        yield (
            FindingLevel.SUSPICIOUS,
            f"{'; '.join(suspicions)}. This is no proof; ask the submitter how it plans "
            "(docs/extensions/submissions.md)",
        )


def compute_record_leaks(record: RunRecord | DriveRecord, data: "DataSet") -> LeakFigures:
    """Figures that compare the plans of a record with the recorded future."""
    if isinstance(record, DriveRecord):
        return compute_leak_figures(
            [moment for row in record.rows for moment in _build_drive_moments(row, data.scene(row.scene))]
        )
    scenes = groupby(record.rows, key=lambda row: row.scene)
    return compute_leak_figures(
        [moment for name, rows in scenes for moment in build_run_moments(list(rows), data.truth(name)).values()]
    )


def build_run_moments(rows: Sequence[SampleRow], truths: Sequence[SampleTruth]) -> dict[int, LeakSample]:
    """Moments of one scene of a run, by number: a plan, a recorded second before and 3 s after."""
    steps = [None if row.recorded_future[0] is None else np.array(row.recorded_future[0][:2], float) for row in rows]
    speeds: dict[int, tuple[float, float]] = {}
    for index, row in enumerate(rows):
        before, now = (steps[index - 2], steps[index - 1]) if index >= 2 else (None, None)
        # Speeds and plans are compared at steps of half a second.
        regular = all(truth.timed is None for truth in truths[max(index - 2, 0) : index + 1])
        if row.plan is not None and row.complete and before is not None and now is not None and regular:
            speeds[index] = (float(np.hypot(*before)) / PLAN_STEP_S, float(np.hypot(*now)) / PLAN_STEP_S)
    dangerous = _find_dangerous([truths[index] for index in speeds], [now for _, now in speeds.values()])
    moments = {}
    for (index, speed), danger in zip(speeds.items(), dangerous):
        row = rows[index]
        assert row.plan is not None, "chosen above"
        planned = parse_plan(row.plan.model_dump()).judged.waypoints_in_lidar(row.lidar_ahead_m)
        recorded = np.array(row.recorded_future, float)[:, :2]
        moments[index] = LeakSample(planned, recorded, _FORWARD, speed, bool(danger))
    return moments


def _find_dangerous(truths: Sequence[SampleTruth], speeds: Sequence[float]) -> Bools:
    """(N,) whether a car that keeps its speed and direction touches an object within 3 s."""
    if not truths:
        return np.zeros(0, bool)
    times = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    constant_speed_plans = np.array(speeds)[:, None, None] * times[:, None] * _FORWARD
    return np.asarray(find_protocol("exact").evaluate(truths, constant_speed_plans).collision.any(axis=1))


def _build_drive_moments(row: EpisodeRow, scene: Scene) -> list[LeakSample]:
    """Instants of a drive at which the car was where the recorded one was, long enough before the recording ends.

    None counts as dangerous: the actions of others in a drive depend on the drive.
    """
    moments = []
    times = np.array(row.ticks.time_us[row.primed :], np.int64)
    first, last = int(scene.timestamps_us[0]), int(scene.timestamps_us[-1])
    ahead_m = float(scene.lidar.translation[0])
    for time, state, plan in zip(times, row.ticks.ego[row.primed :], row.plans[row.primed :]):
        if time + _PLANNED_US[-1] > last or time + _BEFORE_US[0] < first:
            continue
        pose = np.array(state[:3])
        poses = interpolate_recorded_poses(scene, time + np.concatenate([_BEFORE_US, _PLANNED_US]))
        now = poses[len(_BEFORE_US) - 1]
        if np.hypot(*(pose - now)[:2]) > NEAR_M or abs(float(wrap_angle(pose[2] - now[2]))) > NEAR_RAD:
            continue
        before, speed = np.hypot(*np.diff(poses[: len(_BEFORE_US), :2], axis=0).T) / PLAN_STEP_S
        planned = Plan(np.array(plan.waypoints, np.float64), PlanFrame(plan.frame)).judged.waypoints_in_lidar(ahead_m)
        recorded = _compute_lidar_positions(poses[len(_BEFORE_US) :], pose, ahead_m)
        moments.append(LeakSample(planned, recorded, _FORWARD, (float(before), float(speed)), False))
    return moments


def _compute_lidar_positions(poses: Floats, seen_from: Floats, ahead_m: float) -> Floats:
    """(N, 2) the lidar's origin at poses of the rear axle, in the lidar's frame (x right, y forward) at one of them."""
    heading = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    local = to_local(poses[:, :2] + ahead_m * heading, seen_from)
    return np.stack([-local[:, 1], local[:, 0] - ahead_m], axis=1)


def check_claims(facts: RecordFacts, failed: int, units: int, unit: str, data_name: str) -> Iterator[GradedSentence]:
    """Findings that need no data set, for ``failed`` rows (no plan, or a failed drive) of ``units``."""
    if facts.data.name != data_name:
        yield (
            FindingLevel.ERROR,
            f"was run on the data set {to_one_line(facts.data.name, 80)}, not {data_name}; open that one with --data",
        )
    if failed:
        yield FindingLevel.ERROR, f"has no plan for {failed} of {pluralise(units, unit)}; the errors are in its rows"
    if (facts.status == "complete") != (failed == 0):
        yield FindingLevel.ERROR, f"claims to be {facts.status}, but {failed} of {pluralise(units, unit)} failed"


def check_split(facts: RecordFacts, data: "DataSet") -> Iterator[GradedSentence]:
    """Check that a record ran on the split that the data set has, and describes the data set as it describes itself."""
    scenes = list(data.scene_names(facts.split))
    if sorted(facts.scenes) != sorted(scenes):
        yield (
            FindingLevel.ERROR,
            f"ran on {len(set(facts.scenes) & set(scenes))} of {pluralise(len(scenes), 'scene')} of {facts.split}; "
            "run it without --scenes and --limit",
        )
    if facts.scenes_in_split != len(scenes):
        yield (
            FindingLevel.ERROR,
            f"says that {facts.split} has {pluralise(facts.scenes_in_split, 'scene')}, {data.root} has {len(scenes)}",
        )
    if others := _find_differing_scenes(facts, data.scene_facts(facts.scenes)):
        yield FindingLevel.ERROR, f"differs from the data set in its facts of {others[0]}; run challenger-bench rescore"
    provenance = data.provenance()
    pairs: list[tuple[str, object, object]] = [
        ("frozen split", facts.frozen_split, find_frozen_split(provenance)),
        ("search", facts.generated, read_generated_facts(provenance)),
    ]
    realism = collect_realism(data.root, data.version)
    if isinstance(facts, RunFacts) and realism is not None:
        pairs.append(("realism", facts.realism, realism))
    for name, claimed, here in pairs:
        # Older records lack these facts.
        if claimed is not None and claimed != here:
            yield FindingLevel.ERROR, f"differs from {data.root} in the scenes' {name}; run it again"


_COUNTED_ELSEWHERE: Final = ("judgement", "truth")


def _find_differing_scenes(facts: RecordFacts, scene_facts: Mapping[str, SceneFacts]) -> Sequence[str]:
    """Scenes whose facts differ between record and data set; a fact missing in either is no difference."""

    def other(claimed: SceneFacts, here: SceneFacts) -> bool:
        # Scenes need no assessment; their truth counts are checked where the plans are rescored.
        compared = ((name, value) for name, value in claimed if name not in _COUNTED_ELSEWHERE or getattr(here, name))
        return any(value is not None and value != getattr(here, name) for name, value in compared)

    return [
        name for name, claimed in facts.scene_facts.items() if name in scene_facts and other(claimed, scene_facts[name])
    ]


OwnPlannerLookup = Callable[[PlannerFacts], PlannerFacts | None]
"""The planner of this program that a submitted one is by its code, else the one that it is called like, else none."""
_SHA256: Final = re.compile(r"[0-9a-f]{64}")
_OWN_WEIGHTS: Final = "checkpoint_sha256"
"""Setting of a planner that was given another file than its own."""


def check_planner(facts: RecordFacts, ours_like: OwnPlannerLookup) -> Iterator[GradedSentence]:
    """Compare a record's claims about its planner with the planner itself."""
    planner = facts.planner
    for kind, claimed in (("weights", planner.weights_sha256), ("code", planner.code_sha256)):
        if claimed is not None and not _SHA256.fullmatch(claimed):
            yield FindingLevel.ERROR, f"names {kind} {claimed[:80]!r}, which is not a SHA-256 (64 hexadecimal digits)"
    if planner.native_protocol is not None and planner.native_protocol not in PROTOCOLS:
        yield (
            FindingLevel.ERROR,
            f"names the native protocol {planner.native_protocol!r}, which this version does not know",
        )
    if planner.weights_sha256 is None and planner.code_sha256 is None:
        yield (
            FindingLevel.NOTE,
            "names neither weights nor code (plans from a file): the model behind it cannot be verified",
        )
    if planner.privileged:
        yield (
            FindingLevel.NOTE,
            "is privileged: the planner saw boxes, the map or the recorded future, and tables mark it",
        )
    source = facts.environment.get("source")
    if isinstance(source, dict) and source.get("dirty"):
        yield FindingLevel.NOTE, "was made with uncommitted changes to challenger-bench"
    ours = ours_like(planner)
    if ours is not None and ours.code_sha256 == planner.code_sha256:
        yield from _find_differences(planner, ours)
    else:
        yield FindingLevel.NOTE, _describe_declaration(planner, ours)


def _find_differences(planner: PlannerFacts, ours: PlannerFacts) -> Iterator[GradedSentence]:
    """Where a planner with the code of ours says of itself what ours does not."""
    if ours.name != planner.name:
        yield FindingLevel.NOTE, f"has the code of {ours.name} under another name"
    for field in ("privileged", "native_protocol", "miniature", "published_as"):
        claimed, known = getattr(planner, field), getattr(ours, field)
        if claimed != known:
            yield (
                FindingLevel.ERROR,
                f"says {field.replace('_', ' ')}: {claimed}, and {ours.name}, whose code it has, is {known}; "
                "submit the record that eval wrote",
            )
    if _OWN_WEIGHTS in planner.settings:
        yield FindingLevel.NOTE, f"ran {ours.name} with other weights, of which only the hash is known"
    elif planner.weights_sha256 != ours.weights_sha256:
        yield (
            FindingLevel.ERROR,
            f"names other weights ({_shorten_hash(planner.weights_sha256)}) than {ours.name} has "
            f"({_shorten_hash(ours.weights_sha256)}); run your own weights with eval --checkpoint",
        )


def _describe_declaration(planner: PlannerFacts, ours: PlannerFacts | None) -> str:
    called = "" if ours is None else f"is called {ours.name} but lacks this version's code of it; "
    native = planner.native_protocol or "none"
    return (
        f"{called}declares privileged: {'yes' if planner.privileged else 'no'}, native protocol: {native}, weights: "
        f"{_shorten_hash(planner.weights_sha256)}, code: {_shorten_hash(planner.code_sha256)}; this cannot be verified"
    )


def _shorten_hash(sha256: str | None) -> str:
    return "none" if sha256 is None else sha256[:12]


Record = RunRecord | DriveRecord
_LABELS: Final = {"published_as", "miniature", "wants"}
"""Fields in which two descriptions of the same planner may differ."""


def find_no_planner(planner: PlannerFacts) -> PlannerFacts | None:
    """For who knows no planners: everything that is said of one is a declaration."""
    return None


def check_submission(
    folder: Path,
    data_name: str,
    open_split: Callable[[str], "DataSet"],
    ours_like: OwnPlannerLookup = find_no_planner,
) -> tuple[list[Record], list[SubmissionFinding]]:
    """Check every record below a folder; one that is bad does not stop the others. Nothing is written.

    Args:
        folder: The submission.
        data_name: Name of the data set that records must be of.
        open_split: Opens the data set that holds a split; asked once for each split.
        ours_like: Knows this program's planners.

    Returns:
        Records without an error, runs before drives, and all findings by record.

    Raises:
        InputError: If there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}; name the folder with the submitted run records")
    places: list[tuple[Path, Callable[[Path], Record]]] = [
        *((directory, load_record) for directory in find_record_directories(folder)),
        *((path.parent, load_drives) for path in sorted(folder.rglob(DRIVE_FILE))),
    ]
    if not places:
        return [], [
            SubmissionFinding(
                folder,
                FindingLevel.ERROR,
                "holds no run record (run.json, samples.jsonl, summary.json) and no drives "
                "(drive.json, ...); submit what challenger-bench eval and drive write below OUT",
            )
        ]
    opened: OpenedDataSets = {}
    sound: list[Record] = []
    findings: list[SubmissionFinding] = []
    for directory, load in places:
        record_findings: list[SubmissionFinding] = []
        try:
            record = load(directory)
            facts = read_record_facts(record)
            record_findings += [
                SubmissionFinding(directory, level, says) for level, says in _check_claims(record, data_name, ours_like)
            ]
            if facts.data.name == data_name:
                data = open_as_recorded(facts, opened, open_split)
                record_findings += [
                    SubmissionFinding(directory, level, says) for level, says in _recompute(record, data)
                ]
        except InputError as error:
            findings += [*record_findings, SubmissionFinding(directory, FindingLevel.ERROR, str(error))]
            continue
        findings += record_findings
        if all(finding.level is not FindingLevel.ERROR for finding in record_findings):
            sound.append(record)
    return sound, [*findings, *_find_duplicates(sound)]


def read_record_facts(record: Record) -> RecordFacts:
    """Facts in the first file of a record."""
    return record.run if isinstance(record, RunRecord) else record.facts


def _check_claims(record: Record, data_name: str, ours_like: OwnPlannerLookup) -> Iterator[GradedSentence]:
    unit = "sample" if isinstance(record, RunRecord) else "drive"
    failed = sum(row.status == "failed" for row in record.rows)
    yield from check_claims(read_record_facts(record), failed, len(record.rows), unit, data_name)
    if isinstance(record, RunRecord):
        yield from check_protocols(record)
    yield from check_planner(read_record_facts(record), ours_like)


def _recompute(record: Record, data: "DataSet") -> Iterator[GradedSentence]:
    facts = read_record_facts(record)
    of_split = list(check_split(facts, data))
    yield from of_split
    # Scenes that the data set lacks cannot be assessed.
    if set(facts.scenes) <= set(data.scene_names(facts.split)):
        yield from recompute_run(record, data) if isinstance(record, RunRecord) else recompute_drives(record, data)
        yield from check_leaks(record, data)


def _find_duplicates(records: Sequence[Record]) -> Iterator[SubmissionFinding]:
    """Two records that would be one row of a table."""
    directories: dict[tuple[Any, ...], Path] = {}
    for record in records:
        facts = read_record_facts(record)
        measured = None if isinstance(record, RunRecord) else record.facts.measured.model_dump_json()
        key = (facts.data.name, facts.split, facts.planner.model_dump_json(exclude=_LABELS), measured)
        first = directories.setdefault(key, record.directory)
        if first != record.directory:
            yield SubmissionFinding(
                record.directory,
                FindingLevel.ERROR,
                f"is the same planner on the same split as {first}; keep one of them",
            )
