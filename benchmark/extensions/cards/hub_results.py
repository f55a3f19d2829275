"""Evaluation results as Hugging Face's hub reads them: one file a planner, and the ``eval.yaml`` of the benchmark.

The hub sorts by value, so that every task is a share *without* contact. It has no place for intervals and counts: they
stand in the notes, and in full in documents of `benchmark.extensions.cards.every_eval_ever`.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.extensions.cards.every_eval_ever import build_document
from benchmark.extensions.cards.writing import CARD_FILE, CROISSANT_FILE, CardSettings
from benchmark.machine.storage import content_key, sanitise_file_name
from benchmark.metrics.rates import Rate
from benchmark.records.drives import COLLISION_RATE, DriveRecord, compute_columns
from benchmark.records.planner_versions import compute_version_labels
from benchmark.records.run import NO_NATIVE, RunRecord
from benchmark.records.run_schema import is_baseline
from benchmark.report.words import pluralise

FOLDER: Final = ".eval_results"
BENCHMARK_FILE: Final = "eval.yaml"
ARCHIVE: Final = "every_eval_ever"
"""Folder of the documents of that name."""
MOST_NOTES: Final = 200
_OURS: Final = "Written by challenger-bench"
"""Stands in every file that may be written again."""
_NAME: Final = re.compile(r"[\w.-]+/[\w.-]+", re.ASCII)
_TASK: Final = re.compile(r"[\w.-]+", re.ASCII)
_REVISION: Final = re.compile(r"[0-9a-f]{40}")
_ADDRESS: Final = re.compile(r"https?://[^\s\"<>]+")
_LONGEST_FILE_NAME: Final = 255


def check_entries(stored: Any) -> list[tuple[str, str, float]]:
    """Data set, task and value of each entry of a file of results; ``ValueError`` says which rule one breaks.

    Stricter than the hub's client, which takes values that are no number, dates that are none, and an entry twice.
    """
    if not isinstance(stored, list):
        raise ValueError("it is no list of entries")
    entries = [_check_entry(entry) for entry in stored]
    if len({entry[:2] for entry in entries}) < len(entries):
        raise ValueError("it has two entries for one task")
    return entries


def _check_entry(entry: Any) -> tuple[str, str, float]:
    data = _mapping(_mapping(entry, "an entry").get("dataset"), "dataset")
    _require(_NAME, data.get("id"), "dataset.id")
    _require(_TASK, data.get("task_id"), "dataset.task_id")
    value, notes, date = entry.get("value"), entry.get("notes"), entry.get("date")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError("value is no finite number")
    if "revision" in data:
        _require(_REVISION, data["revision"], "dataset.revision")
    if "source" in entry:
        _require(_ADDRESS, _mapping(entry["source"], "source").get("url"), "source.url")
    if "date" in entry:
        if not isinstance(date, str):
            raise ValueError("date is no text in quotes")
        datetime.fromisoformat(date)
    if "notes" in entry and not (isinstance(notes, str) and len(notes) <= MOST_NOTES and notes.isprintable()):
        raise ValueError(f"notes are not one line of at most {MOST_NOTES} characters")
    return data["id"], data["task_id"], float(value)


def _mapping(value: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what} is no mapping")
    return value


def _require(pattern: re.Pattern[str], value: Any, what: str) -> None:
    if not (isinstance(value, str) and pattern.fullmatch(value)):
        raise ValueError(f"{what} is absent or malformed")


class HubTask(NamedTuple):
    """A task of the benchmark: what ``task_id`` of results refers to, the split, and what is measured, in words."""

    id: str
    split: str
    measured: str


class _Result(NamedTuple):
    """What a record says about one task."""

    planner: str
    record: RunRecord | DriveRecord
    task: HubTask
    rate: Rate


@dataclass(frozen=True, slots=True)
class HubFiles:
    """Files to write, by path below the card's folder, and why records are in none of them, a sentence each."""

    files: Mapping[PurePosixPath, bytes]
    left_out: tuple[str, ...]


def build_hub_files(
    records: Sequence[RunRecord], drives: Sequence[DriveRecord], settings: CardSettings, taken: Iterable[str]
) -> HubFiles:
    """Files for the hub; nothing is written and nothing is uploaded.

    Args:
        records: Of planning; `exact` is what tasks are of.
        drives: Of driving.
        settings: ``hub`` is ``ORG/NAME``: the data set to which results belong. Records are those of the frozen split
            of that name, or else of the data set of that name.
        taken: Names in the card's folder that no planner's folder may have.

    Returns:
        ``PLANNER/.eval_results/NAME.yaml``, ``eval.yaml`` and the documents of every-eval-ever.

    Raises:
        InputError: If no record is of that data set, two are of one planner and task, or a task mixes two data sets.
    """
    assert settings.hub is not None
    organisation, _, name = settings.hub.partition("/")
    of_set = _select(records, drives, name)
    left_out: list[str] = []
    results = [result for planner, record in of_set if (result := _read_result(planner, record, name, left_out))]
    if not results:
        why = f" ({left_out[0]})" if left_out else ""
        raise InputError(f"no record of {name} is a result for a hub{why}; run challenger-bench eval with a planner")
    tasks = _list_tasks(results)
    files = {PurePosixPath(BENCHMARK_FILE): _encode_benchmark(settings.hub, tasks)}
    for planner in sorted({result.planner for result in results}):
        folder = _folder_of(planner, (*taken, BENCHMARK_FILE, ARCHIVE, CARD_FILE, CROISSANT_FILE))
        own = [result for result in results if result.planner == planner]
        files[PurePosixPath(folder, FOLDER, f"{name}.yaml")] = _encode_entries(own, settings)
        for result in own:
            document = build_document(result.record, planner, organisation, name, settings.day)
            place = PurePosixPath(ARCHIVE, "data", name, organisation, folder, f"{document.uuid}.json")
            files[place] = document.encode()
    return HubFiles(files, tuple(dict.fromkeys(left_out)))


def require_own_files(to: Path, files: Iterable[PurePosixPath]) -> None:
    """Refuse to write over a file that another tool or a person wrote; documents are named by what is in them."""
    for place in files:
        path = to / place
        try:
            theirs = path.suffix == ".yaml" and path.exists() and _OURS not in path.read_text(errors="replace")
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror or error}; name another folder with --to") from error
        if theirs:
            raise InputError(f"{path} was not written by challenger-bench; name another folder with --to, or move it")


def _select(
    records: Sequence[RunRecord], drives: Sequence[DriveRecord], name: str
) -> list[tuple[str, RunRecord | DriveRecord]]:
    """Records of a frozen split, else of a data set, each with the planner's name that tells its version apart."""
    every: list[RunRecord | DriveRecord] = [*records, *drives]
    chosen = [record for record in every if _facts(record).frozen_split == name]
    chosen = chosen or [record for record in every if _facts(record).data.name == name]
    if not chosen:
        known = sorted({_facts(record).frozen_split or _facts(record).data.name for record in every})
        raise InputError(
            f"no record is of a frozen split or data set called {name!r}; they are of {', '.join(known) or 'none'}: "
            "name one of these in --hub ORG/NAME"
        )
    ran = [(_facts(record).planner, _facts(record).data.name, _facts(record).split) for record in chosen]
    labels = compute_version_labels(ran)
    return [(label or facts.name, record) for label, (facts, *_), record in zip(labels, ran, chosen, strict=True)]


def _facts(record: RunRecord | DriveRecord) -> Any:
    return record.run if isinstance(record, RunRecord) else record.facts


def _read_result(planner: str, record: RunRecord | DriveRecord, name: str, left_out: list[str]) -> _Result | None:
    """The result of a record, or a sentence why it is none that may stand in a ranking."""
    facts = _facts(record)
    reason = _refuse(record)
    if reason is None:
        task, rate = _measure(record, "" if facts.frozen_split == name else f"_{facts.split}")
        if rate is not None and rate.value is not None:
            return _Result(planner, record, task, rate)
        reason = "has no number for it"
    left_out.append(f"{planner} on {facts.split} {reason}")
    return None


def _refuse(record: RunRecord | DriveRecord) -> str | None:
    facts = _facts(record)
    if is_baseline(facts.planner):
        return "is a baseline, which is ranked nowhere"
    if facts.planner.miniature:
        return "is a miniature, which ranks nothing"
    if not record.covers_split:
        return f"covers {len(facts.scenes)} of {facts.scenes_in_split} scenes; run the rest"
    if not record.complete:
        return f"has {pluralise(record.summary.failed, 'failed plan or drive', 'failed plans or drives')}"
    if not facts.says_truth or (isinstance(record, RunRecord) and NO_NATIVE in record.stale_protocols):
        return "is an older record; run challenger-bench rescore"
    return None


def _measure(record: RunRecord | DriveRecord, of_split: str) -> tuple[HubTask, Rate | None]:
    facts = _facts(record)
    if isinstance(record, RunRecord):
        summary = record.summary.protocols.get(NO_NATIVE)
        measured = f"% of samples without contact by {NO_NATIVE}, mean of 1, 2 and 3 s"
        rate = None if summary is None else summary.columns["collision"]["avg"]
        return HubTask(f"open_loop_{NO_NATIVE}{of_split}", facts.split, measured), rate
    measured, columns = facts.measured, compute_columns(record)
    world = "-".join((measured.engine.replace("@", "-"), measured.agents, measured.sensor))
    # Engine, agents and sensor are names to read by; the rest of a definition tells tasks apart by its hash.
    key = content_key(measured.model_dump(mode="json"))[:6]
    called = re.sub(r"[^\w.-]+", "-", f"closed_loop_{world}-{key}{of_split}", flags=re.ASCII)
    rate = columns.get("contact", columns.get(COLLISION_RATE))
    words = f"% of drives without contact ({measured.world}, sensor {measured.sensor})"
    return HubTask(called, facts.split, words), rate


def _list_tasks(results: Sequence[_Result]) -> list[HubTask]:
    """Tasks, each of one data set's content, one definition and one result a planner."""
    for task in {result.task.id for result in results}:
        of_task = [result for result in results if result.task.id == task]
        contents = sorted({_facts(result.record).data.fingerprint[:12] for result in of_task})
        if len(contents) > 1 or len({result.task for result in of_task}) > 1:
            raise InputError(
                f"results of {task} are of different data sets (contents {', '.join(contents)}); name the folder of "
                "one of them with --records"
            )
        planners = [result.planner for result in of_task]
        if twice := next((planner for planner in planners if planners.count(planner) > 1), None):
            both = " and ".join(str(result.record.directory) for result in of_task if result.planner == twice)
            raise InputError(f"{twice!r} has two results for {task} ({both}); name one folder with --records")
    return sorted({result.task for result in results})


def _folder_of(planner: str, taken: Iterable[str]) -> str:
    folder = sanitise_file_name(planner)
    if not folder or folder in taken or len(folder) > _LONGEST_FILE_NAME:
        raise InputError(f"a planner called {planner[:40]!r} cannot be a folder of results; evaluate it with --name")
    return folder


def _encode_benchmark(hub: str, tasks: Sequence[HubTask]) -> bytes:
    """``eval.yaml``, as the hub's documentation describes it."""
    measured = "; ".join(f"{task.id}: {task.measured}" for task in tasks)
    benchmark = {
        "name": hub.partition("/")[2],
        "description": f"Driving models, measured by challenger-bench {VERSION}. Higher is better. {measured}.",
        "evaluation_framework": "challenger-bench",
        "tasks": [{"id": task.id, "config": "default", "split": task.split} for task in tasks],
    }
    return _encode(benchmark, "Not checked by the hub, which checks it when it is pushed.")


def _encode_entries(results: Sequence[_Result], settings: CardSettings) -> bytes:
    entries = [_build_entry(result, settings) for result in sorted(results, key=lambda result: result.task.id)]
    check_entries(entries)
    return _encode(entries, "For .eval_results/ of the planner's model repository; nothing was uploaded.")


def _build_entry(result: _Result, settings: CardSettings) -> dict[str, Any]:
    assert settings.hub is not None and result.rate.value is not None
    entry: dict[str, Any] = {
        "dataset": {"id": settings.hub, "task_id": result.task.id},
        "value": _share_without(result.rate.value),
    }
    if settings.published is not None:
        entry["date"] = settings.published
    if settings.url is not None:
        organisation = settings.hub.partition("/")[0]
        entry["source"] = {"url": settings.url, "name": "challenger-bench run records", "org": organisation}
    entry["notes"] = "; ".join(_list_notes(result))
    return entry


def _list_notes(result: _Result) -> Iterator[str]:
    """Protocol with its version, interval, counts, content: what a value must not be read without."""
    facts, rate = _facts(result.record), result.rate
    if isinstance(result.record, RunRecord):
        yield f"{NO_NATIVE} v{result.record.summary.protocols[NO_NATIVE].version}"
        counted = pluralise(rate.denominator, "sample")
    else:
        yield f"driving scores v{facts.scoring}"
        counted = pluralise(rate.denominator, "drive")
    recordings = len({facts.scene_facts[scene].source for scene in facts.scenes})
    interval = (
        "no interval"
        if rate.low is None or rate.high is None
        else f"95 % [{_share_without(rate.high):.1f}, {_share_without(rate.low):.1f}]"
    )
    yield f"{interval} over {pluralise(recordings, 'recording')}, {counted}"
    yield f"split sha256:{facts.data.fingerprint[:12]}, record {result.record.content_id}"
    if facts.caveats:
        yield "inputs were missing, see the record"


def _share_without(rate: float) -> float:
    return round(100.0 * (1.0 - rate), 4)


def _encode(value: Any, says: str) -> bytes:
    import yaml

    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=10_000)
    return f"# {_OURS} {VERSION}. {says}\n{text}".encode()
