"""Scripts and pictures of scenes in the site: what the player draws is what the records and sheets say."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.geometry import Floats, to_global
from benchmark.planning import Plan, PlanFrame
from benchmark.protocols.exact import compute_plan_boxes
from benchmark.records.row_schema import DiagnosisRow, ForecastRow, OutcomeRow, PlanRow, SampleRow
from benchmark.records.scene_pages import NO_SCENE_PAGES, PageMap, ScenePages, picture_name
from leaderboard.site.packing import CENTIMETRE, pack_path, pack_series
from leaderboard.site.scene_data import THUMBNAIL_PX, build_scene_files, draw_thumbnail, find_closest_frame
from leaderboard.site.scene_facts import scene_key
from leaderboard.site.scene_plans import FORECASTS_SHOWN, MODES_SHOWN, build_sample
from tests.leaderboard.site.big_workspace import DATA_NAME
from tests.leaderboard.site.conftest import Site
from tests.leaderboard.site.test_index import value_of

AHEAD_M = 0.94
POSE = np.array([40.0, -12.0, 0.7])
WAYPOINTS = np.array([[0.1, 2.0], [0.3, 4.2], [0.7, 6.5], [1.3, 8.8], [2.1, 11.0], [3.0, 13.1]])


def unpacked(steps: Sequence[int | None], count: int, unit: float) -> list[float | None]:
    """What player_data.js does."""
    now, values = 0, []
    for step in [*steps, *[0] * (count - len(steps))]:
        now += step or 0
        values.append(None if step is None else now * unit)
    return values


def path_of(steps: Sequence[int], unit: float = CENTIMETRE, start: tuple[float, float] = (0.0, 0.0)) -> Floats:
    first = np.rint(np.array(start) / unit)
    return np.asarray((np.cumsum(np.array(steps, np.float64).reshape(-1, 2), axis=0) + first) * unit)


def script_value(script: bytes | Path) -> Any:
    """The object in a scene's script."""
    assert isinstance(script, bytes)
    return value_of(script)


def row_of(plan: PlanRow | None, **changes: Any) -> SampleRow:
    facts: dict[str, Any] = {
        "scene": "s",
        "sample_token": "t",
        "index": 0,
        "timestamp_us": 0,
        "status": "failed" if plan is None else "ok",
        "command": 2,
        "ego_motion": "can_bus",
        "lidar_ahead_m": AHEAD_M,
        "complete": True,
        "recorded_future": [None] * 6,
        "plan": plan,
        "error": None,
        "outcomes": {},
    }
    return SampleRow(**{**facts, **changes})


def outcome(collision: str, *, counted: bool = True) -> OutcomeRow:
    hits = [step == "x" for step in collision]
    return OutcomeRow(collision=hits, l2=[0.123] * 5 + [None], counted=counted, steps={}, facts={})


@pytest.fixture(scope="module")
def files(site: Site) -> Mapping[str, bytes | Path]:
    return build_scene_files(site.sheets, site.records)


@given(st.lists(st.one_of(st.none(), st.floats(-1e5, 1e5)), max_size=30))
def test_packed_numbers_come_back(values: list[float | None]) -> None:
    steps = pack_series(values, CENTIMETRE)
    assert not steps or steps[-1] != 0
    for value, back in zip(values, unpacked(steps, len(values), CENTIMETRE), strict=True):
        assert back == pytest.approx(value, abs=CENTIMETRE) if value is not None else back is None


def test_rounding_errors_of_a_path_do_not_add_up() -> None:
    path = np.column_stack([np.arange(500) * 0.0149, np.zeros(500)])
    assert np.abs(path_of(pack_path(path, CENTIMETRE)) - path).max() <= CENTIMETRE / 2 + 1e-9


@pytest.mark.parametrize("frame", ["lidar", "ego"])
def test_a_plan_is_where_exact_judges_it(frame: str) -> None:
    given_plan = WAYPOINTS if frame == "lidar" else np.column_stack([WAYPOINTS[:, 1], -WAYPOINTS[:, 0]])
    plan = PlanRow(frame="lidar" if frame == "lidar" else "ego", waypoints=given_plan.tolist())
    entry = build_sample(row_of(plan), POSE, [], {})
    in_lidar = Plan(given_plan, PlanFrame(frame)).waypoints_in_lidar(AHEAD_M)
    lidar = np.array([*to_global(np.array([AHEAD_M, 0.0]), POSE), POSE[2] - np.pi / 2])
    assert path_of(entry["path"]) == pytest.approx(np.vstack([lidar[:2], to_global(in_lidar, lidar)]), abs=0.006)
    judged = compute_plan_boxes(in_lidar)[4::5, 4] + lidar[2]
    assert np.cumsum(entry["yaw"]) / 1000 == pytest.approx(judged, abs=0.001)


def test_modes_are_the_likeliest_and_not_the_plan() -> None:
    modes = [(WAYPOINTS + [index, 0.0]).tolist() for index in range(30)]
    scores = [index / 30 for index in range(30)]
    plan = PlanRow(frame="lidar", waypoints=modes[29], modes=modes, mode_scores=scores)
    flat = np.array([0.0, 0.0, 0.0])
    entry = build_sample(row_of(plan), flat, [], {})
    ends = [path_of(mode, start=(AHEAD_M, 0.0))[-1] for mode in entry["modes"]]
    expected = [[WAYPOINTS[-1, 1] + AHEAD_M, -(WAYPOINTS[-1, 0] + index)] for index in range(28, 28 - MODES_SHOWN, -1)]
    assert np.array(ends) == pytest.approx(np.array(expected), abs=0.01)


def test_forecasts_are_the_nearest_and_those_that_stand_have_no_path() -> None:
    boxes = [[0.0, float(distance), 4.0, 2.0, np.pi / 2] for distance in range(60, 10, -2)]
    still = np.tile(np.array(boxes)[:, None, None, :2], (1, 2, 6, 1))
    moving = still + np.array([0.0, 1.0]) * np.arange(1, 7)[:, None]
    paths = np.where(np.array([index % 2 for index in range(25)])[:, None, None, None] == 1, moving, still)
    paths[:, 1] += 50.0
    forecasts = ForecastRow(boxes=boxes, trajectories=paths.tolist(), scores=[[0.9, 0.1]] * 25)
    plan = PlanRow(frame="lidar", waypoints=WAYPOINTS.tolist(), forecasts=forecasts)
    shown = build_sample(row_of(plan), np.zeros(3), [], {})["forecasts"]
    assert [box[0] / 10 for box in shown] == pytest.approx(
        [12 + 2 * index + AHEAD_M for index in range(FORECASTS_SHOWN)], abs=0.051
    )
    assert {(box[1], box[2], box[3], box[4]) for box in shown} == {(0, 40, 20, 0)}
    assert [len(box) for box in shown] == [6 if index % 2 else 5 for index in range(24, 24 - FORECASTS_SHOWN, -1)]
    moved = next(box for box in shown if len(box) == 6)
    assert path_of(moved[5], 0.1, (moved[0] / 10, moved[1] / 10))[-1, 0] == pytest.approx(moved[0] / 10 + 6, abs=0.11)


def test_verdicts_contacts_and_causes() -> None:
    plan = PlanRow(frame="lidar", waypoints=WAYPOINTS.tolist())
    row = row_of(
        plan,
        outcomes={"exact": outcome("...xx."), "uniad": outcome("....x.", counted=False), "vad": outcome("......")},
        diagnosis=DiagnosisRow(cause="unseen", reason="no forecast near", hit="b", first_contact_s=1.8),
    )
    entry = build_sample(row, POSE, ["exact", "uniad", "vad", "sparsedrive"], {"a": 0, "b": 1})
    assert entry["judged"] == [["oxx", 1, 1.8, "1.8 s"], ["oox", 0, 2.5, "2.5 s"], ["ooo", 1], None]
    assert (entry["cause"], entry["reason"], entry["hit"]) == ("unseen", "no forecast near", 1)
    assert entry["l2"] == ["0.12", "0.12", "–"] and "hit" not in build_sample(row, POSE, ["exact"], {})


def test_whom_a_plan_touches_first_is_said_on_splits_with_adversaries() -> None:
    plan = PlanRow(frame="lidar", waypoints=WAYPOINTS.tolist())
    touched = [None, None, None, False, True, None]
    verdicts = {
        "exact": outcome("...xx.").model_copy(update={"facts": {"hit_adversary": True}}),
        "uniad": outcome("...xx.").model_copy(update={"facts": {"touched_adversary": touched}}),
        "bev-planner": outcome("...x.."),
        "vad": outcome("......"),
    }
    row, protocols = row_of(plan, outcomes=verdicts), [*verdicts, "stp3"]
    told, untold = (build_sample(row, POSE, protocols, {}, known=known)["judged"] for known in (True, False))
    assert [each and each[0] for each in told] == ["oXX", "oaa", "oww", "ooo", None]
    assert [each and each[0] for each in untold] == ["oww", "oww", "oww", "ooo", None]


def test_a_failure_is_its_last_line_and_no_plan() -> None:
    error = "Traceback\n  File x\nValueError: <b>no</b>\n"
    assert build_sample(row_of(None, error=error), POSE, ["exact"], {}) == {"failed": "ValueError: <b>no</b>"}
    assert build_sample(row_of(None, error=None), POSE, [], {}) == {"failed": "no reason was recorded"}


def test_a_plan_with_lists_of_wrong_lengths_is_named() -> None:
    forecasts = ForecastRow(boxes=[[0.0] * 5], trajectories=[[[[0.0, 0.0]]]], scores=[[1.0]])
    plan = PlanRow(frame="lidar", waypoints=WAYPOINTS.tolist(), forecasts=forecasts)
    with pytest.raises(InputError, match="sample 0"):
        build_sample(row_of(plan), POSE, [], {})


def test_every_scene_has_a_script_that_says_what_sheet_and_records_say(
    site: Site, files: Mapping[str, bytes | Path]
) -> None:
    scripts = {path: script_value(content) for path, content in files.items() if path.startswith("data/")}
    assert len(scripts) == len(site.made.scenes)
    for path, value in scripts.items():
        key = scene_key((value["data"], value["split"], value["scene"]))
        assert (path, value["key"]) == (f"data/scenes/{key}.js", key)
        stored = site.sheets.scenes.get((value["data"], value["split"], value["scene"]))
        assert value["hasSheet"] == (stored is not None)
        assert {model["name"] for model in value["models"]} == set(site.made.planners)
        rows = {
            record.planner: [row for row in record.rows if row.scene == value["scene"]]
            for record in site.records
            if record.run.split == value["split"]
        }
        for model in value["models"]:
            for row, entry in zip(rows[model["name"]], model["samples"], strict=True):
                assert ("failed" in entry) == (row.status == "failed")
                if row.status == "ok":
                    marks, counted, *contact = entry["judged"][value["protocols"].index("exact")]
                    hits = row.outcomes["exact"].collision or []
                    assert [mark != "o" for mark in marks] == [any(hits[:step]) for step in (2, 4, 6)]
                    assert (counted, bool(contact)) == (row.outcomes["exact"].counted, any(hits))
        for place, names in enumerate(value["shown"]):
            first = {model["name"]: model["first"][place] for model in value["models"]}
            if None in first.values() and set(first.values()) != {None}:
                assert {first[name] is None for name in names} == {True, False}
        apart = value["apart"][0][0][0]
        if apart is not None:
            ends = [path_of(model["samples"][0]["path"])[[2, 4, 6]] for model in value["models"][:2]]
            assert apart == [f"{metres:.2f}" for metres in np.hypot(*(ends[0] - ends[1]).T)]
        if stored is not None:
            assert [sample["frame"] for sample in value["samples"]] == list(stored.sheet.keyframes)
            assert [sample["command"] for sample in value["samples"]] == [
                row.command for row in rows[site.made.planners[1]]
            ]
            for agent, drawn in zip(stored.sheet.agents, value["agents"], strict=True):
                assert unpacked(drawn["x"], drawn["count"], CENTIMETRE) == pytest.approx(agent.x_m, abs=0.006)


def test_a_scene_without_a_sheet_is_in_the_frame_of_the_ego(site: Site, files: Mapping[str, bytes | Path]) -> None:
    key = scene_key((DATA_NAME, "val", site.made.without_sheet))
    value = script_value(files[f"data/scenes/{key}.js"])
    assert (value["ego"], value["agents"], value["pictures"]) == (None, [], [])
    assert not [path for path in files if path.startswith(f"media/{key}/")]
    record = next(found for found in site.records if found.run.split == "val")
    rows = [row for row in record.rows if row.scene == site.made.without_sheet]
    assert value["frames"] == pytest.approx([0.5 * index for index in range(len(rows))])
    first = rows[0].recorded_future[0]
    assert first is not None
    way = path_of(value["recorded"][0])
    assert way[0] == pytest.approx([first[1] + rows[0].lidar_ahead_m, -first[0]], abs=0.006)
    assert path_of(value["models"][0]["samples"][0]["path"])[0] == pytest.approx(
        [rows[0].lidar_ahead_m, 0.0], abs=0.006
    )
    assert len(way) == 6
    assert value["recorded"][-1] == []


def test_pictures_are_copied_and_thumbnails_drawn(site: Site, files: Mapping[str, bytes | Path]) -> None:
    for name, stored in site.sheets.scenes.items():
        key = scene_key(name)
        for frame in stored.sheet.pictures:
            assert files[f"media/{key}/{picture_name(frame)}"] == stored.picture_path(frame)
        thumb = files[f"media/{key}/thumb.webp"]
        assert isinstance(thumb, bytes)
        assert cv2.imdecode(np.frombuffer(thumb, np.uint8), cv2.IMREAD_COLOR).shape == (THUMBNAIL_PX, THUMBNAIL_PX, 3)


def test_the_thumbnail_shows_the_closest_approach(site: Site) -> None:
    sheet = next(stored.sheet for (_, split, _), stored in site.sheets.scenes.items() if split == "adv")
    frame = find_closest_frame(sheet)
    adversary = next(agent for agent in sheet.agents if agent.adversary)

    def apart(at: int) -> float:
        x, y = adversary.x_m[at - adversary.first], adversary.y_m[at - adversary.first]
        return np.inf if x is None or y is None else float(np.hypot(x - sheet.ego.x_m[at], y - sheet.ego.y_m[at]))

    assert apart(frame) < min(map(apart, range(adversary.first, len(sheet.timestamps_us)))) + 2.0
    nobody = sheet.model_copy(update={"agents": ()})
    assert find_closest_frame(nobody) == len(sheet.timestamps_us) // 2
    assert draw_thumbnail(sheet) == draw_thumbnail(sheet)


def test_scripts_are_small_and_hold_no_markup(site: Site, files: Mapping[str, bytes | Path]) -> None:
    for path, content in files.items():
        if path.startswith("data/"):
            assert isinstance(content, bytes)
            assert b"<" not in content
            # 500 KB for 10 planners and 40 samples, less what 30 agents and the map need once.
            assert len(content) < 100_000 + 400_000 * len(site.made.planners) * 12 / 400


def test_a_sheet_that_lacks_a_sample_is_refused(site: Site) -> None:
    name, stored = next((name, stored) for name, stored in site.sheets.scenes.items() if name[1] == "adv")
    tokens = tuple(f"other {token}" for token in stored.sheet.sample_tokens)
    other = replace(stored, sheet=stored.sheet.model_copy(update={"sample_tokens": tokens}))
    with pytest.raises(InputError, match="challenger-bench sheets"):
        build_scene_files(ScenePages({}, {name: other}), site.records)


def test_a_sheet_with_lists_of_different_lengths_is_refused(site: Site) -> None:
    name, stored = next(iter(site.sheets.scenes.items()))
    for changes in (
        {"timestamps_us": stored.sheet.timestamps_us[:-1]},
        {"sample_tokens": stored.sheet.sample_tokens[:-1]},
        {"keyframes": (*stored.sheet.keyframes[:-1], 10_000)},
    ):
        cut = replace(stored, sheet=stored.sheet.model_copy(update=changes))
        with pytest.raises(InputError, match="different lengths"):
            build_scene_files(ScenePages({}, {name: cut}), [])


def test_an_empty_scene_and_one_with_nobody_in_it(site: Site) -> None:
    name, stored = next(iter(site.sheets.scenes.items()))
    nobody = stored.sheet.model_copy(update={"agents": (), "pictures": (), "cameras": (), "road": PageMap()})
    nothing = {"x_m": (), "y_m": (), "yaw_rad": ()}
    empty = nobody.model_copy(
        update={
            "timestamps_us": (),
            "keyframes": (),
            "sample_tokens": (),
            "ego": nobody.ego.model_copy(update=nothing),
        }
    )
    for sheet, count in ((nobody, len(nobody.keyframes)), (empty, 0)):
        files = build_scene_files(ScenePages({}, {name: replace(stored, sheet=sheet)}), [])
        value = script_value(files[f"data/scenes/{scene_key(name)}.js"])
        assert (len(value["samples"]), value["agents"]) == (count, [])
        assert (f"media/{scene_key(name)}/thumb.webp" in files) == (count > 0)


def test_nothing_is_made_of_nothing() -> None:
    assert build_scene_files(NO_SCENE_PAGES, []) == {}


def test_a_sheet_alone_is_a_scene(site: Site) -> None:
    files = build_scene_files(site.sheets, [])
    values = [script_value(content) for path, content in files.items() if path.startswith("data/")]
    assert len(values) == len(site.sheets.scenes)
    assert all(value["models"] == [] and value["protocols"] == [] for value in values)
    assert {sample["command"] for value in values for sample in value["samples"]} == {None}
