"""The made-up workspace is one that the readers accept, and the same each time."""

from pathlib import Path

import pytest

from benchmark.records.rows import find_scene_failures
from benchmark.records.run import find_records
from benchmark.records.scene_pages import find_scene_pages
from tests.leaderboard.site.big_workspace import HOSTILE_NAMES, IMAGE_TAG, make_workspace


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_records_and_sheets_read_back(tmp_path: Path) -> None:
    made = make_workspace(tmp_path, 12, 4, samples=10)
    records, sheets = find_records(tmp_path / "runs"), find_scene_pages(tmp_path / "sheets")
    assert {(record.run.planner.name, record.run.split) for record in records} == {
        (planner, split) for planner in made.planners for split in ("adv", "val")
    }
    assert {scene for _, _, scene in sheets.scenes} == set(made.scenes) - {made.without_sheet}
    assert IMAGE_TAG in made.planners
    assert set(HOSTILE_NAMES) < set(made.adversarial)
    failed = [
        sum(map(bool, find_scene_failures(record.rows, "exact").values()))
        for record in records
        if record.run.split == "adv"
    ]
    assert max(failed) > 0
    assert len(set(failed)) > 1
    assert any(row.status == "failed" for record in records for row in record.rows)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("first", "second"):
        make_workspace(tmp_path / folder, 3, 2, samples=8)
    make_workspace(tmp_path / "other", 3, 2, 1, samples=8)
    first = contents(tmp_path / "first")
    assert first == contents(tmp_path / "second")
    assert first != contents(tmp_path / "other")


@pytest.mark.parametrize(("scenes", "models"), [(2, 1), (3, 11)])
def test_any_size_will_do(tmp_path: Path, scenes: int, models: int) -> None:
    made = make_workspace(tmp_path, scenes, models, samples=8)
    assert len(made.scenes) == scenes
    assert len(set(made.planners)) == models
    assert len(find_records(tmp_path / "runs")) == 2 * models
