"""What is kept of a record that was read before: the same record with it, without it, and whatever became of it."""

import hashlib
import json
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa
import pytest

from benchmark.errors import InputError
from benchmark.machine.cached_arrays import find_cache_file, read_batch, write_batch
from benchmark.machine.storage import file_sha256
from benchmark.records import rows as stored_rows
from benchmark.records import run
from benchmark.records.columns import LINES, RowColumns, build_batch
from benchmark.records.rows import SampleRows, find_scene_failures
from benchmark.records.run import RunRecord, find_records, load_record, write_record
from tests.benchmark.records.hand_made_records import facts_of

Loaded = Callable[[], tuple[RunRecord, int]]


@pytest.fixture
def record(real: RunRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a record of which nothing is kept yet, small as it is."""
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(stored_rows, "WORTH_BYTES", 1)
    folder = tmp_path / "record"
    folder.mkdir()
    for name in ("samples.jsonl", "summary.json", "run.json"):
        (folder / name).write_bytes((real.directory / name).read_bytes())
    return folder


@pytest.fixture
def kept(record: Path) -> Path:
    """The file in the cache."""
    found = find_cache_file("records", record / "samples.jsonl")
    assert found is not None
    return found


@pytest.fixture
def loaded(record: Path, monkeypatch: pytest.MonkeyPatch) -> Loaded:
    """Loads the record; gives it, and how many lines were parsed."""
    parsed: list[int] = []
    parse = run._row

    def counted(*given: object, plain: bool) -> object:
        parsed.append(1)
        return parse(*given, plain=plain)  # type: ignore[arg-type]

    monkeypatch.setattr(run, "_row", counted)

    def load() -> tuple[RunRecord, int]:
        parsed.clear()
        return load_record(record), len(parsed)

    return load


def test_the_second_reading_parses_nothing_and_says_the_same(loaded: Loaded, record: Path, real: RunRecord) -> None:
    before = sorted(path.name for path in record.iterdir())
    (first, parsed), (second, parsed_again) = loaded(), loaded()
    assert (parsed, parsed_again) == (len(real.rows), 0)
    assert first == second and list(second.rows) == list(real.rows) and first.content_id == second.content_id
    assert list(SampleRows.of(second.rows).lines()) == list(SampleRows.of(real.rows).lines())
    assert sorted(path.name for path in record.iterdir()) == before
    plain = RowColumns(list(real.rows))
    assert second.columns.brief == plain.brief == plain.brief_at(range(len(plain)))
    for name in real.run.protocols:
        assert second.columns.outcomes(name).as_rows() == plain.outcomes(name).as_rows()
        assert find_scene_failures(second.rows, name) == find_scene_failures(real.rows, name)
    assert second.rows_of(real.run.scenes[-1]) == real.rows_of(real.run.scenes[-1])
    made = build_batch(list(real.rows))
    assert made is not None
    found = second.columns.batch.select(made.schema.names)
    # NaN is equal to NaN here.
    assert found.schema == made.schema and repr(found.to_pydict()) == repr(made.to_pydict())
    for values in (second.columns.in_lidar, second.columns.planned, second.columns.outcomes("exact").l2):
        assert not values.flags.writeable


def test_writing_a_record_keeps_it_for_who_reads_it_next(loaded: Loaded, record: Path, real: RunRecord) -> None:
    write_record(record, facts_of(real.run), list(real.rows), real.run.protocols, seed=real.run.seed)
    again, parsed = loaded()
    assert parsed == 0 and list(again.rows) == list(real.rows) and again.content_id == real.content_id


def test_rows_that_were_edited_are_refused_as_without(loaded: Loaded, record: Path) -> None:
    loaded()
    path = record / "samples.jsonl"
    path.write_text(path.read_text().replace('"command":', '"command": ', 1))
    with pytest.raises(InputError, match="does not belong to the run"):
        loaded()
    path.unlink()
    with pytest.raises(InputError, match="cannot read"):
        loaded()


def test_rows_that_took_the_place_of_others_are_read(loaded: Loaded, record: Path, real: RunRecord) -> None:
    loaded()
    rows = [row.model_copy(update={"command": 1 - min(row.command, 1)}) for row in real.rows]
    assert rows != list(real.rows)
    lines = "".join(f"{line}\n" for line in SampleRows.of(rows).lines())
    (record / "samples.jsonl").write_text(lines)
    head = json.loads((record / "run.json").read_text())
    head["files"]["samples.jsonl"] = file_sha256(record / "samples.jsonl")
    (record / "run.json").write_text(json.dumps(head))
    (first, parsed), (second, parsed_again) = loaded(), loaded()
    assert (parsed, parsed_again) == (len(rows), 0)
    assert list(first.rows) == rows == list(second.rows)


@pytest.mark.parametrize("damage", [lambda data: data[:-9], lambda data: data[:-9] + b"somewhere", lambda data: b""])
def test_a_damaged_file_is_made_again(loaded: Loaded, kept: Path, damage: Callable[[bytes], bytes]) -> None:
    loaded()
    whole = kept.read_bytes()
    kept.write_bytes(damage(whole))
    (first, parsed), (second, parsed_again) = loaded(), loaded()
    assert parsed == len(first.rows) and parsed_again == 0 and first == second
    assert kept.read_bytes() == whole


def forged(kept: Path, batch: pa.RecordBatch | bytes) -> None:
    """A file in the cache that fits the rows and has its own hash, but was not made from them."""
    head = json.loads(kept.read_bytes().partition(b"\n")[0])
    # Others have the former one open.
    kept.unlink()
    if isinstance(batch, bytes):
        head["sha256"] = hashlib.sha256(batch).hexdigest()
        kept.write_bytes(json.dumps(head).encode() + b"\n" + batch)
    else:
        assert write_batch(kept, Path(head["source"]), head["made_of"], batch)


def beyond(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Values that are said to lie where there are none."""
    at = batch.schema.get_field_index("scene")
    codes = pa.array([1 << 20] * len(batch), pa.int32())
    column = pa.DictionaryArray.from_arrays(codes, batch.column(at).dictionary, safe=False)
    return batch.set_column(at, "scene", column)


@pytest.mark.parametrize(
    "made",
    [
        lambda batch: b"", lambda batch: b"ARROW1\0\0 and nothing else", lambda batch: pickle.dumps(batch),
        lambda batch: batch.drop_columns([LINES]), lambda batch: batch.drop_columns(["scene"]),
        lambda batch: batch.append_column("more", pa.array([{"a": 1}] * len(batch))), beyond,
    ],
)  # fmt: skip
def test_a_file_that_fits_but_was_not_made_from_rows_is_made_again(
    loaded: Loaded, kept: Path, made: Callable[[pa.RecordBatch], pa.RecordBatch | bytes]
) -> None:
    first, _ = loaded()
    whole = kept.read_bytes()
    batch = read_batch(kept, json.loads(whole.partition(b"\n")[0])["made_of"])
    assert batch is not None and LINES in batch.schema.names
    forged(kept, made(batch))
    second, parsed = loaded()
    assert parsed == len(first.rows) and first == second
    assert kept.read_bytes() == whole


PROGRAM = """
import sys
from pathlib import Path
from benchmark import evaluation
from benchmark.records import rows, run
assert "pyarrow" not in sys.modules
rows.WORTH_BYTES = 1
for _ in range(2):
    record = run.load_record(Path(sys.argv[1]))
    assert record.columns.brief and record.columns.outcomes("exact").facts
assert "pyarrow" in sys.modules and "pandas" not in sys.modules
"""


def test_arrow_is_imported_for_columns_alone_and_does_not_bring_pandas_along(record: Path, kept: Path) -> None:
    subprocess.run([sys.executable, "-c", PROGRAM, record], cwd=Path(__file__).parents[3], check=True)
    assert kept.is_file()


def test_other_code_reads_again(loaded: Loaded, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded()
    monkeypatch.setattr(stored_rows, "_checks_key", lambda: "those of another version")
    again, parsed = loaded()
    assert parsed == len(again.rows)


def test_a_cache_that_cannot_be_written_to_is_done_without(loaded: Loaded, kept: Path) -> None:
    kept.parent.parent.mkdir(exist_ok=True)
    kept.parent.write_text("no folder")
    for _ in range(2):
        again, parsed = loaded()
        assert parsed == len(again.rows)


def test_two_who_keep_the_same_at_once_leave_a_whole_file(loaded: Loaded, record: Path, kept: Path) -> None:
    first, _ = loaded()
    whole = kept.read_bytes()
    kept.unlink()
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(load_record, [record] * 8))
    assert all(each == first for each in found)
    assert kept.read_bytes() == whole and list(kept.parent.iterdir()) == [kept]


def test_workers_keep_what_is_new_and_leave_what_is_damaged(
    record: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored_rows, "WORTH_WORKERS_BYTES", 1)
    monkeypatch.setattr(stored_rows, "default_workers", lambda: 2)
    # Workers have modules of their own, for which only long rows are worth it.
    rows = record / "samples.jsonl"
    head = json.loads((record / "run.json").read_text())
    many = rows.read_bytes() * (1 + (1 << 22) // rows.stat().st_size)
    head["files"]["samples.jsonl"] = hashlib.sha256(many).hexdigest()
    folders = [tmp_path / "all" / name for name in "ab"]
    for folder in folders:
        shutil.copytree(record, folder)
        (folder / "samples.jsonl").write_bytes(many)
        (folder / "run.json").write_text(json.dumps(head))
    (folders[1] / "samples.jsonl").write_bytes(many + b"{}")
    with pytest.raises(InputError, match="does not belong to the run"):
        find_records(tmp_path / "all")
    (folders[1] / "samples.jsonl").write_bytes(many)
    found = find_records(tmp_path / "all")
    parsed: list[int] = []
    monkeypatch.setattr(run, "_row", lambda *given, **more: parsed.append(1))
    assert find_records(tmp_path / "all") == found and not parsed
    assert len(found) == 2 and len(list((tmp_path / "cache" / "records").iterdir())) == 2


def test_small_records_are_not_kept(loaded: Loaded, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_rows, "WORTH_BYTES", 1 << 22)
    loaded()
    assert not kept.exists()


def test_what_is_kept_of_records_that_are_gone_is_removed(loaded: Loaded, record: Path, kept: Path) -> None:
    loaded()
    moved = record.rename(record.parent / "moved")
    assert kept.is_file()
    load_record(moved)
    assert not kept.exists() and find_cache_file("records", moved / "samples.jsonl").is_file()  # type: ignore[union-attr]


def test_a_kept_record_goes_to_another_process(loaded: Loaded, real: RunRecord) -> None:
    loaded()
    sent = pickle.loads(pickle.dumps(loaded()[0]))  # noqa: S301
    assert list(sent.rows) == list(real.rows)
    assert sent.columns.brief == RowColumns(list(real.rows)).brief
