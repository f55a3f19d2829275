"""What must hold for every protocol, or for the exact one, whatever the samples."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.datasets.sample_truth import compute_truth
from benchmark.geometry import Floats, box_corners, box_gap, boxes_overlap
from benchmark.protocols import PROTOCOLS
from benchmark.protocols.exact import compute_plan_boxes, find_contacts
from benchmark.records.rows import find_scene_failures
from benchmark.truth import SampleTruth
from benchmark.waypoints import chord_headings
from tests.benchmark.protocols.protocol_cases import PARTS, Traits, plan_of, sample_of, traits
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, hand_made
from tests.benchmark.turned_scenes import turned_scene
from tests.hand_made import Car, scene_on_straight_road

Box = tuple[float, float, float, float, float]
BOXES = st.tuples(
    st.floats(-8, 8), st.floats(-8, 8), st.floats(0.05, 12), st.floats(0.05, 4), st.floats(-10, 10, allow_nan=False)
)


@settings(max_examples=100, deadline=None)
@given(BOXES, BOXES)
def test_overlap_is_that_of_polygons_away_from_touching(first: Box, second: Box) -> None:
    boxes = np.array([first, second])
    one, other = (shapely.Polygon(corners) for corners in box_corners(boxes))
    common = one.intersection(other).area
    if one.distance(other) > 1e-9 or common > 1e-9:
        assert bool(boxes_overlap(boxes[0], boxes[1])) == one.intersects(other)


@settings(max_examples=40, deadline=None)
@given(traits(coarse=True))
def test_a_box_collides_wherever_its_centre_does(kind: Traits) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    ego = compute_plan_boxes(plan[None])
    point = ego.copy()
    point[..., 2:4] = 0.0
    of_box, of_centre = find_contacts(ego, [sample])[0], find_contacts(point, [sample])[0]
    assert (of_box | ~of_centre).all()


def verdicts(name: str, truths: Sequence[SampleTruth], plans: Floats) -> list[dict[str, Any]]:
    return PROTOCOLS[name].evaluate(truths, plans).as_rows()


@pytest.mark.parametrize("name", PROTOCOLS)
@settings(max_examples=8, deadline=None)
@given(kinds=st.lists(traits(coarse=True), min_size=2, max_size=6), data=st.data())
def test_order_and_company_of_samples_change_nothing(name: str, kinds: list[Traits], data: st.DataObject) -> None:
    truths = [sample_of(kind, str(index)) for index, kind in enumerate(kinds)]
    plans = np.array([plan_of(kind) for kind in kinds])
    together = verdicts(name, truths, plans)
    order = data.draw(st.permutations(range(len(kinds))))
    assert verdicts(name, [truths[index] for index in order], plans[order]) == [together[index] for index in order]
    cut = data.draw(st.integers(0, len(kinds)))
    assert verdicts(name, truths[:cut], plans[:cut]) + verdicts(name, truths[cut:], plans[cut:]) == together


@pytest.mark.parametrize("name", PROTOCOLS)
@settings(max_examples=8, deadline=None)
@given(kind=traits(coarse=True), data=st.data())
def test_order_of_objects_changes_nothing(name: str, kind: Traits, data: st.DataObject) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    order = data.draw(st.permutations(range(kind.objects)))
    rows = np.array(order, np.int64)
    mixed = replace(
        sample,
        instances=tuple(sample.instances[row] for row in order),
        categories=tuple(sample.categories[row] for row in order),
        **{part: getattr(sample, part)[rows] for part in PARTS},
    )
    assert verdicts(name, [mixed], plan[None]) == verdicts(name, [sample], plan[None])


@pytest.mark.parametrize("name", PROTOCOLS)
def test_more_samples_than_fit_in_a_batch_change_nothing(name: str) -> None:
    # The exact protocol takes 256 at once, the others 64 at the most.
    count = 300 if name == "exact" else 100
    kinds = [Traits(index, index % 5, 20.0, 6, "drive", False) for index in range(count)]
    truths = [sample_of(kind, str(index)) for index, kind in enumerate(kinds)]
    plans = np.array([plan_of(kind) for kind in kinds])
    cuts = [slice(start, start + 40) for start in range(0, count, 40)]
    assert verdicts(name, truths, plans) == [one for cut in cuts for one in verdicts(name, truths[cut], plans[cut])]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_nothing_is_hit_without_objects_and_far_away(name: str) -> None:
    assert verdicts(name, [], np.empty((0, 6, 2))) == []
    kind = Traits(3, 0, 9.0, 6, "drive", False)
    alone = verdicts(name, [sample_of(kind)], plan_of(kind)[None])
    assert alone[0]["collision"] == [False] * 6 and alone[0]["counted"]
    sample = sample_of(replace(kind, objects=12))
    assert not PROTOCOLS[name].evaluate([sample] * 2, np.full((2, 6, 2), [[[1e4]], [[-1e4]]])).collision.any()


CARS = st.lists(
    st.builds(
        Car, x=st.floats(40, 90), y=st.floats(192, 206), speed=st.floats(0, 12), yaw=st.floats(-3, 3),
        size=st.tuples(st.floats(0.5, 9), st.floats(0.4, 2.6), st.just(1.7)),
    ),
    min_size=1, max_size=4,
)  # fmt: skip


@settings(max_examples=15, deadline=None)
@given(CARS, st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-7, 7)), st.integers(0, 2**32))
def test_where_the_scene_lies_changes_nothing_in_exact(
    cars: list[Car], pose: tuple[float, float, float], seed: int
) -> None:
    scene = scene_on_straight_road(tuple(cars), seconds=5.0)
    tokens = [str(index) for index in range(len(scene.keyframes))]
    here, there = compute_truth(scene, tokens), compute_truth(turned_scene(scene, pose[2], shift_m=pose[:2]), tokens)
    rng = np.random.default_rng(seed)
    plans = np.cumsum(rng.normal([0.0, 4.0], [0.5, 1.0], (len(tokens), 6, 2)), axis=1)
    first, second = (PROTOCOLS["exact"].evaluate(truths, plans) for truths in (here, there))
    assert np.allclose(first.l2, second.l2, atol=1e-6)
    assert first.counted.tolist() == second.counted.tolist()
    for index, truth in enumerate(here):
        if not touches_barely(truth, plans[index]):
            assert first.collision[index].tolist() == second.collision[index].tolist()
            assert first.facts["hit"][index] == second.facts["hit"][index]


def touches_barely(truth: SampleTruth, plan: Floats) -> bool:
    """Whether a contact appears or goes when the ego grows or shrinks by a micrometre."""
    ego = compute_plan_boxes(plan[None])
    wider, narrower = ego.copy(), ego.copy()
    wider[..., 2:4] += 1e-6
    narrower[..., 2:4] -= 1e-6
    return bool((find_contacts(wider, [truth])[0] != find_contacts(narrower, [truth])[0]).any())


@settings(max_examples=40, deadline=None)
@given(traits(coarse=False))
def test_contact_is_where_the_gap_is_zero(kind: Traits) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    if touches_barely(sample, plan):
        return
    ego = compute_plan_boxes(plan[None])[0, 4::5]
    touching = np.array(
        [(box_gap(ego[step], sample.boxes[sample.annotated[:, step + 1], step + 1]) == 0).any() for step in range(6)]
    )
    found = PROTOCOLS["exact"].evaluate([sample], plan[None]).steps["waypoint_collision"][0]
    assert found.tolist() == touching.tolist()


@settings(max_examples=25, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(0.05, 0.29))
def test_creeping_keeps_the_heading(direction: float, chord: float) -> None:
    step = 0.5 * chord * np.array([np.cos(direction), np.sin(direction)])
    plan = step * np.arange(1, 7)[:, None]
    assert chord_headings(plan[None], start_heading_rad=np.pi / 2) == pytest.approx(np.full((1, 6), np.pi / 2))


@settings(max_examples=12, deadline=None)
@given(st.lists(st.sampled_from([CLEAN, HIT, FAILED]), min_size=1, max_size=12))
def test_a_failed_sample_is_never_a_zero(samples: list[str | None]) -> None:
    scenes = {f"scene-{first}": samples[first::3] for first in range(min(3, len(samples)))}
    record = hand_made("p", scenes, protocols=tuple(PROTOCOLS))
    planned = [flags for flags in samples if flags != FAILED]
    assert (record.summary.samples, record.summary.failed) == (len(samples), len(samples) - len(planned))
    for name in PROTOCOLS:
        rate = record.summary.protocols[name].columns["collision"]["3s"]
        assert rate.denominator == len(planned)
        expected = planned.count(HIT) / len(planned) if planned else None
        assert rate.value == (None if expected is None else pytest.approx(expected))
        # A scene is not clean while a sample of it failed.
        for scene, fails in find_scene_failures(record.rows, name).items():
            assert fails == (True if HIT in scenes[scene] else None if FAILED in scenes[scene] else False)
