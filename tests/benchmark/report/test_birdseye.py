"""What is drawn from above is where it is, whatever the sheet lacks."""

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.records.scene_pages import RefinementTrace
from benchmark.report.birdseye import BirdseyeScene, draw_birdseye
from benchmark.report.overlays import CollisionParty, build_candidates_overlay, build_plan_overlay, describe_verdict
from benchmark.report.palette import (
    ADVERSARY,
    BEST,
    BYSTANDER,
    CONTACT,
    EGO,
    ON_DARK,
    ON_LIGHT,
    Rgb,
    choose_planner_style,
)
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, UNCOUNTED
from tests.benchmark.report.one_scene import agent, record, sheet, with_plan

LAND, PERSON, ROAD, STRIPE, VEHICLE = (ON_LIGHT.land, ON_LIGHT.person, ON_LIGHT.road, ON_LIGHT.stripe, ON_LIGHT.vehicle)
SIZE, EXTENT = 400, 20.0
"""Ten pixels a metre."""


def at(image: NDArray[np.uint8], ahead_m: float, left_m: float) -> Rgb:
    """Colour of a place, the ego's heading up."""
    column, row = round((SIZE - 1) / 2 - 10 * left_m), round((SIZE - 1) / 2 - 10 * ahead_m)
    red, green, blue = (int(part) for part in image[row, column])
    return red, green, blue


def share(image: NDArray[np.uint8], colour: Rgb) -> float:
    return float((np.abs(image.astype(int) - colour).max(axis=-1) <= 2).mean())


def drawn(*overlays: object, **changes: object) -> NDArray[np.uint8]:
    return draw_birdseye(sheet(**changes), 0, overlays, size_px=SIZE, extent_m=EXTENT)  # type: ignore[arg-type]


def test_everything_is_where_it_is_in_its_colour() -> None:
    image = drawn()
    assert image.shape == (SIZE, SIZE, 3) and image.dtype == np.uint8
    assert at(image, 0.0, 0.0) == EGO and at(image, 0.5, 0.6) == EGO
    assert at(image, 9.0, -0.5) == VEHICLE and at(image, 11.5, 0.5) == VEHICLE
    assert at(image, -1.0, 5.0) == ADVERSARY
    assert at(image, -15.0, 5.0) == ROAD and at(image, 0.0, 8.0) == LAND
    assert at(image, 9.0, 5.0) == ROAD


def test_north_up_turns_the_picture() -> None:
    image = draw_birdseye(sheet(), 0, size_px=SIZE, extent_m=EXTENT, heading_up=False)
    # East is to the right: what is ahead of this ego.
    assert at(image, 0.5, -9.0) == VEHICLE and at(image, 5.0, 1.0) == ADVERSARY


def test_a_crossing_has_stripes_and_people_are_seen_when_small() -> None:
    crossing = ((-12.0, -6.0), (-9.0, -6.0), (-9.0, 6.0), (-12.0, 6.0))
    person = agent("walker", 15.0, 5.0, category="human.pedestrian.adult", size_m=(0.5, 0.5, 1.8))
    image = drawn(road={**sheet().road.model_dump(), "crossings": [[crossing]]}, agents=[person])
    assert share(image[290:320], STRIPE) > 0.1
    assert at(image, 15.0, 5.0) == PERSON


@pytest.mark.parametrize(
    "changes", [{"road": {}}, {"agents": []}, {"labels": []}, {"keyframes": [], "sample_tokens": []}]
)
def test_a_sheet_without_map_objects_or_labels_is_drawn(changes: dict[str, object]) -> None:
    plain = sheet(**changes)
    assert share(draw_birdseye(plain, 0, size_px=SIZE, extent_m=EXTENT, captions=True), EGO) > 0.003


def test_a_ring_without_area_and_a_divider_of_one_point_are_no_trouble() -> None:
    nothing = {"drivable": [[[(0, 0), (0, 0), (0, 0)]]], "crossings": [[[(1, 1), (1, 1), (1, 1)]], []]}
    image = drawn(road={**nothing, "dividers": [{"points": [(0, 0)], "paint": "solid-white"}]})
    assert at(image, 0.0, 0.0) == EGO
    far = drawn(road={"drivable": [[[(-1e9, -6.0), (1e9, -6.0), (1e9, 6.0), (-1e9, 6.0)]]]})
    assert at(far, -15.0, 5.0) == ROAD


@pytest.mark.parametrize("changes", [{"timestamps_us": []}, {"timestamps_us": [1, 2, 3]}])
def test_a_sheet_whose_ego_does_not_fit_its_frames_is_one_sentence(changes: dict[str, object]) -> None:
    with pytest.raises(InputError, match="challenger-bench sheets again"):
        drawn(**changes)


def test_objects_that_are_not_there_are_not_drawn() -> None:
    later = agent("car", 10.0, 0.0, first=3)
    image = drawn(agents=[later])
    assert share(image, VEHICLE) == 0.0
    assert share(draw_birdseye(sheet(agents=[later]), 3, size_px=SIZE, extent_m=EXTENT), VEHICLE) > 0.003


@pytest.mark.parametrize(("frame", "size", "extent"), [(25, 100, 10.0), (-1, 100, 10.0), (0, 0, 10.0), (0, 9, np.nan)])
def test_what_cannot_be_drawn_is_one_sentence(frame: int, size: int, extent: float) -> None:
    with pytest.raises(InputError):
        draw_birdseye(sheet(), frame, size_px=size, extent_m=extent)


def test_a_plan_is_a_line_in_the_planners_colour_and_its_first_contact_is_marked() -> None:
    straight = {"frame": "ego", "waypoints": [[1.5 * step, 0.0] for step in range(1, 7)]}
    scene, style = sheet(), choose_planner_style(0)
    hits = with_plan(record("p", [HIT]), straight).rows[0]
    facts = {"first_contact_s": 1.9, "hit": "car", "hit_adversary": True}
    outcome = hits.outcomes["exact"].model_copy(update={"facts": facts})
    overlay = build_plan_overlay(
        scene, 0, hits.model_copy(update={"outcomes": {"exact": outcome}}), "exact", "p", style
    )
    assert overlay.contact is not None and overlay.contact.other is not None
    # The plan's front at 1.9 s: 3 m a second, the lidar 0.94 m ahead of the axle, the body 0.5 m and half its length.
    assert overlay.contact.ego[0] == pytest.approx(5.7 + 0.94 + 0.5, abs=1e-6)
    assert overlay.contact.point == pytest.approx([(10.0 - 2.0 + 7.14 + 4.084 / 2) / 2, 0.0], abs=1e-3)
    image = drawn(overlay)
    assert share(image, style.colour) > share(drawn(), style.colour) + 0.001
    assert share(image, CONTACT) > 0.0005
    assert at(image, 8.59, 0.0) == CONTACT
    clean = build_plan_overlay(scene, 0, with_plan(record("p", [CLEAN]), straight).rows[0], "exact", "p", style)
    assert share(drawn(clean), CONTACT) == 0.0


def test_verdicts_in_words() -> None:
    rows = record("p", [HIT, CLEAN, FAILED, UNCOUNTED]).rows
    words = ["collides within 0.5 s", "no contact", "the planner failed", "no contact, not counted"]
    assert [describe_verdict(row, "exact").words for row in rows] == words
    assert [describe_verdict(row, "exact").collides for row in rows] == [True, False, None, False]
    with pytest.raises(InputError, match="rescore"):
        describe_verdict(rows[0], "vad")


@pytest.mark.parametrize(
    ("adversary", "words", "whom", "alarms"),
    [
        (True, "hits the adversary 0.1 s ahead", CollisionParty.ADVERSARY, True),
        (False, "hits another 0.1 s ahead", CollisionParty.OTHER, False),
        (None, "collides within 0.5 s, whom is not said", CollisionParty.UNKNOWN, False),
    ],
)
def test_contacts_with_others_than_the_adversary_are_told_apart(
    adversary: bool | None, words: str, whom: CollisionParty, alarms: bool
) -> None:
    facts = {} if adversary is None else {"hit_adversary": adversary, "first_contact_s": 0.1, "hit": "car"}
    straight = {"frame": "ego", "waypoints": [[1.5 * step, 0.0] for step in range(1, 7)]}
    row = with_plan(record("p", [HIT]), straight).rows[0]
    row = row.model_copy(update={"outcomes": {"exact": row.outcomes["exact"].model_copy(update={"facts": facts})}})
    overlay = build_plan_overlay(sheet(), 0, row, "exact", "p", choose_planner_style(0))
    assert (overlay.verdict.words, overlay.verdict.whom, overlay.verdict.alarms) == (words, whom, alarms)
    image = draw_birdseye(sheet(), 0, [overlay], size_px=SIZE, extent_m=EXTENT, captions=True)
    assert (share(image, CONTACT) > 0) == alarms and (share(image, BYSTANDER) > 0) == (not alarms)
    # In a scene without adversaries any contact counts.
    alone = build_plan_overlay(sheet(agents=[agent("car", 10.0, 0.0)]), 0, row, "exact", "p", choose_planner_style(0))
    assert alone.verdict.alarms and alone.verdict.words.startswith("collides")


def trace(**changes: object) -> RefinementTrace:
    ahead = [(1.0 * step, 5.0) for step in range(9)]
    across = [(0.0, 5.0 - step) for step in range(9)]
    rounds = {"candidates": [ahead, across], "scores": [1.0, None], "collision_free": 1}
    frame = {"frame": 6, "rounds": [rounds], "chosen_round": 0, "chosen": 0, **changes}
    content = {"schema": 1, "scene": "scene-1", "agent": "bad", "origin_m": (600.0, 1600.0), "search": {}}
    return RefinementTrace.model_validate({**content, "frames": [frame]})


def test_candidates_are_those_of_the_planning_frame_in_force() -> None:
    scene = sheet()
    assert build_candidates_overlay(scene, trace(), 5) is None
    assert build_candidates_overlay(scene, trace(), 19) is None
    overlay = build_candidates_overlay(scene, trace(), 18)
    assert overlay is not None and overlay.chosen is not None
    assert overlay.shares.tolist() == [1.0, 0.0] and overlay.chosen[0].tolist() == [0.0, 5.0]
    image = draw_birdseye(scene, 6, [overlay], size_px=SIZE, extent_m=EXTENT)
    assert at(image, 5.0, 5.0) == BEST


@pytest.mark.parametrize("changes", [{"chosen": 2}, {"chosen_round": 1}, {"chosen": -1}])
def test_a_trace_that_names_what_it_has_not_is_one_sentence(changes: dict[str, int]) -> None:
    with pytest.raises(InputError, match="lacks"):
        build_candidates_overlay(sheet(), trace(**changes), 6)


def test_the_same_picture_twice_with_captions_and_any_name() -> None:
    scene = sheet()
    hostile = "\x00<script>日本語\u202e" * 50
    plan = build_plan_overlay(scene, 0, record("p", [HIT]).rows[0], "exact", hostile, choose_planner_style(3))
    first = draw_birdseye(scene, 0, [plan], size_px=SIZE, extent_m=EXTENT, captions=True)
    assert np.array_equal(first, draw_birdseye(scene, 0, [plan], size_px=SIZE, extent_m=EXTENT, captions=True))
    assert draw_birdseye(scene, 0, [plan], size_px=1, captions=True).shape == (1, 1, 3)


def test_on_dark_everything_but_ego_and_adversary_has_other_colours() -> None:
    scene = sheet()
    light, dark = (
        BirdseyeScene(scene, colours).draw(3, width_px=SIZE, height_px=SIZE, extent_m=EXTENT)[0]
        for colours in (ON_LIGHT, ON_DARK)
    )
    for colour in (ADVERSARY, EGO):
        assert share(dark, colour) == pytest.approx(share(light, colour), abs=0.002)
    assert share(dark, ON_DARK.road) > 0.05 and share(dark, ON_LIGHT.road) < 0.001
