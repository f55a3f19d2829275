"""Records and frozen splits that earlier versions wrote load, say what they said, and are judged anew."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.machine.storage import file_sha256
from benchmark.metrics.drive_effect import KM_PER_INCIDENT, collect_drive_effects
from benchmark.records import drive_schema, run_schema
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord, load_record, summarise_rows
from benchmark.runs.rescoring import rescore
from benchmark.runs.rescoring_drives import rescore_drives
from generation.splits import format as frozen_format
from generation.splits.building import build_frozen
from generation.splits.format import read_frozen
from generation.splits.packaged import read_frozen_split
from tests.benchmark.runs import test_encounters
from tests.generation.splits.frozen_files import BUILT, recordings
from tests.promise.make_formats import WINDOWS, make_drives, make_drives_of_windows, make_run, short_road

KEPT = Path(__file__).resolve().parent / "kept" / "formats"
RUNS, DRIVES, FROZEN = (sorted(KEPT.glob(pattern)) for pattern in ("run-*", "drives-*", "frozen-*.json"))


def test_the_present_format_of_each_is_kept_and_all_before_it() -> None:
    golden = {path.name for path in (KEPT.parents[2] / "golden" / "records").iterdir()}
    assert "schema-1" in golden
    assert {path.name for path in RUNS} == {f"run-{schema}" for schema in range(2, run_schema.SCHEMA + 1)}
    assert {f"drives-{schema}" for schema in range(1, drive_schema.SCHEMA + 1)} <= {path.name for path in DRIVES}
    assert {f"frozen-{schema}" for schema in range(1, frozen_format.SCHEMA + 1)} <= {path.stem for path in FROZEN}


@pytest.fixture(scope="module")
def run_of_today(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    record: RunRecord = make_run(tmp_path_factory.mktemp("run"))
    return record


def judged(record: RunRecord) -> list[SampleRow]:
    """Rows without tracebacks, which name lines of the code that ran."""
    return [row.model_copy(update={"error": row.error and "raised"}) for row in record.rows]


@pytest.mark.parametrize("kept", RUNS, ids=lambda path: path.name)
def test_a_run_record_loads_and_its_plans_are_judged_as_they_are_today(
    kept: Path, run_of_today: RunRecord, tmp_path: Path
) -> None:
    old = load_record(kept)
    assert [row.plan for row in old.rows] == [row.plan for row in run_of_today.rows]
    assert old.summary.failed == 1 and old.run.status == "partial"
    said_again = summarise_rows(old.rows, old.run.protocols, seed=old.run.seed, scene_facts=old.run.scene_facts)
    for name, summary in old.summary.protocols.items():
        assert said_again.protocols[name].columns["collision"] == summary.columns["collision"]
    directory = Path(shutil.copytree(kept, tmp_path / "runs"))
    new = rescore(directory, short_road(), protocols=tuple(run_of_today.run.protocols))
    assert judged(new) == judged(run_of_today) and new.summary == run_of_today.summary
    assert load_record(directory) == new and new.stale_protocols == ()
    for name in set(old.run.protocols) - set(old.stale_protocols):
        assert new.summary.protocols[name].columns["collision"] == old.summary.protocols[name].columns["collision"]


@pytest.fixture(scope="module")
def drives_of_today(tmp_path_factory: pytest.TempPathFactory) -> DriveRecord:
    record: DriveRecord = make_drives(tmp_path_factory.mktemp("drives"))
    return record


@pytest.mark.parametrize("kept", DRIVES, ids=lambda path: path.name)
def test_a_record_of_drives_loads_and_its_plans_are_driven_as_they_are_today(
    kept: Path, drives_of_today: DriveRecord, tmp_path: Path
) -> None:
    old = load_drives(kept)
    kept_contact, contact = old.rows[0].contact, drives_of_today.rows[0].contact
    assert kept_contact is not None and contact is not None
    # Whose fault it is by right of way older records do not say.
    assert kept_contact == replace(contact, fault=kept_contact.fault)
    assert old.rows[0].plans == drives_of_today.rows[0].plans
    assert old.rows[0].ticks == drives_of_today.rows[0].ticks
    directory = Path(shutil.copytree(kept, tmp_path / "drives"))
    new = rescore_drives(directory, short_road())
    assert new.rows == drives_of_today.rows and new.summary == drives_of_today.summary
    assert load_drives(directory) == new


@pytest.fixture(scope="module")
def windows_of_today(tmp_path_factory: pytest.TempPathFactory) -> list[DriveRecord]:
    return [*make_drives_of_windows(tmp_path_factory.mktemp("windows"))]


@pytest.mark.parametrize("schema", range(1, drive_schema.SCHEMA + 1))
def test_drives_of_a_window_load_are_paired_and_driven_as_they_are_today(
    schema: int, windows_of_today: list[DriveRecord], tmp_path: Path
) -> None:
    names = [f"{kind}-{schema}" for kind in WINDOWS]
    old = [load_drives(KEPT / name) for name in names]
    (effect,), (effect_of_today,) = collect_drive_effects(old), collect_drive_effects(windows_of_today)
    of_fault = {name for row in old[0].rows if not row.says_fault for name in ("at_fault", KM_PER_INCIDENT)}
    told = [each for each in effect_of_today.effects if each.measure not in of_fault]
    assert [each for each in effect.effects if each.measure not in of_fault] == told and effect.unpaired == 0
    for name, today, source in zip(
        names, windows_of_today, (test_encounters.data(), test_encounters.RECORDED), strict=True
    ):
        directory = Path(shutil.copytree(KEPT / name, tmp_path / name))
        new = rescore_drives(directory, source)
        assert new.rows == today.rows and new.summary == today.summary
        assert new.facts.measured == today.facts.measured and load_drives(directory) == new


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return recordings(tmp_path_factory.mktemp("recorded"))


@pytest.mark.parametrize("kept", FROZEN, ids=lambda path: path.stem)
def test_a_frozen_split_reads_keeps_its_bytes_and_builds_the_scenes_that_were_frozen(
    kept: Path, source: DataSet, tmp_path: Path
) -> None:
    frozen = read_frozen(kept)
    assert frozen.text() == kept.read_text()
    one = replace(BUILT, out=tmp_path / "built", renderer=None, scenes=(frozen.scenes[0].name,))
    report = build_frozen(source, read_frozen_split(kept), one)
    assert report.written == (frozen.scenes[0].name,) and report.other_tables == ()
    assert open_data(tmp_path / "built").scene_names("adv") == report.written


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("mini-adv-1", "41638a573a31416982d01ef5b414f8cd1dab3d44354196ae5ea0abd2cee7c74c"),
        ("mini-adv-2", "1c6293806e16f5bc0a69f5911dea878bbfbdcb4efec40ca9f0591c4ea96debe2"),
        ("mini-adv-3", "d7492cdc1ed8dfc197d66fc9aaf20cbbf70a5df6507c693121faeb924c418b7c"),
        ("mini-adv-4", "30ebec4491946353621a9fe8ff0c26fd3bef6a898bcb754a2cf065e1a1e85f82"),
        ("mini-adv-5", "2c186868fffbf562c5b9e5a682a60814ed4d0d4c7b199aea893d6102b449e244"),
    ],
)
def test_frozen_splits_that_came_with_a_version_never_change(name: str, content: str) -> None:
    file = Path(frozen_format.__file__).parent / f"{name}.json"
    assert file_sha256(file) == content, "a frozen split is for ever: give a changed one the next number"
