"""Results of a submitted record's plans, recomputed and compared field by field, and the findings of the check."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import BaseModel

from benchmark.closed_loop.engines import restore_backend
from benchmark.closed_loop.scoring import VERSION as DRIVE_SCORING
from benchmark.datasets.annotated_objects import AnnotationCount
from benchmark.datasets.scene_facts import add_truth_facts
from benchmark.errors import InputError
from benchmark.pdm.definition import DEFINITION, VERSION
from benchmark.pdm.totals import DrivenPlan
from benchmark.protocols import PROTOCOLS
from benchmark.protocols.raster import ADVERSARY_S, HIT_ADVERSARY, TOUCHED, TOUCHED_ADVERSARY
from benchmark.records.drives import DriveRecord, compute_columns
from benchmark.records.drives import summarise_episodes as summarise_drives
from benchmark.records.row_schema import OutcomeRow, SampleRow
from benchmark.records.run import RunRecord, summarise_rows
from benchmark.records.run_schema import RunSummary, TruthFacts
from benchmark.report.words import pluralise
from benchmark.runs.drive_rows import mark_labelled
from benchmark.runs.redriving import redrive_and_score
from benchmark.runs.rescoring import find_unjudged, rejudge_rows, require_same_data
from benchmark.runs.scene_reading import SceneReading, collect_truth_facts

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


class FindingLevel(StrEnum):
    """Meaning of a finding: an error keeps a record out; a note is for the reader.

    ``suspicious`` marks a behaviour that honest planners were never seen to show, and proves nothing.
    """

    ERROR = "error"
    SUSPICIOUS = "suspicious"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class SubmissionFinding:
    """One fault of a submission and its remedy, or a remark; `directory` is that of the record or submission."""

    directory: Path
    level: FindingLevel
    sentence: str

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"directory": str(self.directory)}


GradedSentence = tuple[FindingLevel, str]
"""A finding about a record whose directory is known."""


SAME_M_S: Final = 0.01
"""Speeds that are this close are the same: processors differ in the last bits of a fit."""
_LATER: Final = frozenset(
    {
        "recorded_adversary",
        "recorded",
        "before_mask",
        "left_out",
        TOUCHED,
        TOUCHED_ADVERSARY,
        HIT_ADVERSARY,
        ADVERSARY_S,
    }
)
"""Columns and facts of verdicts that records of the same protocol version need not have yet."""
_LATER_COUNTS: Final = frozenset({"mask_removed_steps", "mask_removed_for_adversary"})
"""Counts of a summary that may be null in older records."""
_UNSAID: Final = frozenset({"columns", "value"})
"""Internal fields, left out of messages."""
_RESCORE: Final = "run challenger-bench rescore"


def check_protocols(record: RunRecord) -> Iterator[GradedSentence]:
    """Check that all protocols that judge every run judged this one, in their present versions."""
    unknown = sorted(set(record.run.protocols) - set(PROTOCOLS))
    if unknown:
        yield FindingLevel.ERROR, f"was scored by {', '.join(unknown)}, which this version does not know; {_RESCORE}"
    if record.stale_protocols:
        yield FindingLevel.ERROR, f"was scored by other versions of {', '.join(record.stale_protocols)}; {_RESCORE}"
    if record.missing_protocols:
        yield FindingLevel.ERROR, f"was not scored by {', '.join(record.missing_protocols)}; {_RESCORE}"
    if record.summary.driving is not None and record.summary.driving.version != VERSION:
        yield FindingLevel.ERROR, f"was scored by another version of {DEFINITION}; {_RESCORE}"


def recompute_run(record: RunRecord, data: "DataSet") -> Iterator[GradedSentence]:
    """Check that the data set, which must be the same, and the plans give what a run record says."""
    run = record.run
    require_same_data(record.directory, run, data)
    if mixed := next((row for row in record.rows if (row.status == "ok") != (row.plan is not None)), None):
        yield (
            FindingLevel.ERROR,
            f"claims {mixed.status!r} for sample {mixed.sample_token} of {mixed.scene}, unlike its plan",
        )
        return
    names = tuple(name for name in run.protocols if name in PROTOCOLS and name not in record.stale_protocols)
    anew: list[SampleRow] = []
    truths: dict[str, TruthFacts] = {}
    counts = AnnotationCount.together(list(data.annotation_counts(run.scenes).values()))
    for scene in run.scenes:
        reading = SceneReading(data, scene)
        anew += rejudge_rows(record, reading, names, find_unjudged(counts, names))
        truths[scene] = reading.truth_facts
    if len(anew) != len(record.rows):
        yield (
            FindingLevel.ERROR,
            f"has {pluralise(len(record.rows), 'sample')}, but its scenes have {len(anew)}; run eval again",
        )
        return
    different = [row for row, computed in zip(record.rows, anew) if not _is_same_row(row, computed, names)]
    if different:
        first = different[0]
        yield (
            FindingLevel.ERROR,
            f"claims other verdicts than its plans on {len(different)} of {pluralise(len(anew), 'sample')}, first on "
            f"sample {first.sample_token} of {first.scene}; {_RESCORE}",
        )
    scored = [row for row, computed in zip(record.rows, anew) if not _is_same_driving(row.driving, computed.driving)]
    if scored and _is_current_driving(record.summary):
        yield (
            FindingLevel.ERROR,
            f"claims other driving scores than its plans give, first on sample {scored[0].sample_token} of "
            f"{scored[0].scene}; {_RESCORE}",
        )
    for scene, facts in run.scene_facts.items():
        if facts.truth is not None and facts.truth != truths[scene]:
            yield FindingLevel.ERROR, f"differs from the data set in the truth of {scene}; {_RESCORE}"
            return
    versions, facts_here = (
        {name: run.protocols[name] for name in names},
        add_truth_facts(data.scene_facts(run.scenes), truths),
    )
    yield from _compare_summary(
        record.summary, summarise_rows(anew, versions, seed=run.seed, scene_facts=facts_here), names
    )


def recompute_drives(record: DriveRecord, data: "DataSet") -> Iterator[GradedSentence]:
    """Check that stored plans drive, score and sum up to a record of drives; `InputError` if they lead elsewhere."""
    facts, measured = record.facts, record.facts.measured
    if facts.data.fingerprint != data.fingerprint():
        raise InputError(f"was driven on {facts.data.name} with other content than {data.root}; run drive again")
    if facts.scoring != DRIVE_SCORING:
        yield (
            FindingLevel.ERROR,
            f"was scored by version {facts.scoring}, not {DRIVE_SCORING}; run the same drive again",
        )
        return
    driven = {(row.scene, row.family, row.run, row.window) for row in record.rows}
    if len(driven) != len(record.rows) or {row.scene for row in record.rows} != set(facts.scenes):
        yield FindingLevel.ERROR, "has duplicate drives, or scenes without a drive; run the same drive again"
        return
    maker = restore_backend(measured)
    truths = collect_truth_facts(data, facts.scenes)
    for row in record.rows:
        if [row] != mark_labelled([redrive_and_score(maker, data.scene(row.scene), data, row)], truths):
            yield (
                FindingLevel.ERROR,
                f"claims other scores than its plans give on {row.scene}, run {row.run}; drive again",
            )
            return
    summary = summarise_drives(record.rows, facts.scene_facts, seed=facts.seed)
    claimed = record.summary.model_copy(update={"columns": compute_columns(record)})
    if difference := _find_first_difference(claimed, summary):
        yield FindingLevel.ERROR, f"claims {difference} in its summary; run the same drive again"


def _is_same_row(row: SampleRow, computed: SampleRow, protocols: Sequence[str]) -> bool:
    judged = {"outcomes", "disagreements", "driving", "place", "speed_m_s"}
    return (
        row.model_dump(exclude=judged) == _as_told(row, computed).model_dump(exclude=judged)
        and _has_same_circumstances(row, computed)
        and all(_is_same_verdict(row.outcomes.get(name), computed.outcomes.get(name)) for name in protocols)
        and all(row.disagreements.get(name) == computed.disagreements.get(name) for name in protocols)
    )


def _as_told(claimed: SampleRow, computed: SampleRow) -> SampleRow:
    """A row without fault where an older one does not say it."""
    severity, said = computed.severity, claimed.severity
    contacts = (one.contact for one in (severity, said) if one is not None)
    mine, theirs = (*contacts, None, None)[:2]
    if severity is None or mine is None or theirs is None or theirs.fault is not None:
        return computed
    without = severity.model_copy(update={"contact": mine.model_copy(update={"fault": None})})
    return computed.model_copy(update={"severity": without})


def _has_same_circumstances(claimed: SampleRow, computed: SampleRow) -> bool:
    """Whether a row has the place and speed of the data; older rows have neither."""
    if claimed.speed_m_s is None or computed.speed_m_s is None:
        return claimed.place is None or claimed.place == computed.place
    return claimed.place == computed.place and abs(claimed.speed_m_s - computed.speed_m_s) <= SAME_M_S


def _is_same_verdict(claimed: OutcomeRow | None, computed: OutcomeRow | None) -> bool:
    """Whether two verdicts are equal; older records may lack columns."""
    if claimed is None or computed is None:
        return claimed is computed
    steps = {name: column for name, column in computed.steps.items() if name in claimed.steps or name not in _LATER}
    facts = {name: fact for name, fact in computed.facts.items() if name in claimed.facts or name not in _LATER}
    return claimed == computed.model_copy(update={"steps": steps, "facts": facts})


def _is_same_driving(claimed: DrivenPlan | None, computed: DrivenPlan | None) -> bool:
    """Whether two verdicts are equal; older records lack the objects that plans touch."""
    if claimed is None or computed is None or claimed.hit_adversary is not None:
        return claimed == computed
    one, other = (
        replace(each, hit=None, first_contact_s=None, hit_adversary=None, adversary_contact_s=None)
        for each in (claimed, computed)
    )
    return one == other


def _is_current_driving(summary: RunSummary) -> bool:
    return summary.driving is None or summary.driving.version == VERSION


def _compare_summary(claimed: RunSummary, computed: RunSummary, protocols: Sequence[str]) -> Iterator[GradedSentence]:
    """Every field of a summary; protocols that this version cannot judge with are left to `check_protocols`."""
    for name in protocols:
        if name not in claimed.protocols:
            yield FindingLevel.ERROR, f"has no rates under {name}; {_RESCORE}"
        elif difference := _find_first_difference(
            claimed.protocols[name], computed.protocols[name], may_lack=_LATER_COUNTS
        ):
            yield FindingLevel.ERROR, f"claims {difference} under {name}; {_RESCORE}"
    if others := sorted(set(claimed.protocols) - set(protocols) - set(PROTOCOLS)):
        yield (
            FindingLevel.ERROR,
            f"has rates under {', '.join(others)}, which no protocol of this version gives; {_RESCORE}",
        )
    if claimed.driving is None and computed.driving is not None:
        yield FindingLevel.ERROR, f"has no driving scores; {_RESCORE}"
    elif _is_current_driving(claimed) and (difference := _find_first_difference(claimed.driving, computed.driving)):
        yield FindingLevel.ERROR, f"claims other driving scores than its plans give: {difference}; {_RESCORE}"
    totals = {"schema_version", "protocols", "driving"}
    if difference := _find_first_difference(claimed.model_dump(exclude=totals), computed.model_dump(exclude=totals)):
        yield FindingLevel.ERROR, f"claims {difference}; {_RESCORE}"


def _find_first_difference(claimed: Any, computed: Any, *, may_lack: frozenset[str] = frozenset(), at: str = "") -> str:
    """The first value that is not the same, in words: where, what is said, what is right; empty if there is none."""
    if isinstance(claimed, BaseModel):
        claimed = claimed.model_dump()
    if isinstance(computed, BaseModel):
        computed = computed.model_dump()
    if isinstance(claimed, Mapping) and isinstance(computed, Mapping):
        for name in dict.fromkeys([*computed, *claimed]):
            if name in may_lack and claimed.get(name) is None:
                continue
            place = at if name in _UNSAID else f"{at} {name}".strip()
            if different := _find_first_difference(claimed.get(name), computed.get(name), may_lack=may_lack, at=place):
                return different
        return ""
    return "" if claimed == computed else f"{at} = {claimed}, but its plans give {computed}"
