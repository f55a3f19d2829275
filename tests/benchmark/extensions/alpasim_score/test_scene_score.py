"""AlpaSim's scene score: equal to its own code, and to a slow reading of its rules; what it does with odd drives."""

import gzip
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.extensions.alpasim_score.bodies import (
    ContactSide,
    build_bodies,
    build_slabs,
    classify_contacts,
    order_in_tree,
)
from benchmark.extensions.alpasim_score.scene_score import (
    JULY,
    RULE_SETS,
    SEPTEMBER,
    LoggedDrive,
    RuleSet,
    SceneScore,
    measure_drive,
    score_drive,
)
from benchmark.extensions.alpasim_score.verification import EXPECTED, GOLDEN, INPUTS, compute_km_between
from benchmark.geometry import Floats
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.alpasim_score.made import BODY, CAR, along, boxes, logged

SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden" / "alpasim"
BUILT_IN = GOLDEN.built_in or Path()
OF_JULY, OF_SEPTEMBER = EXPECTED


def scored(log: LoggedDrive, rules: RuleSet = SEPTEMBER, **flags: Any) -> SceneScore:
    measures = measure_drive(log)
    assert measures is not None
    score = score_drive(measures, rules, **flags)
    assert score is not None
    return score


@pytest.mark.path
def test_the_command_agrees_with_the_built_in_set() -> None:
    done = run_here("verify", "alpasim")
    assert done.code == 0 and "66 of 66 quantities agree" in done.out


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden scores are not beside this checkout")
def test_every_golden_score_is_met_from_the_folder_of_all_sets_and_from_one() -> None:
    done = run_here("verify", "alpasim", "--golden", str(SHARED / "score"), "--json")
    checks = json.loads(done.out)
    assert done.code == 0 and len(checks) == 66 and all(check["error"] <= 2e-5 for check in checks)
    assert "alpasim@2026-09: score" in run_here("verify", "alpasim", "--golden", str(SHARED)).out


def changed(to: Path, file: str, change: Any) -> Path:
    shutil.copytree(BUILT_IN, to)
    content = json.loads(gzip.decompress((to / file).read_bytes()))
    change(content)
    (to / file).write_bytes(gzip.compress(json.dumps(content).encode()))
    return to


def find(scenes: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return next(scene for scene in scenes if scene["name"] == name)


@pytest.mark.parametrize(
    ("file", "change", "quantity"),
    [
        (INPUTS, lambda all_: find(all_, "front_lead")["rig_to_aabb"].__setitem__(0, 1.3975), "progress over time"),
        (INPUTS, lambda all_: find(all_, "rounded_miss")["actors"]["near"].update(size=[6.0, 3.0, 1.6]), "verdicts"),
        (OF_JULY, lambda all_: all_["scenes"][3]["summary_rows"][0].update(score=0.9999), "score"),
        (OF_SEPTEMBER, lambda all_: all_["scenes"][3]["summary_rows"][0].update(passed=False), "verdicts"),
        (OF_SEPTEMBER, lambda all_: all_["runs"]["no_incident"]["scores"].pop(), "drives of a run"),
    ],
)
def test_a_changed_number_is_found(tmp_path: Path, file: str, change: Any, quantity: str) -> None:
    checks = GOLDEN.verify(changed(tmp_path / "set", file, change))
    assert any(not check.ok and check.quantity.endswith(quantity) for check in checks)


@pytest.mark.parametrize("damage", ["cut", "empty", "no gzip", "another kind", "absent"])
def test_a_damaged_set_is_one_sentence(tmp_path: Path, damage: str) -> None:
    to = tmp_path / "score"
    shutil.copytree(BUILT_IN, to)
    path = to / INPUTS
    whole = path.read_bytes()
    texts = {"cut": whole[:1000], "empty": b"", "no gzip": b"[]", "another kind": gzip.compress(b'[{"name": 1}]')}
    path.write_bytes(texts[damage]) if damage in texts else path.unlink()
    assert str(to) in refusal("verify", "alpasim", "--golden", str(to))


def test_a_folder_without_any_set_is_refused(tmp_path: Path) -> None:
    assert "holds no golden set of alpasim" in refusal("verify", "alpasim", "--golden", str(tmp_path))


def body_of(box: Any) -> Any:
    return build_bodies(np.array(box)[None])[0]


def slabs_of(box: Any) -> list[Any]:
    return [slab[0] for slab in build_slabs(np.array(box)[None])]


positions = st.floats(-30.0, 30.0)
any_box = st.tuples(positions, positions, st.floats(0.5, 12.0), st.floats(0.5, 3.0), st.floats(-4.0, 4.0))


@given(any_box)
@settings(max_examples=60, deadline=None)
def test_a_body_is_the_shrunk_rectangle_eroded_and_dilated(box: tuple[float, ...]) -> None:
    x, y, length, width, yaw = box
    half_length, half_width = 0.49 * length, 0.49 * width
    turned = shapely.affinity.rotate(
        shapely.box(-half_length, -half_width, half_length, half_width), yaw, origin=(0, 0), use_radians=True
    )
    whole = shapely.affinity.translate(turned, x, y)
    radius = 0.25 * 0.98 * min(length, width)
    slow = whole.buffer(-radius, join_style="mitre").buffer(radius, quad_segs=16)
    body = body_of(box)
    assert body.hausdorff_distance(slow) < 0.01 * radius and abs(body.area - slow.area) < 2e-3 * radius**2
    assert whole.buffer(1e-9).covers(body)
    front, rear = slabs_of(box)
    assert (
        front.area == pytest.approx(rear.area) and front.union(rear).convex_hull.symmetric_difference(body).area < 1e-6
    )


@given(st.integers(1, 130), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_the_order_of_boxes_is_that_of_a_tree(count: int, seed: int) -> None:
    drawn = np.random.default_rng(seed)
    middle, half = drawn.uniform(-50, 50, (count, 2)), drawn.uniform(0.2, 5, (count, 2))
    bounds = np.column_stack([middle - half, middle + half])
    found = shapely.STRtree(shapely.box(*bounds.T)).query(shapely.box(-100, -100, 100, 100))
    assert order_in_tree(bounds).tolist() == found.tolist()


def read_slowly(log: LoggedDrive, rules: RuleSet, off_road: list[bool]) -> tuple[float, str]:
    """Section 10 of the specification, time by time, in plain Python over shapely's lines."""
    path = shapely.LineString(log.recorded)
    points = [shapely.Point(*box[:2]) for box in log.ego]
    at_end = [np.interp(log.ends_us, log.recorded_us, log.recorded[:, axis]) for axis in range(2)]
    reached = path.project(shapely.Point(at_end))
    seen: set[str] = set()
    way, start = 0.0, 0
    while start < len(points) and log.times_us[start] < log.scored_from_us:
        start += 1
    for place in range(start if start < len(points) else 0, len(points)):
        share = path.project(points[place]) / path.length
        share = 0.0 if place == 0 else 0.5 * path.project(points[2]) / path.length if place == 1 else share
        way = share if rules.whole_way or not reached else share * path.length / reached
        body = body_of(log.ego[place])
        touching = [other for other in log.others[:, place] if body_of(other).intersects(body)]
        if touching:
            last = max(touching, key=lambda other: other[1])
            slabs = slabs_of(log.ego[place])
            hit = [slab.intersects(body_of(last)) for slab in slabs]
            seen.add("rear" if hit == [False, True] else "fault")
        if off_road[place]:
            seen.add("off")
        away = path.distance(points[place])
        past = path.project(points[place]) >= path.length - 1e-9
        if place >= 2 and (abs(points[place].y) if past else away) >= 4.0:
            seen.add("beside")
        if seen & {"fault", "rear", "off"} or (place >= 2 and away >= 4.0):
            break
    full = 1.0 if path.length < 5.0 else min(min(max(way, 0.0), 1.0) / 0.8, 1.0)
    reasons = {"fault": "collision_at_fault", "off": "offroad"}
    reasons |= {"beside": "left_corridor_laterally"} if rules.corridor_fails else {}
    verdict = next((reason for sign, reason in reasons.items() if sign in seen), "")
    return (0.0 if verdict else full), verdict


@st.composite
def any_drive(draw: st.DrawFn) -> tuple[LoggedDrive, list[bool]]:
    count = draw(st.integers(3, 41))
    speed, aside = draw(st.floats(0.0, 16.0)), draw(st.sampled_from([0.0, 0.0, 0.3, 1.5]))
    x = along(speed, count=count)
    y = aside * 0.1 * np.arange(count)
    ego = boxes(x, y, BODY, math.atan2(aside, max(speed, 1.0)), count)
    # No two of the others are at one height, so that the order of the tree is that of y.
    others = [
        boxes(along(draw(st.floats(-5, 15)), draw(st.floats(-20, 60)), count), lane, CAR, 0.0, count)
        for lane in draw(st.lists(st.sampled_from([-3.1, -1.4, 0.2, 1.8, 3.3]), max_size=4, unique=True))
    ]
    off_road = [draw(st.integers(0, 60)) == 0 for _ in range(count)]
    log = logged(
        ego, *others, speed=draw(st.sampled_from([0.3, 5.0, 10.0])), recorded_s=draw(st.sampled_from([4.0, 6.0]))
    )
    return replace(log, scored_from_us=draw(st.sampled_from([0, 100_000, 500_000, 10_000_000]))), off_road


@given(any_drive(), st.sampled_from(RULE_SETS))
@settings(max_examples=80, deadline=None)
def test_a_slow_reading_of_the_rules_agrees(drive: tuple[LoggedDrive, list[bool]], rules: RuleSet) -> None:
    log, off_road = drive
    found = scored(log, rules, off_road=np.array(off_road))
    score, verdict = read_slowly(log, rules, off_road)
    assert str(found.verdict) == verdict and found.score == pytest.approx(score, abs=1e-9)


def moved(log: LoggedDrive, angle: float, by: tuple[float, float]) -> LoggedDrive:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def place(array: Floats) -> Floats:
        there = array.copy()
        there[..., :2] = array[..., :2] @ turn.T + by
        there[..., 4:] += angle
        return there

    return replace(log, ego=place(log.ego), others=place(log.others), recorded=place(log.recorded))


@given(st.floats(-3.2, 3.2), st.tuples(st.floats(-2500, 2500), st.floats(-2500, 2500)))
@settings(max_examples=40, deadline=None)
def test_a_drive_that_is_turned_and_moved_has_the_same_score(angle: float, by: tuple[float, float]) -> None:
    log = logged(boxes(along(9.0), 0.0, BODY), boxes(along(3.0, 19.3), 0.4))
    assert scored(moved(log, angle, by)).verdict == scored(log).verdict == "collision_at_fault"
    clean = logged(boxes(along(6.0), 0.5, BODY))
    assert scored(moved(clean, angle, by)).score == pytest.approx(scored(clean).score, abs=1e-7)


def test_of_two_contacts_at_once_the_northern_one_counts() -> None:
    log = logged(boxes(0.0, 0.0, BODY), boxes(4.0, 0.3), boxes(-4.0, -0.3), speed=2.0)
    assert scored(log).front and not scored(log).rear
    turned = moved(log, math.pi, (0.0, 0.0))
    assert scored(turned).rear and not scored(turned).front and scored(turned).verdict == ""


def test_a_contact_from_behind_ends_a_drive_without_fault() -> None:
    chased = logged(boxes(along(5.0), 0.0, BODY), boxes(along(15.0, -14.2)), boxes(along(0.0, 20.0)))
    score = scored(chased)
    assert score.rear and score.incident and not score.at_fault and not score.incident_at_fault
    assert 0.0 < score.score < 0.5 and score.driven_m < 8.0


def test_what_cut_a_drive_short_counts_by_the_nearest_side() -> None:
    ahead, beside, behind = boxes(4.4), boxes(0.0, 1.9, (1.0, 1.9)), boxes(-4.4)
    for other, side in ((ahead, ContactSide.FRONT), (beside, ContactSide.LATERAL), (behind, ContactSide.REAR)):
        log = logged(boxes(0.0, 0.0, BODY), other, boxes(30.0), cut=True)
        assert classify_contacts(log.ego, log.others, log.present, cut=True).tolist() == [0] * 40 + [side]
        assert scored(log).incident and not scored(replace(log, cut=False)).incident
        assert scored(log).at_fault == (side is not ContactSide.REAR)
    gone = replace(logged(boxes(0.0, 0.0, BODY), ahead, cut=True), present=np.zeros((1, 41), np.bool_))
    assert not scored(gone).incident


def test_the_rules_of_both_months_differ_where_they_should() -> None:
    beside = logged(boxes(along(12.0), np.linspace(0.0, 6.0, 41), BODY), recorded_s=4.0)
    assert scored(beside, SEPTEMBER).verdict == "left_corridor_laterally" and scored(beside, JULY).verdict == ""
    longer = logged(boxes(along(5.0), 0.0, BODY), recorded_s=8.0)
    assert scored(longer, JULY).progress == pytest.approx(0.25) and scored(longer).progress == pytest.approx(0.5)
    measures = measure_drive(longer)
    assert measures is not None
    black = np.arange(41) == 20
    assert (
        score_drive(measures, JULY, black=black) is None and score_drive(measures, SEPTEMBER, black=black) is not None
    )
    assert score_drive(measures, JULY, black=np.arange(41) == 2) is not None


def test_without_a_map_off_road_is_unknown_and_a_clean_drive_passes() -> None:
    log = logged(boxes(along(10.0), 0.0, BODY))
    assert scored(log).off_road is None and scored(log).score == 1.0 and not scored(log).incident
    left = scored(log, off_road=np.arange(41) >= 30)
    assert (
        left.off_road and left.verdict == "offroad" and left.incident_at_fault and left.driven_m == pytest.approx(30.0)
    )


@pytest.mark.parametrize(
    ("log", "score"),
    [
        (logged(boxes(along(5.0, count=1), 0.0, BODY, count=1)), None),
        (logged(boxes(along(5.0, count=2), 0.0, BODY, count=2)), None),
        (logged(np.zeros((0, 5))), None),
        (logged(boxes(along(5.0), 0.0, BODY), recorded_s=3.0), None),
        (logged(boxes(np.nan, 0.0, BODY)), None),
        (logged(boxes(along(5.0), 0.0, BODY), boxes(np.nan)), None),
        (logged(boxes(along(5.0), 0.0, BODY), recorded=np.full((51, 2), np.inf)), None),
        (logged(boxes(along(0.0), 0.0, BODY), speed=0.0), 1.0),
        (logged(boxes(along(1.5), 0.0, BODY), speed=0.0), 0.0),
        (logged(boxes(along(5.0, count=3), 0.0, BODY, count=3)), 0.625),
        (logged(boxes(along(10.0), 0.0, BODY), scored_from_us=10**9), 1.0),
    ],
    ids=["one", "two", "none", "past", "nan", "nan other", "infinite", "still", "leaves", "three", "never"],
)
def test_odd_drives(log: LoggedDrive, score: float | None) -> None:
    measures = measure_drive(log)
    assert (measures is None) == (score is None)
    if measures is not None and score is not None:
        found = score_drive(measures, SEPTEMBER)
        assert found is not None and found.score == pytest.approx(score)


def test_who_is_absent_may_be_anywhere() -> None:
    log = logged(boxes(along(5.0), 0.0, BODY), boxes(np.nan))
    assert scored(replace(log, present=np.zeros((1, 41), np.bool_))).score == scored(logged(log.ego)).score


def test_kilometres_between_incidents() -> None:
    assert compute_km_between([(1.0, True), (2.0, False), (3.0, True)]) == pytest.approx(3.0)
    assert compute_km_between([(1.0, False)]) is None
