"""The made-up workspace is one that the readers accept, and the same each time."""

from pathlib import Path

from benchmark.records.rows import find_scene_failures
from benchmark.records.run import find_records
from tests.leaderboard.site.big_workspace import HOSTILE_NAMES, IMAGE_TAG, make_workspace
from tests.leaderboard.site.conftest import Site


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_records_and_sheets_read_back(site: Site) -> None:
    made, records = site.made, site.records
    assert {(record.planner, record.run.split) for record in records} == {
        (planner, split) for planner in made.planners for split in ("adv", "val")
    }
    assert {scene for _, _, scene in site.sheets.scenes} == set(made.scenes) - {made.without_sheet}
    assert IMAGE_TAG in made.planners and set(HOSTILE_NAMES) < set(made.adversarial)
    failures = (find_scene_failures(record.rows, "exact") for record in records if record.run.split == "adv")
    failed = [sum(map(bool, found.values())) for found in failures]
    assert max(failed) > 0 and len(set(failed)) > 1
    assert any(row.status == "failed" for record in records for row in record.rows)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("first", "second"):
        made = make_workspace(tmp_path / folder, 2, 1, samples=8)
    assert (len(made.scenes), len(find_records(tmp_path / "first" / "runs"))) == (2, 2)
    make_workspace(tmp_path / "other", 2, 1, 1, samples=8)
    first = contents(tmp_path / "first")
    assert first == contents(tmp_path / "second") and first != contents(tmp_path / "other")
