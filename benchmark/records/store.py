"""How records are found and read, in any schema, and how their three files are replaced: together or not at all.

New files are first written under pending names, ``run.json`` last; from then on the record is decided and the three are
renamed, ``run.json`` last again. A command that is killed before leaves the old record as it was; one that is killed
between the renames leaves a pending ``run.json``, and `finish_replacement` finishes the renames.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import ValidationError

from benchmark.errors import InputError
from benchmark.machine.storage import (
    file_sha256,
    read_cached_json,
    read_json,
    read_json_lines,
    write_bytes,
    write_json,
    write_json_lines,
    writing_to,
)
from benchmark.records.run_schema import SCHEMA
from benchmark.untrusted.files import RECORD

RUN_FILE, ROWS_FILE, SUMMARY_FILE = "run.json", "samples.jsonl", "summary.json"
DRIVE_FILE: Final = "drive.json"
"""The first file of a record of drives."""


@dataclass(frozen=True, slots=True)
class RecordFileNames:
    """Names of the three files of a record: what ran, which names the hashes of the other two, rows, and summary."""

    head: str
    rows: str
    summary: str


RUN_FILES = RecordFileNames(RUN_FILE, ROWS_FILE, SUMMARY_FILE)

RecordFiles = tuple[dict[str, Any], list[Any], dict[str, Any]]
"""Contents of ``run.json``, ``samples.jsonl`` and ``summary.json``."""


_SAID_OF_MODELS: Final = {
    "unexpected_keyword_argument": "Extra inputs are not permitted",
    "dataclass_type": "Input should be a valid dictionary or instance of {class_name}",
}
"""What pydantic says of dataclasses in other words than of models."""
Value = TypeVar("Value")
Record = TypeVar("Record")


def validate_stored(validate: Callable[[Any], Value], stored: Any, sentence: Callable[[str, str], str]) -> Value:
    """Check a value read from a file, for example with the ``model_validate`` of a model.

    ``sentence`` makes the message from the place of the first fault (empty for the whole) and its cause.
    """
    try:
        return validate(stored)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        known = _SAID_OF_MODELS.get(first["type"])
        said = first["msg"] if known is None else known.format_map(first.get("ctx", {}))
        raise InputError(sentence(where, said.removeprefix("Value error, "))) from error


def read_records(places: Iterable[Path], read: Callable[[Path], Record], *, instead: str = "") -> list[Record]:
    """Read every record that was found, in order; ``instead`` is what a user gets by taking a damaged one away."""
    records = []
    for place in places:
        try:
            records.append(read(place))
        except InputError as damage:
            raise InputError(f"{damage}; you can also delete or move {place}{instead}") from damage
    return records


def pending_path(directory: Path, name: str) -> Path:
    """Path of a file of a record until all three are written."""
    return directory / f".{name}.pending"


def replace_files(
    directory: Path,
    run: Callable[[dict[str, str]], dict[str, Any]],
    rows: list[Any] | bytes,
    summary: dict[str, Any],
    names: RecordFileNames = RUN_FILES,
) -> dict[str, str]:
    """Write the files of a record in place of those that are there, and return their SHA-256 by name.

    No other process may write to the directory (`benchmark.machine.storage.lock_folder`). ``run`` makes ``run.json``
    from the SHA-256 of the other files; ``rows`` are values, or bytes as they are written.
    """
    finish_replacement(directory, names)
    if isinstance(rows, bytes):
        write_bytes(pending_path(directory, names.rows), rows)
    else:
        write_json_lines(pending_path(directory, names.rows), rows)
    write_json(pending_path(directory, names.summary), summary)
    hashes = {name: file_sha256(pending_path(directory, name)) for name in (names.rows, names.summary)}
    write_json(pending_path(directory, names.head), run(hashes))
    _rename(directory, names)
    return hashes


def finish_replacement(directory: Path, names: RecordFileNames = RUN_FILES) -> None:
    """Finish a replacement that was decided when its command died, else drop it; no other process may write there."""
    if _is_decided(directory, names):
        _rename(directory, names)
    with writing_to(directory):
        for path in (*directory.glob(".*.pending"), *directory.glob(".*.part")):
            path.unlink()


def _is_decided(directory: Path, names: RecordFileNames) -> bool:
    """Whether a pending ``run.json`` and the files that it names are all there, renamed already or not."""
    run = read_cached_json(pending_path(directory, names.head))
    hashes = run.get("files") if isinstance(run, dict) else None
    if not isinstance(hashes, dict):
        return False
    newest = {
        name: next((path for path in (pending_path(directory, name), directory / name) if path.is_file()), None)
        for name in (names.rows, names.summary)
    }
    return all(path is not None and file_sha256(path) == hashes.get(name) for name, path in newest.items())


def _rename(directory: Path, names: RecordFileNames) -> None:
    with writing_to(directory):
        for name in (names.rows, names.summary, names.head):
            if pending_path(directory, name).exists():
                pending_path(directory, name).replace(directory / name)


def stored_schema(directory: Path) -> int:
    """Number of the schema in which a record is stored; a newer one, or one that never existed, is refused."""
    return int(stored_head(directory)["schema"])


def read_rows_and_summary(
    directory: Path, head: dict[str, Any], names: RecordFileNames, again: str
) -> tuple[list[Any], Any]:
    """Read the rows and the summary that the head of a record names; only hashes and the form of JSON are checked.

    ``head`` is its first file, ``again`` the command that makes such records.
    """
    rows, summary = read_json_lines(directory / names.rows, RECORD), read_json(directory / names.summary, RECORD)
    require_matching_hashes(directory, head, names, again)
    return rows, summary


def require_matching_hashes(
    directory: Path,
    head: dict[str, Any],
    names: RecordFileNames = RUN_FILES,
    again: str = "eval",
    known: Collection[str] = (),
) -> None:
    """Refuse rows and a summary that are not those that the head of a record names.

    ``again`` is the command that makes such records; files in ``known`` are sound already.
    """
    for name in (names.rows, names.summary):
        if name not in known and file_sha256(directory / name) != head["files"].get(name):
            raise InputError(_does_not_belong(directory, name, names, again))


def read_files(directory: Path) -> RecordFiles:
    """Read the files of a record in the present schema; only schema, hashes and the form of JSON are checked."""
    run = stored_head(directory)
    rows, summary = read_rows_and_summary(directory, run, RUN_FILES, "eval")
    for schema in range(run["schema"], SCHEMA):
        run, rows, summary = UPGRADES[schema](run, rows, summary)
    return run, rows, summary


def stored_head(directory: Path) -> dict[str, Any]:
    """Contents of ``run.json``, of any schema that this version reads; checked for schema and hashes' presence."""
    run = read_json(directory / RUN_FILE, RECORD)
    if not isinstance(run, dict) or type(run.get("schema")) is not int or not isinstance(run.get("files"), dict):
        raise InputError(f"{directory / RUN_FILE} is not a run record: it has no schema number or no hashes of files")
    if run["schema"] > SCHEMA:
        raise InputError(
            f"{directory} has record schema {run['schema']}, this version reads up to {SCHEMA}; upgrade "
            "challenger-bench"
        )
    if run["schema"] not in {SCHEMA, *UPGRADES}:
        raise InputError(f"{directory} has record schema {run['schema']}, which never existed; run eval again")
    return run


def _does_not_belong(directory: Path, name: str, names: RecordFileNames, again: str) -> str:
    if pending_path(directory, names.head).is_file():
        command = "challenger-bench rescore" if names is RUN_FILES else f"the same {again} command"
        return f"{directory} was being replaced when its command was stopped; run {command} again"
    return (
        f"{directory / name} does not belong to the {names.head} beside it (an interrupted or edited run); run the "
        f"same {again} command again"
    )


Upgrade = Callable[[dict[str, Any], list[Any], dict[str, Any]], RecordFiles]


def _from_schema_1(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> RecordFiles:
    """Schema 2 only adds fields, and those have defaults that say "unknown"."""
    return {**run, "schema": 2}, rows, {**summary, "schema": 2}


def _from_schema_2(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> RecordFiles:
    """Schema 3 adds driving scores, which are absent until they are computed."""
    return {**run, "schema": 3}, rows, {**summary, "schema": 3}


def _from_schema_3(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> RecordFiles:
    """Schema 4 only adds fields, and those have defaults that say "unknown"."""
    return {**run, "schema": 4}, rows, {**summary, "schema": 4}


def _from_schema_4(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> RecordFiles:
    """Schema 5 only adds fields, and those have defaults that say "unknown"."""
    return {**run, "schema": 5}, rows, {**summary, "schema": 5}


def _from_schema_5(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> RecordFiles:
    """Schema 6 only adds fields, and those have defaults that say "unknown"."""
    return {**run, "schema": 6}, rows, {**summary, "schema": 6}


UPGRADES: dict[int, Upgrade] = {
    1: _from_schema_1,
    2: _from_schema_2,
    3: _from_schema_3,
    4: _from_schema_4,
    5: _from_schema_5,
}
"""From a schema to the next one: run, rows and summary in, the same out. Old records load for ever."""


@dataclass(frozen=True, slots=True, order=True)
class RecordIdentity:
    """Data set, split and planner of one record."""

    data: str
    split: str
    planner: str


def list_record_places(folders: Iterable[Path], head: str = RUN_FILE) -> list[tuple[RecordIdentity, Path]]:
    """Each record below folders, which need not exist: data, split and planner, and its directory, sorted.

    A damaged record is left out: reading it says so. ``head`` is the first file of a record.
    """
    places = []
    for folder in folders:
        for path in folder.rglob(head):
            stored: Any = read_cached_json(path)
            try:
                identity = RecordIdentity(stored["data"]["name"], stored["split"], stored["planner"]["name"])
            except (KeyError, TypeError):
                continue
            places.append((identity, path.parent))
    return sorted(places)


def list_recorded(folders: Iterable[Path]) -> tuple[RecordIdentity, ...]:
    """Data, split and planner of each record below folders, sorted, each once, as of `list_record_places`."""
    return tuple(dict.fromkeys(identity for identity, _ in list_record_places(folders)))


def find_record_with_samples(folders: Iterable[Path], samples: Sequence[tuple[str, ...]]) -> RecordIdentity | None:
    """The first record that has some samples (token, or scene and time), which a plan file seems to be for."""
    for folder in folders:
        for path in sorted(folder.rglob(ROWS_FILE)):
            with path.open(encoding="utf-8", errors="replace") as lines:
                if any(all(part in line for part in sample) for line in lines for sample in samples):
                    return next(iter(list_recorded([path.parent])), None)
    return None


def describe_recorded(found: Iterable[RecordIdentity]) -> str:
    """Records in words: ``there are records of demo (adv: idm; val: idm)``, or that there are none."""
    places: dict[str, dict[str, list[str]]] = {}
    for record in found:
        places.setdefault(record.data, {}).setdefault(record.split, []).append(record.planner)
    if not places:
        return "no run records found"
    named = []
    for data, splits in places.items():
        ran = "; ".join(f"{split}: {', '.join(planners)}" for split, planners in splits.items())
        named.append(f"{data} ({ran})")
    return f"found records of {', '.join(named)}"
