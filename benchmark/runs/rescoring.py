"""Judge the stored plans of run records anew: after a change of protocols, no planner has to run again.

Judges that go by categories which a data set does not have are told apart here: their verdicts would mean nothing.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.datasets.annotated_objects import AnnotationCount
from benchmark.datasets.categories import CategoryNames
from benchmark.datasets.scene_facts import add_truth_facts
from benchmark.errors import InputError
from benchmark.machine.environment import read_machine_metadata as environment_facts
from benchmark.machine.storage import lock_folder
from benchmark.machine.workspace import hint_at_earlier_town, strip_version
from benchmark.pdm.definition import PDM
from benchmark.protocols import PROTOCOLS, find_category_protocols, find_protocol
from benchmark.records.review import describe_review
from benchmark.records.row_schema import SampleRow
from benchmark.records.rows import SampleRows
from benchmark.records.run import RunRecord, load_record, summarise_rows, write_record
from benchmark.records.run_schema import SCHEMA, RecordFacts, SceneFacts, TruthFacts
from benchmark.records.store import RUN_FILE, finish_replacement, pending_path, stored_schema
from benchmark.road_map import Handedness
from benchmark.runs.caveats import list_run_caveats
from benchmark.runs.judging import judge_plans
from benchmark.runs.scene_reading import SceneReading

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def find_unjudged(counts: AnnotationCount, protocols: Sequence[str]) -> tuple[str, ...]:
    """``pdm`` and protocols that go by categories, where too many are unknown to judge contacts; else none."""
    return (*find_category_protocols(protocols), PDM) if counts.is_mostly_unknown else ()


def require_vocabulary(counts: AnnotationCount, asked: Iterable[str], protocols: Sequence[str], where: str) -> None:
    """Refuse judges that were asked for by name, or are the planner's own, and say nothing of contacts."""
    silent = find_unjudged(counts, protocols)
    wrong = next((name for name in asked if name in silent), None)
    if wrong is not None:
        raise InputError(
            f"{counts.sentence} in {where}, so that {wrong}, which depends on categories, sees almost no road users; "
            "map them with --categories (short, lyft, t4, argoverse2 or a JSON file)"
        )


_OF_THE_PLAN = {"scene", "sample_token", "index", "timestamp_us", "status", "ego_motion", "plan", "error", "note"}
"""Fields of a row about the planner, which rescoring keeps."""
_OF_THE_VERDICTS = {"schema_version", "status", "protocols", "seed", "files"}
"""Fields of a record that are set when it is written."""


@dataclass(frozen=True, slots=True)
class RescoringResult:
    """Result of rescoring one record: ``rescored``, ``current``, that it was left alone, or why it failed."""

    directory: Path
    sentence: str
    failed: bool = False


def rescore(record_directory: Path, data: "DataSet", *, protocols: Sequence[str] | None = None) -> RunRecord:
    """Judge the plans of a record anew.

    Plans, errors, the planner and the environment that it ran in stay; everything else is computed from them and from
    the data set. A record in which nothing would change is not written, so doing it twice changes no byte.

    Args:
        record_directory: Run directory; a replacement that was stopped half-way is finished first.
        data: The data set that the planner ran on.
        protocols: Who judges, all that are known by default; the record holds these and no others afterwards.

    Returns:
        The record.

    Raises:
        InputError: If the record is damaged or cannot be written, a protocol is unknown, the data is another, or a
            judge of the record is not installed and `protocols` does not say that its verdicts may go.
    """
    with ExitStack() as held:
        opened = _open(record_directory, lambda _: data, protocols, held)
        assert not isinstance(opened, str)
        for scene in opened.old.run.scenes:
            reading = SceneReading(data, scene)
            opened.add(rejudge_rows(opened.old, reading, tuple(opened.versions), opened.silent), reading)
        return _replace_record(opened)[0]


def rescore_all(
    root: Path, open_split: Callable[[str], "DataSet"], data_name: str, protocols: Sequence[str] | None = None
) -> Iterator[RescoringResult]:
    """Judge all records below a folder anew; one that cannot be does not stop the others.

    Args:
        root: Where to look.
        open_split: Opens the data set that holds a split; asked once for each split.
        data_name: Name of the data set; records of others are left alone.
        protocols: Who judges; all that are known by default.

    Yields:
        What became of each record, by path.

    Raises:
        InputError: If the folder does not exist or a protocol is unknown.
    """
    if not root.is_dir():
        raise InputError(f"{root} does not exist; run challenger-bench eval first, or give the right folder with --out")
    for name in protocols or ():
        find_protocol(name)
    opened: OpenedDataSets = {}

    def open_for(record: RunRecord) -> "DataSet | None":
        return open_if_recorded_on(data_name, record.run, opened, open_split)

    results: dict[Path, RescoringResult] = {}
    waiting: list[_OpenedRecord] = []
    with ExitStack() as held:
        for directory in find_record_directories(root):
            try:
                opened_record = _open(directory, open_for, protocols, held)
            except InputError as error:
                results[directory] = RescoringResult(directory, str(error), failed=True)
                continue
            if isinstance(opened_record, str):
                results[directory] = RescoringResult(directory, opened_record)
            else:
                waiting.append(opened_record)
        for result in _rescore_records(waiting):
            results[result.directory] = result
    yield from (results[directory] for directory in sorted(results))


OpenedDataSets = dict[tuple[str, CategoryNames, str], "DataSet"]
"""Data sets by split, and by what records say of them: names of categories that are replaced, side of traffic."""


def open_as_recorded(facts: RecordFacts, opened: OpenedDataSets, open_split: Callable[[str], "DataSet"]) -> "DataSet":
    """The data set that a record ran on, with what was said of it then; ``opened`` has the open ones."""
    names, side = read_replaced_categories(facts), str(facts.config.get("driving_side", ""))
    as_it_is, key = (facts.split, (), ""), (facts.split, names, side)
    if as_it_is not in opened:
        opened[as_it_is] = open_split(facts.split)
    if key not in opened:
        named = opened[as_it_is].with_categories(names)
        opened[key] = named.with_driving_side(Handedness(side)) if side in [*Handedness] else named
    return opened[key]


def open_if_recorded_on(
    data_name: str, facts: RecordFacts, opened: OpenedDataSets, open_split: Callable[[str], "DataSet"]
) -> "DataSet | None":
    """The data set that a record ran on, if it is that of a name, or an earlier town that was called ``mini`` then."""
    if facts.data.name not in (data_name, strip_version(data_name)):
        return None
    data = open_as_recorded(facts, opened, open_split)
    return data if facts.data.name == data_name or facts.data.fingerprint == data.fingerprint() else None


def read_replaced_categories(facts: RecordFacts) -> CategoryNames:
    """Names of categories that were replaced when a record was made, and what by."""
    stored = facts.config.get("categories")
    return tuple(sorted((str(name), str(to)) for name, to in stored.items())) if isinstance(stored, dict) else ()


@dataclass(slots=True)
class _OpenedRecord:
    """A record that is being judged anew; the protocols in ``silent`` say nothing of contacts here."""

    old: RunRecord
    data: "DataSet"
    versions: dict[str, int]
    silent: tuple[str, ...]
    rows: SampleRows = field(default_factory=SampleRows)
    truths: dict[str, TruthFacts] = field(default_factory=dict)

    def add(self, rows: Sequence[SampleRow], reading: SceneReading) -> None:
        """Take the rows of one scene."""
        self.rows.add(rows)
        self.truths[reading.name] = reading.truth_facts


def _open(
    directory: Path,
    open_for: Callable[[RunRecord], "DataSet | None"],
    protocols: Sequence[str] | None,
    held: ExitStack,
) -> _OpenedRecord | str:
    """A record to be judged anew, locked against other writers until ``held`` ends; or why it is left alone."""
    versions = {name: find_protocol(name).version for name in (PROTOCOLS if protocols is None else protocols)}
    if not directory.is_dir():
        raise InputError(f"no run record in {directory}; give the folder that holds its {RUN_FILE}")
    with ExitStack() as own:
        own.enter_context(lock_folder(directory))
        finish_replacement(directory)
        old = load_record(directory)
        data = open_for(old)
        if data is None:
            return f"skipped: it belongs to data set {old.run.data.name}; choose that one with --data"
        require_same_data(directory, old.run, data)
        if protocols is None and (gone := [name for name in old.run.protocols if name not in PROTOCOLS]):
            raise InputError(
                f"{directory} holds verdicts of {', '.join(gone)}, which is not installed; install its package, "
                "or run challenger-bench eval again"
            )
        held.enter_context(own.pop_all())
    counts = AnnotationCount.together(list(data.annotation_counts(old.run.scenes).values()))
    return _OpenedRecord(old, data, versions, find_unjudged(counts, tuple(versions)))


def _rescore_records(waiting: Sequence[_OpenedRecord]) -> Iterator[RescoringResult]:
    """Judge records anew, scene by scene, so that each scene is read once for all of them."""
    alive = {opened.old.directory: opened for opened in waiting}
    wanted = dict.fromkeys((id(opened.data), scene) for opened in waiting for scene in opened.old.run.scenes)
    data_of = {id(opened.data): opened.data for opened in waiting}
    for data_id, scene in wanted:
        reading = SceneReading(data_of[data_id], scene)
        records_of_scene = [
            candidate
            for candidate in alive.values()
            if id(candidate.data) == data_id and scene in candidate.old.run.scenes
        ]
        for opened, rows in _judge_together(records_of_scene, reading):
            if isinstance(rows, InputError):
                del alive[opened.old.directory]
                yield RescoringResult(opened.old.directory, str(rows), failed=True)
            else:
                opened.add(rows, reading)
    for opened in alive.values():
        try:
            yield RescoringResult(opened.old.directory, _replace_record(opened)[1])
        except InputError as error:
            yield RescoringResult(opened.old.directory, str(error), failed=True)


def _judge_together(
    records: Sequence[_OpenedRecord], reading: SceneReading
) -> Iterator[tuple[_OpenedRecord, list[SampleRow] | InputError]]:
    """Rows of a scene of each record, or why it has none: all records in one, those that cannot be apart."""
    plans_of: list[list[dict[str, Any]]] = []
    readable: list[_OpenedRecord] = []
    for opened in records:
        try:
            plans_of.append(read_stored_plans(opened.old, reading))
            readable.append(opened)
        except InputError as error:
            yield opened, error
    if not readable:
        return
    # All of them are judged by the protocols that the command names.
    protocols = tuple(readable[0].versions)
    if len({opened.silent for opened in readable}) > 1:
        for opened in readable:
            yield from _judge_together([opened], reading)
        return
    try:
        yield from zip(readable, judge_plans(plans_of, reading, protocols, readable[0].silent), strict=True)
    except InputError:
        for opened, plans in zip(readable, plans_of, strict=True):
            try:
                yield opened, judge_plans([plans], reading, protocols, opened.silent)[0]
            except InputError as error:
                yield opened, error


def find_record_directories(root: Path) -> list[Path]:
    """Folders below a folder that hold a record, or one that was stopped while it was replaced; by path."""
    return sorted(
        {path.parent for name in (RUN_FILE, pending_path(Path(), RUN_FILE).name) for path in root.rglob(name)}
    )


def _replace_record(opened: _OpenedRecord) -> tuple[RunRecord, str]:
    """Write a record that was judged anew, unless nothing changes; the record and what became of it."""
    old, directory = opened.old, opened.old.directory
    rows = opened.rows.in_order_of(old.run.scenes)
    scene_facts = add_truth_facts(read_current_scene_facts(old.run, opened.data), opened.truths)
    facts = {
        **{name: value for name, value in dict(old.run).items() if name not in _OF_THE_VERDICTS},
        "scene_facts": scene_facts,
        "caveats": list_run_caveats(old.run.planner, scene_facts, rows, old.run.caveats),
        "config": {**old.run.config, "protocols": list(opened.versions)},
    }
    if stored_schema(directory) == SCHEMA and _is_unchanged(old, facts, rows, opened.versions):
        return old, "current"
    facts["rescored"] = environment_facts()
    return write_record(directory, facts, rows, opened.versions, seed=old.run.seed), "rescored"


def read_current_scene_facts(facts: RecordFacts, data: "DataSet") -> dict[str, SceneFacts]:
    """Facts of the data set, and a record's facts of scenes that are not judged here: the tracks are the same."""
    known = facts.scene_facts
    return {
        name: current.model_copy(update={"judgement": known[name].judgement})
        if current.judgement is None and name in known
        else current
        for name, current in data.scene_facts(facts.scenes).items()
    }


def require_same_data(directory: Path, facts: RecordFacts, data: "DataSet", *, again: str = "eval") -> None:
    """Refuse a data set of other content than a planner ran on, or of which inspectors said otherwise then.

    ``again`` is the command that makes such records.
    """
    if facts.data.fingerprint != data.fingerprint():
        raise InputError(
            f"{directory} used other data of {facts.data.name} than {data.root} now holds (the "
            f"fingerprints differ{hint_at_earlier_town(facts.data.name)}); open the data set that it ran on with "
            f"--data, or run challenger-bench {again} again"
        )
    review = data.review(facts.split).facts
    if (None if facts.review is None else facts.review.content) != (None if review is None else review.content):
        raise InputError(
            f"{directory} used other verdicts of inspectors ({describe_review(facts.review)}) than are "
            f"beside {data.root} now ({describe_review(review)}); run challenger-bench {again} again, kept plans stay"
        )


def rejudge_rows(
    record: RunRecord, reading: SceneReading, protocols: tuple[str, ...], silent: Collection[str] = ()
) -> list[SampleRow]:
    """Rows of one scene, a row for each sample, computed from the stored plans and the data set.

    The protocols in ``silent`` say nothing of contacts here.
    """
    return judge_plans([read_stored_plans(record, reading)], reading, protocols, silent)[0]


def read_stored_plans(record: RunRecord, reading: SceneReading) -> list[dict[str, Any]]:
    """A record's plans of a scene, a JSON object for each sample; the record must hold the samples of the scene."""
    plans = [row.model_dump(mode="json", include=_OF_THE_PLAN) for row in record.rows_of(reading.name)]
    if [plan["sample_token"] for plan in plans] != [truth.sample_token for truth in reading.truth]:
        raise InputError(
            f"{record.directory} does not hold the samples of {reading.name}; run challenger-bench eval again"
        )
    return plans


def _is_unchanged(record: RunRecord, facts: dict[str, Any], rows: SampleRows, versions: dict[str, int]) -> bool:
    return (
        record.rows == rows
        and record.run.protocols == versions
        and all(getattr(record.run, name) == value for name, value in facts.items())
        and record.summary == summarise_rows(rows, versions, seed=record.run.seed, scene_facts=facts["scene_facts"])
    )
