"""Cards of data sets and of results: what stands in them is what the data say, and nothing of the machine."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.constants import VERSION
from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.datasets.split_names import BORROWED_NAMES
from benchmark.errors import InputError
from benchmark.extensions.cards.croissant import IndexColumn
from benchmark.extensions.cards.data_card import SCENE_COLUMNS, scene_rows, write_data_card
from benchmark.extensions.cards.records_card import RATE_COLUMNS, rate_rows, write_records_card
from benchmark.extensions.cards.writing import CITE, CardSettings, find_size_category, format_front_matter
from benchmark.published import PAPER
from benchmark.records.drives import DriveRecord, compute_columns, load_drives
from benchmark.records.run import RunRecord, load_record
from benchmark.records.run_schema import SceneFacts
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.fake_data import FakeData, town_of_two

GOLDEN = Path(__file__).resolve().parents[3] / "golden" / "records"
DRIVES = Path(__file__).resolve().parents[3] / "promise" / "kept" / "formats" / "drives-1"
KINDS = {"text": str, "count": int, "number": int | float, "truth": bool}
WHOLE = CardSettings("Two <roads>", "cc-by-nc-sa-4.0", "https://example.org/x", "2026-01-31", "A lab")


class Made(FakeData):
    """Says how it was made: of other recordings, with an adversary, drawn."""

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        return {name: build_scene_facts(name, self.provenance()["scenes"][name]) for name in names}

    def provenance(self) -> dict[str, Any]:
        labels = {"manoeuvre": "cut-in-left", "place": "junction", "closest_approach": {"gap_m": 0.5}}
        entry = {"adversaries": ["a"], "source_scene": "scene-0001", "report": {"labels": labels}}
        return {
            "source": {"name": "a | b", "fingerprint": "f" * 64},
            "renderer": {"name": "schematic"},
            "frozen": {"name": "road-adv-1"},
            "scenes": dict.fromkeys(self.scenes, entry),
        }


def records() -> list[RunRecord]:
    return [load_record(GOLDEN / name) for name in ("schema-1", "schema-3-adv")]


def drives() -> list[DriveRecord]:
    return [load_drives(DRIVES)]


@pytest.fixture
def without_parquet(monkeypatch: pytest.MonkeyPatch) -> None:
    """The index as JSON, whose bytes are those of every pyarrow."""

    def write(path: Path, columns: Sequence[IndexColumn], rows: Sequence[Mapping[str, Any]]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps([[row[column.name] for column in columns] for row in rows]))

    monkeypatch.setattr("benchmark.extensions.cards.writing.write_index", write)


def head_of(page: str) -> dict[str, Any]:
    _, head, _ = page.split("---\n", 2)
    return {name: json.loads(value) for name, _, value in (line.partition(": ") for line in head.splitlines())}


@pytest.mark.parametrize("data", [town_of_two(), Made(town_of_two().scenes)], ids=["recorded", "made"])
def test_every_scene_is_a_row_and_every_value_of_its_columns_kind(data: FakeData) -> None:
    rows = list(scene_rows(data))
    assert [row["scene"] for row in rows] == list(data.scene_names())
    for row in rows:
        assert set(row) == {column.name for column in SCENE_COLUMNS}
        for column in SCENE_COLUMNS:
            value = row[column.name]
            assert value is None or isinstance(value, KINDS[column.kind]), column.name
            assert value is None or isinstance(value, bool) == (column.kind == "truth"), column.name
    first = rows[0]
    assert (first["samples"], first["frames"], first["ego_mean_m_s"], first["vehicles"]) == (16, 96, 8.0, 3)
    assert first["ego_metres"] == pytest.approx(8.0 * first["seconds"], abs=1e-3) and first["review"] == "not reviewed"
    made = isinstance(data, Made)
    assert (first["place"], first["closest_gap_m"]) == (("junction", 0.5) if made else (None, None))


def test_labels_of_a_strangers_file_that_are_no_labels_are_no_values() -> None:
    class Strange(FakeData):
        def provenance(self) -> dict[str, Any]:
            labels = {"place": 3, "closest_approach": {"gap_m": "near"}}
            return {"scenes": {name: {"report": {"labels": labels}} for name in self.scenes}}

    assert {(row["place"], row["closest_gap_m"]) for row in scene_rows(Strange(town_of_two().scenes))} == {(None, None)}


def test_a_row_is_a_rate_of_a_record_and_none_is_left_out() -> None:
    rows = list(rate_rows(records(), drives()))
    assert all(set(row) == {column.name for column in RATE_COLUMNS} for row in rows)
    expected = sum(len(compute_columns(drive)) for drive in drives())
    for summary in (record.summary for record in records()):
        columns = [found.columns for found in summary.protocols.values()]
        columns += [] if summary.driving is None else [summary.driving.columns]
        expected += sum(len(horizons) for of_protocol in columns for horizons in of_protocol.values())
    assert len(rows) == expected
    record = records()[1]
    of_exact = [row for row in rows if (row["record"], row["protocol"]) == (record.content_id, "exact")]
    found = next(row for row in of_exact if (row["column"], row["horizon"]) == ("collision", "3s"))
    rate = record.summary.protocols["exact"].columns["collision"]["3s"]
    assert (found["value"], found["numerator"], found["denominator"]) == (rate.value, rate.numerator, rate.denominator)
    assert {row["loop"] for row in rows} == {"open", "closed"} and found["frozen_split"] == "mini-adv-2"


@pytest.mark.path
@pytest.mark.usefixtures("without_parquet")
def test_the_page_says_what_the_data_say_and_escapes_what_strangers_wrote(tmp_path: Path) -> None:
    data = Made(town_of_two().scenes)
    written = write_data_card(data, tmp_path, WHOLE)
    page = (tmp_path / "README.md").read_text()
    head = head_of(page)
    assert head["license"] == "cc-by-nc-sa-4.0" and head["size_categories"] == ["n<1K"]
    assert head["configs"][0]["data_files"] == [{"split": "index", "path": "scenes.parquet"}]
    assert "# Two &lt;roads&gt;" in page and "a \\| b" in page and "road-adv-1" in page
    assert "| manoeuvres of the first adversaries | cut-in-left 2 |" in page and f"`{data.fingerprint()}`" in page
    assert "not taken by a camera" in page and "Recorded road users do not react" in page
    assert written.rows == 2
    assert [path.name for path in written.files] == ["README.md", "scenes.parquet", "croissant.json"]
    metadata = json.loads((tmp_path / "croissant.json").read_text())
    assert metadata["license"].endswith("by-nc-sa/4.0/") and metadata["datePublished"] == "2026-01-31"
    assert metadata["name"] == "Two <roads>" and metadata["creator"]["name"] == "A lab"
    assert len([name for name in metadata if name.startswith("rai:")]) >= 10
    fields = metadata["recordSet"][0]["field"]
    assert [field["name"] for field in fields] == [column.name for column in SCENE_COLUMNS]


@pytest.mark.usefixtures("without_parquet")
def test_the_town_is_free_recordings_are_not_and_the_same_bytes_come_twice(tmp_path: Path) -> None:
    data = town_of_two()
    write_data_card(data, tmp_path / "town", embedded=True)
    write_data_card(data, tmp_path / "recorded")
    town, recorded = ((tmp_path / name / "README.md").read_text() for name in ("town", "recorded"))
    assert head_of(town)["license"] == "apache-2.0" and "every road user is synthetic" in town
    assert head_of(recorded)["license"] == "unknown" and "Undecided: the publisher must choose one." in recorded
    assert "license" not in json.loads((tmp_path / "recorded" / "croissant.json").read_text())
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    write_data_card(data, tmp_path / "town", embedded=True)
    write_data_card(data, tmp_path / "recorded")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert not any(str(Path.cwd()).encode() in content or b"/home" in content for content in before.values())


@pytest.mark.usefixtures("without_parquet")
def test_borrowed_names_are_said_to_be_so(tmp_path: Path) -> None:
    class Exported(FakeData):
        def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
            return {name: build_scene_facts(name, {"source_scene": "scene-0061", "adversaries": []}) for name in names}

        def provenance(self) -> dict[str, Any]:
            return {"split": BORROWED_NAMES, "source": {"name": "town", "fingerprint": "f" * 64}, "scenes": {}}

    write_data_card(Exported(town_of_two().scenes), tmp_path)
    page = (tmp_path / "README.md").read_text()
    assert "An export of town (content ffffffffffff)" in page and "is not that scene" in page
    # Recordings under other names are recordings, and no command takes the root.
    assert "worst cases" not in page and "Evaluate a planner on it" not in page


@pytest.mark.usefixtures("without_parquet")
def test_a_data_set_is_called_by_its_frozen_split_and_never_by_a_folder_of_the_cache(tmp_path: Path) -> None:
    cached = FakeData(town_of_two().scenes, name="boston-0123456789ab")
    for data, name in ((Made(town_of_two().scenes), "road-adv-1"), (cached, "boston")):
        write_data_card(data, tmp_path / name)
        assert head_of((tmp_path / name / "README.md").read_text())["pretty_name"] == name
        assert len(json.loads((tmp_path / name / "croissant.json").read_text())["datePublished"]) == 10


@pytest.mark.usefixtures("without_parquet")
def test_results_are_a_card_too(tmp_path: Path) -> None:
    written = write_records_card(records(), drives(), tmp_path, CardSettings(licence="my-own-terms"))
    page = (tmp_path / "README.md").read_text()
    head = head_of(page)
    assert (head["license"], head["license_name"]) == ("other", "my-own-terms")
    assert "| open | failing | fake | val | 32 |" in page and "| closed | straight | short | val | 1 |" in page
    assert written.rows == len(list(rate_rows(records(), drives())))
    with pytest.raises(InputError, match="no records with numbers"):
        write_records_card([], [], tmp_path)


@pytest.mark.usefixtures("without_parquet")
def test_nothing_that_somebody_wrote_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("# My project\n")
    with pytest.raises(InputError, match="not a card written by challenger-bench"):
        write_data_card(town_of_two(), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["README.md"]
    with pytest.raises(InputError, match="has no scenes to describe"):
        write_data_card(FakeData({}), tmp_path / "empty")


def test_wrong_settings_are_one_sentence() -> None:
    wrong: dict[str, tuple[str, str]] = {
        "licence": ("all rights, reserved", "is not a licence identifier"),
        "url": ("javascript:alert(1)", "--url must begin with http"),
        "published": ("yesterday", "--published must be a day"),
        "title": ("two\nlines", "--title must be one line"),
        "creator": (" ", "--creator must be one line"),
    }
    for name, (value, says) in wrong.items():
        changes: dict[str, Any] = {name: value}
        with pytest.raises(InputError, match=says):
            replace(CardSettings(), **changes)


def test_heads_leave_out_what_is_not_there_and_hubs_read_them() -> None:
    head = format_front_matter({"a": 'x: "y"', "b": None, "c": [], "d": False})
    assert head == '---\na: "x: \\"y\\""\nd: false\n---\n'
    assert [find_size_category(count) for count in (0, 999, 1000, 10**6)] == ["n<1K", "n<1K", "1K<n<10K", "n>1M"]
    yaml = pytest.importorskip("yaml")
    said = {"pretty_name": "a: 'b' \u00e4 # c", "tags": ["x", "y: z"], "configs": [{"default": True}]}
    assert yaml.safe_load(format_front_matter(said).split("---\n")[1]) == said


def test_the_index_reads_back(tmp_path: Path) -> None:
    from pyarrow import parquet

    data = Made(town_of_two().scenes)
    write_data_card(data, tmp_path, WHOLE)
    table = parquet.read_table(tmp_path / "scenes.parquet")
    assert table.column_names == [column.name for column in SCENE_COLUMNS]
    assert table.to_pylist() == list(scene_rows(data))
    before = (tmp_path / "scenes.parquet").read_bytes()
    write_data_card(data, tmp_path, WHOLE)
    assert (tmp_path / "scenes.parquet").read_bytes() == before


@pytest.mark.path
def test_the_commands_write_cards(tmp_path: Path) -> None:
    done = run_here("leaderboard", "card", "--records", GOLDEN / "schema-3-adv", "--to", tmp_path / "card", "--json")
    assert done.code == 0 and "is undecided; set it with" in done.err
    assert json.loads(done.out)["rows"] > 50 and (tmp_path / "card" / "rates.parquet").is_file()
    refused = run_here("data", "card", tmp_path, "--to", tmp_path / "card")
    assert refused.code == 2


@pytest.mark.filterwarnings("ignore")
def test_mlcroissant_accepts_the_metadata_and_reads_the_rows(tmp_path: Path) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    write_data_card(Made(town_of_two().scenes), tmp_path / "data", WHOLE)
    write_records_card(records(), drives(), tmp_path / "records", WHOLE)
    for folder, rows, count in (("data", "scenes", 2), ("records", "rates", len(list(rate_rows(records(), drives()))))):
        read = mlcroissant.Dataset(jsonld=tmp_path / folder / "croissant.json")
        assert not read.metadata.ctx.issues.errors and not read.metadata.ctx.issues.warnings
        assert read.metadata.personal_sensitive_information and read.metadata.data_limitations
        assert sum(1 for _ in read.records(rows)) == count
    broken = json.loads((tmp_path / "data" / "croissant.json").read_text())
    broken["recordSet"][0]["field"][0]["source"]["fileObject"]["@id"] = "nowhere"
    (tmp_path / "broken.json").write_text(json.dumps(broken))
    shutil.copy(tmp_path / "data" / "scenes.parquet", tmp_path)
    with pytest.raises(mlcroissant.ValidationError):
        mlcroissant.Dataset(jsonld=tmp_path / "broken.json")


def test_the_citation_names_this_version_and_the_paper() -> None:
    yaml = pytest.importorskip("yaml")
    said = yaml.safe_load((Path(__file__).resolve().parents[4] / "CITATION.cff").read_text())
    assert (said["version"], said["license"]) == (VERSION, "Apache-2.0")
    assert said["authors"] == [{"name": "The challenger-bench contributors"}]
    preferred = said["preferred-citation"]
    assert preferred["title"] == PAPER and preferred["url"] in CITE and str(preferred["year"]) in CITE
    first = preferred["authors"][0]
    assert CITE.startswith(f"{first['given-names']} {first['family-names']}, ") and len(preferred["authors"]) == 10
