"""AlpaSim's scene score of drives of ours: what is logged, the road, what is stored and what `rescore` adds."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, run_episode
from benchmark.closed_loop.scoring import score_episode
from benchmark.extensions.alpasim_score.drives import find_off_road, log_drive, score_by_alpasim
from benchmark.extensions.alpasim_score.scene_score import JULY, RULE_SETS, SEPTEMBER, RuleSet, measure_drive
from benchmark.geometry import Floats
from benchmark.records.drive_schema import EpisodeRow, NeuroncapScore
from benchmark.records.drives import compute_column_values
from benchmark.records.encounter_window import EncounterWindow
from benchmark.road_map import RoadMap
from benchmark.runs.drive_rows import build_episode_row
from benchmark.runs.redriving import redrive_and_score
from benchmark.scene import Scene
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.benchmark.extensions.alpasim_score.made import BODY
from tests.benchmark.fake_data import FakeData
from tests.hand_made import Car, scene_on_straight_road

NAMES = {rules.name for rules in RULE_SETS}
AHEAD, CHASING = Car(90.0, 198.25, 0.0), Car(20.0, 198.25, 14.0)


def driven(scene: Scene, speed: float = 8.0, left: float = 0.0, maker: DefaultBackend | None = None) -> Episode:
    return run_episode(staged(scene, maker), Watching(speed, left))


def scored(scene: Scene, **how: float) -> dict[str, dict[str, float | None]]:
    parts = score_by_alpasim(scene, driven(scene, how.get("speed", 8.0), how.get("left", 0.0)))
    assert set(parts) == NAMES
    return parts


def without_map(scene: Scene) -> Scene:
    return replace(scene, road_map=RoadMap("nowhere", shapely.MultiPolygon()))


@pytest.mark.path
def test_drives_pass_or_fail_as_alpasim_has_it() -> None:
    for parts in scored(scene_on_straight_road(())).values():
        assert parts["score"] == 1.0 and parts["off_road"] == 0.0 and parts["km"] == pytest.approx(0.06, abs=0.01)
    for parts in scored(scene_on_straight_road((AHEAD,))).values():
        assert parts["score"] == 0.0 and parts["front"] == 1.0 and parts["progress"] == pytest.approx(0.7, abs=0.03)
    for parts in scored(scene_on_straight_road((CHASING,))).values():
        assert parts["rear"] == 1.0 and parts["front"] == parts["lateral"] == 0.0
        # It was pushed half way, of what the recording shows to its end.
        assert parts["score"] == parts["progress"] and 0.3 < (parts["score"] or 0.0) < 0.9


def test_the_way_ends_where_the_scene_does_even_if_a_contact_ended_the_drive() -> None:
    scene = scene_on_straight_road((CHASING,))
    drive = driven(scene)
    log = log_drive(scene, drive)
    assert drive.touch is not None and log.cut and log.ends_us == scene.timestamps_us[scene.keyframes[-1]]
    assert log.times_us[-1] < log.ends_us and log.scored_from_us == scene.timestamps_us[scene.keyframes[2]]
    whole = log_drive(scene_on_straight_road(()), driven(scene_on_straight_road(())))
    assert whole.ends_us == whole.times_us[-1] <= whole.recorded_us[-1] and not whole.cut


def test_who_leaves_the_road_fails_and_the_corridor_only_in_september() -> None:
    left = scored(scene_on_straight_road((), ego_y=205.25), speed=9.0, left=1.2)
    for parts in left.values():
        assert parts["off_road"] == 1.0 and parts["score"] == 0.0
    aside = scored(without_map(scene_on_straight_road(())), speed=9.0, left=0.6)
    assert aside[JULY.name]["corridor"] == aside[SEPTEMBER.name]["corridor"] == 1.0
    assert aside[SEPTEMBER.name]["score"] == 0.0 and (aside[JULY.name]["score"] or 0.0) > 0.0


def test_without_a_map_off_road_is_empty() -> None:
    scene = without_map(scene_on_straight_road((AHEAD,)))
    for parts in scored(scene).values():
        assert parts["off_road"] is None and parts["front"] == 1.0 and parts["score"] == 0.0


def is_off_road(scene: Scene, ego: Floats, rules: RuleSet) -> list[bool]:
    found = find_off_road(scene, ego, rules)
    assert found is not None
    return [bool(off) for off in found]


def test_july_sees_the_edge_and_september_the_surface() -> None:
    scene = scene_on_straight_road(())
    # The road ends at y = 207; across the edge, beside it, on it, beyond it.
    ego = np.array([[100.0, y, *BODY, 0.0] for y in (207.2, 206.0, 200.0, 220.0)])
    assert is_off_road(scene, ego, JULY) == [True, False, False, False]
    assert is_off_road(scene, ego, SEPTEMBER) == [True, False, False, True]
    crossed = shapely.Polygon([(300, 193), (400, 207), (400, 193), (300, 207)])
    slit = shapely.MultiPolygon([shapely.box(0, 193, 100, 207), shapely.box(100.02, 193, 400, 207), crossed])
    parted = replace(scene, road_map=replace(scene.road_map, drivable_area=slit, lanes={}))
    for rules in RULE_SETS:
        assert is_off_road(parted, ego[2:3], rules) == [False]


def test_a_window_is_a_recording_of_its_own() -> None:
    scene = scene_on_straight_road((), seconds=12.0)
    window = EncounterWindow(scene.name, 8, 16, (), None)
    drive = driven(scene, speed=0.0, maker=DefaultBackend(window=window))
    log = log_drive(scene, drive)
    keys = scene.timestamps_us[scene.keyframes]
    assert (log.recorded_us[0], log.recorded_us[-1]) == (log.times_us[0], keys[16]) == (keys[6], keys[16])
    assert log.scored_from_us == keys[8]
    measures = measure_drive(log)
    # It stops at once: of 40 m, 8 were the recording's.
    assert measures is not None and measures.way_m == pytest.approx(40.0) and 0.2 < measures.way[-1] < 0.45


def test_neuroncaps_drives_have_no_score_of_another_formula() -> None:
    scene = scene_on_straight_road(())
    drive = replace(driven(scene), neuroncap=NeuroncapScore(5.0, 0.0, 0.0))
    assert score_by_alpasim(scene, drive) == {} == score_episode(scene, drive).further


def stored(scene: Scene) -> EpisodeRow:
    stage = staged(scene)
    drive = run_episode(stage, Watching())
    return build_episode_row(stage, drive, score_episode(scene, drive))


def test_parts_are_stored_and_an_older_row_gets_them_by_driving_its_plans_again() -> None:
    scene = scene_on_straight_road((AHEAD,))
    row = stored(scene)
    assert row.scores is not None and set(row.scores.further) == NAMES
    assert EpisodeRow.model_validate(json.loads(row.model_dump_json())) == row
    older = row.model_copy(update={"scores": row.scores.model_copy(update={"further": {}})})
    written: dict[str, Any] = older.model_dump(mode="json")
    assert "further" not in written["scores"] and EpisodeRow.model_validate(written) == older
    assert not NAMES & set(compute_column_values(older))
    again = redrive_and_score(DefaultBackend(), scene, FakeData({scene.name: scene}), older)
    assert again == row
    values = compute_column_values(again)
    assert {values[name] for name in NAMES} == {0.0}
    unlabelled = compute_column_values(again.model_copy(update={"unlabelled": True}))
    assert {unlabelled[name] for name in NAMES} == {None}


def test_damaged_parts_are_no_traceback() -> None:
    row = stored(scene_on_straight_road(()))
    assert row.scores is not None
    odd = row.model_copy(update={"scores": row.scores.model_copy(update={"further": {"alpasim@2026-09": {}}})})
    assert compute_column_values(odd)["alpasim@2026-09"] is None
