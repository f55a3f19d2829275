"""Manoeuvres on request: what is missing to a kind, against labels and a slow placement; the search for it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmark.constants import FRAME_HZ
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.records.attempts import ManoeuvreOccurrence
from generation.labels.interactions import REACH_M, PathFrame, compute_path_interaction
from generation.labels.labelling import compute_labels, read_agent_boxes
from generation.labels.manoeuvres import Manoeuvre
from generation.search.hyperparameters import HyperParameters
from generation.search.manoeuvre_conditions import EgoAtFrames, ManoeuvrePlacement, compute_missing
from generation.search.manoeuvre_requests import REQUESTABLE_KINDS, ManoeuvreRequest, can_perform, parse_manoeuvre
from tests.generation.labels.recorded_roads import HYPER, recorded
from tests.generation.labels.test_manoeuvres import CASES, CURVATURES, Case, scene_of
from tests.generation.search.driving_prior import DrivingPrior
from tests.generation.search.one_vehicle import attempt, choose

DONE_M = 1.0
"""What may be missing where a label holds: the aims lie a little beyond its edges."""


@cache
def labelled(name: str, bend: str = "straight") -> tuple[ManoeuvreOccurrence, ...]:
    """What happens in a case."""
    return compute_labels(scene_of(CASES[name], CURVATURES[bend]), 0, 0).occurred


def as_driven(case: Case, curvature: float = 0.0) -> tuple[ManoeuvrePlacement, Floats]:
    """A hand-made track as one candidate at every frame, and its seconds."""
    scene = scene_of(case, curvature)
    frames = tuple(range(len(scene.seconds)))
    boxes = read_agent_boxes(scene, 0)
    velocity = np.gradient(boxes[:, :2], scene.seconds, axis=0)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    poses = boxes[None][..., [0, 1, 4]]
    return ManoeuvrePlacement.of(EgoAtFrames.of(scene, frames), poses, speed[None], boxes[0, 2:4]), scene.seconds


@pytest.mark.parametrize("bend", ["straight", "junction turn"])
@pytest.mark.parametrize("name", CASES)
def test_nothing_is_missing_where_the_label_holds(name: str, bend: str) -> None:
    placed, seconds = as_driven(CASES[name], CURVATURES[bend])
    for found in labelled(name, bend):
        kind = Manoeuvre(found.kind)
        if kind in REQUESTABLE_KINDS:
            meanwhile = (seconds >= found.first_s) & (seconds <= found.first_s + found.duration_s)
            assert compute_missing(kind, placed)[0, meanwhile].min() <= DONE_M, kind


def test_more_is_missing_where_it_does_not_occur() -> None:
    driven = {name: as_driven(case)[0] for name, case in CASES.items()}
    for kind in REQUESTABLE_KINDS:
        does: list[float] = []
        does_not: list[float] = []
        for name, placed in driven.items():
            occurs = kind.value in {found.kind for found in labelled(name)}
            (does if occurs else does_not).append(float(compute_missing(kind, placed).min()))
        assert max(does) <= DONE_M < np.median(does_not), kind


@pytest.mark.parametrize("curvature", CURVATURES.values(), ids=CURVATURES.keys())
def test_placement_agrees_with_the_projection_of_the_labels(curvature: float) -> None:
    # Short, because a whole circle is two places at once.
    case = replace(CASES["cuts in from the left"], seconds=5.0)
    scene, (placed, _) = scene_of(case, curvature), as_driven(case, curvature)
    boxes = read_agent_boxes(scene, 0)
    path = PathFrame.of(scene.ego.boxes)
    station, offset, _ = path.project(boxes[:, None, :2], path.ego_stations, REACH_M)
    met = compute_path_interaction(scene.ego.boxes, boxes, scene.seconds, np.ones(len(boxes), np.bool_), 0)
    np.testing.assert_allclose(placed.station[0], station[:, 0], atol=0.5)
    np.testing.assert_allclose(placed.offset[0], offset[:, 0], atol=0.1)
    np.testing.assert_allclose(placed.along[0], met.along, atol=0.4)
    inside = placed.inside()[0] < 0.3
    np.testing.assert_array_equal(inside[20:-20].mean().round(1), met.inside[20:-20].mean().round(1))


@pytest.mark.parametrize("name", ["cuts in from the left", "brakes ahead", "overtakes on the left", "tailgates"])
def test_a_wish_is_fulfilled_when_the_label_says_so_and_not_before(name: str) -> None:
    case = CASES[name]
    scene = scene_of(case)
    poses = read_agent_boxes(scene, 0)[:, [0, 1, 4]]
    wish = ManoeuvreRequest(case.kind, scene, 0, 0)
    done = [wish.is_fulfilled(poses[:end]) for end in range(1, len(poses) + 1, 6)]
    first = next(found.first_s for found in labelled(name) if found.kind == case.kind.value)
    assert done[-1]
    assert done == sorted(done), "what is done stays done"
    assert abs(done.index(True) * 6 / FRAME_HZ - first) < 4.0


def test_a_vehicle_that_was_never_outside_cannot_cut_in() -> None:
    case = CASES["leads"]
    scene = scene_of(case)
    frame, offsets = 60, tuple(range(1, 13))
    poses = read_agent_boxes(scene, 0)[:, [0, 1, 4]]
    cost = ManoeuvreRequest(Manoeuvre.CUT_IN_LEFT, scene, 0, 0).at(frame, offsets, poses[:61])
    staying = poses[None, 61:73]
    leaving = staying + np.array([0.0, 3.0, 0.0])
    assert cost(leaving, np.full((1, 12), 8.0))[0] < cost(staying, np.full((1, 12), 8.0))[0]
    beside = poses[:61] + np.array([0.0, 3.0, 0.0])
    ready = ManoeuvreRequest(Manoeuvre.CUT_IN_LEFT, scene, 0, 0).at(frame, offsets, beside)
    assert ready(leaving, np.full((1, 12), 8.0))[0] > ready(staying, np.full((1, 12), 8.0))[0]


def test_candidates_that_are_not_finite_spoil_nothing() -> None:
    case = CASES["leads"]
    scene = scene_of(case)
    poses = read_agent_boxes(scene, 0)[:, [0, 1, 4]]
    cost = ManoeuvreRequest(Manoeuvre.BLOCKING, scene, 0, 0).at(60, tuple(range(1, 13)), poses[:61])
    good = poses[61:73]
    alone = cost(good[None], np.full((1, 12), 8.0))
    both = cost(np.stack([good, np.full_like(good, np.nan)]), np.full((2, 12), 8.0))
    assert both[0] == pytest.approx(alone[0], abs=1e-9) and np.isfinite(both).all()


def test_nobody_turns_round_for_a_request() -> None:
    towards, along = scene_of(CASES["comes towards"]), scene_of(CASES["leads"])
    crossing = scene_of(CASES["crosses before"])
    assert can_perform(Manoeuvre.ONCOMING, towards, 0, 0) and not can_perform(Manoeuvre.ONCOMING, along, 0, 0)
    assert can_perform(Manoeuvre.CUT_IN_LEFT, along, 0, 0) and not can_perform(Manoeuvre.CUT_IN_LEFT, towards, 0, 0)
    assert can_perform(Manoeuvre.CROSSING, crossing, 0, 0) and not can_perform(Manoeuvre.CROSSING, along, 0, 0)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("cut-in", "did you mean cut-in-left or cut-in-right"),
        ("distant", "no other kind"),
        ("x\ny", "unknown manoeuvre"),
    ],
)
def test_a_kind_that_cannot_be_asked_for_is_one_sentence(name: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_manoeuvre(name)


def test_what_is_kept_does_what_was_asked_and_the_rest_says_what_it_did() -> None:
    scene, prior = recorded("scene-9901"), DrivingPrior()
    hyper = replace(HYPER, tries=1)
    for agent in choose(scene, hyper, 0)[:2]:
        for kind in (Manoeuvre.TAILGATING, Manoeuvre.CUT_IN_LEFT):
            found = attempt(scene, agent, 0, hyper, prior, asked=[kind])
            assert found.attempt.asked == kind.value
            if found.kept:
                assert found.attempt.labels is not None and found.attempt.labels.manoeuvre == kind.value
            elif found.attempt.discard == "another-manoeuvre-than-asked":
                assert found.attempt.because is not None and found.attempt.because["quantity"] != kind.value
            again = attempt(scene, agent, 0, hyper, prior, asked=[kind])
            np.testing.assert_array_equal(found.poses, again.poses)


def test_where_nothing_is_asked_the_report_is_as_before() -> None:
    scene, prior = recorded("scene-9901"), DrivingPrior()
    agent = choose(scene, HYPER, 0)[0]
    free = attempt(scene, agent, 0, replace(HYPER, tries=1), prior)
    weighed = attempt(scene, agent, 0, replace(HYPER, tries=1), prior, asked=[None])
    assert "asked" not in free.attempt.as_json()
    np.testing.assert_array_equal(free.poses, weighed.poses)
    unaware = replace(HYPER, manoeuvre_weight=HyperParameters().manoeuvre_weight)
    assert unaware.fingerprint == HYPER.fingerprint
