"""Table 3: what stands beside what, and that different definitions never share a table."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.extensions.quality.definition import QualityDefinition
from benchmark.records.quality import ExactSum, QualityRecord, SceneQualityRows, SubjectRow, VideoRow, write_quality
from benchmark.records.run_schema import SceneFacts
from leaderboard.build import find_stale_files, write_leaderboard
from leaderboard.extensions.quality.tables import quality_tables
from leaderboard.frame.results import read_results
from tests.leaderboard.tables import test_table_facts as any_table
from tests.leaderboard.tables.test_terminal import fits, shows_its_cells


def rows(scene: str, *, adversary: bool, level: float, size: tuple[int, int]) -> SceneQualityRows:
    where: dict[str, Any] = {"scene": scene, "camera": "CAM_FRONT"}
    seen: dict[str, Any] = {"category": "vehicle.car", "appearances": 3, "returns": 0, "first_us": 0, "last_us": 10**6}
    quality: dict[str, Any] = {"consistency": ExactSum.of([level, level]), "imaging": ExactSum.of([level / 2] * 3)}
    subjects = [
        SubjectRow(**where, **seen, **quality, instance=name, adversary=adversary and name == "a", mean_area_px=2000.0)
        for name in ("a", "b")
    ]
    frames: dict[str, Any] = {"frames": 3, "width": size[0], "height": size[1], "formats": {"jpg": 3}}
    videos = [VideoRow(**where, **frames, imaging=ExactSum.of([level / 4] * 3))]
    return SceneQualityRows(scene=scene, subjects=subjects, videos=videos)


def made(folder: Path, split: str, **changes: Any) -> QualityRecord:
    """A record of two scenes."""
    names = [f"{split}-{index}" for index in range(2)]
    size, unmasked = changes.get("size", (448, 256)), changes.get("unmasked", ())
    scenes = [
        rows(name, adversary=split == "adv", level=0.8 + 0.1 * index, size=size) for index, name in enumerate(names)
    ]
    scenes = [each.model_copy(update={"subjects": []}) if each.scene in unmasked else each for each in scenes]
    described = {
        "data": {"name": "mini", "version": "v1", "fingerprint": "f"},
        "split": split,
        "scenes": names,
        "scenes_in_split": changes.get("scenes_in_split", 2),
        "scene_facts": {name: SceneFacts(source=name, adversaries=int(split == "adv")) for name in names},
        "definition": changes.get("definition", QualityDefinition(masks="boxes")).as_json(),
        "weights": {"dino-vitb16": {"repository": "r", "revision": "v", "content": changes.get("content", "c")}},
        "device": "cpu",
        "environment": {},
    }
    return write_quality(folder / f"{split}-{len(list(folder.glob('*')))}", described, scenes)


def test_splits_stand_in_the_order_of_the_paper_with_its_values_beside(tmp_path: Path) -> None:
    (table,) = quality_tables([made(tmp_path, "adv"), made(tmp_path, "val")])
    cells = [dict(zip(table.columns[:3], row)) for row in table.rows]
    shown = [(cell["split"], cell["subjects"]) for cell in cells]
    assert shown == [("val", "all"), ("adv", "all"), ("adv", "adversary"), ("adv", "others")]
    assert table.name == "quality-boxes" and table.rows[0][2:4] == ("0.8500", "[0.800, 0.900]")
    assert table.rows[0][-2:] == ("0.8349", "0.3801") and table.rows[1][-2:] == ("0.8093", "0.3469")
    assert table.rows[2][-2:] == ("–", "–")
    assert any("448 x 256 pixels, jpg" in note for note in table.notes)
    assert any("Table 3" in source for source in table.sources) and any("Fewer than 20" in note for note in table.notes)


def test_scenes_without_masks_are_said_and_mark_the_rows(tmp_path: Path) -> None:
    (table,) = quality_tables([made(tmp_path, "adv", unmasked=("adv-1",)), made(tmp_path, "val")])
    assert [row[0] for row in table.rows] == ["val", "adv ¶", "adv ¶", "adv ¶"]
    assert [note for note in table.notes if note.startswith("¶")] == [
        f"¶ adv: 1 of 2 scenes have no mask of {what} from boxes: they are in none of its numbers."
        for what in ("a vehicle", "an adversary")
    ]


def test_what_does_not_compare_has_a_table_of_its_own(tmp_path: Path) -> None:
    boxes = QualityDefinition(masks="boxes")
    records = [
        made(tmp_path, "val"),
        made(tmp_path, "val", definition=QualityDefinition()),
        made(tmp_path, "val", definition=replace(boxes, frames="all")),
        made(tmp_path, "val", content="other weights"),
    ]
    tables = quality_tables(records)
    assert tables[0].title.split("masks from ")[1] == "grounded-sam2, 2 Hz keyframes"
    assert len({table.name for table in tables}) == 4 and tables == quality_tables(records[::-1])


def test_parts_and_other_frames_are_said(tmp_path: Path) -> None:
    part = made(tmp_path, "val", scenes_in_split=10)
    (table,) = quality_tables([part, made(tmp_path, "val-r", size=(400, 224))])
    assert any("val: 2 of 10 scenes of the split only" in note for note in table.notes)
    assert any(
        "Frames, and so the numbers, differ between splits" in note and "400 x 224" in note for note in table.notes
    )


@pytest.mark.path
def test_the_leaderboard_has_the_table_without_runs(tmp_path: Path) -> None:
    found = [made(tmp_path / "records", "val")]
    written = write_leaderboard(read_results([], found), tmp_path / "board")
    files = {path.relative_to(tmp_path / "board").as_posix() for path in written}
    assert {"tables/quality.csv", "published.csv", "tables.tex", "tables.json"} <= files
    assert "## Video quality" in (tmp_path / "board" / "README.md").read_text()
    assert find_stale_files(read_results([], found), tmp_path / "board") == []
    assert find_stale_files(read_results([], [made(tmp_path / "records", "val", size=(1, 1))]), tmp_path / "board")


def test_tables_of_quality_keep_what_every_table_keeps(tmp_path: Path) -> None:
    tables = quality_tables([made(tmp_path, split) for split in ("val", "adv")])
    assert [table.name for table in tables] == ["quality-boxes"]
    for table in tables:
        any_table.check(table)
        for width in (60, 80, 120):
            fits(table, width)
        shows_its_cells(table)
    any_table.test_heads_differ_and_json_of_every_table_reads_back(tables)
    any_table.test_latex_is_balanced_and_every_line_has_all_columns(tables)
