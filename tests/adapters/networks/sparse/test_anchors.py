"""Anchors from a data set, and beside those of a checkpoint."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.networks.sparse.anchors import (
    BOXES,
    FORECASTS,
    LINES,
    PLANS,
    AnchorSamples,
    add_anchors,
    cluster_anchors,
    find_cluster_centres,
)
from benchmark.errors import InputError
from tests.adapters.networks.sparse.miniature import MINIATURE, filled, frame


def sightings(seed: int = 0) -> AnchorSamples:
    generator = np.random.default_rng(seed)
    return AnchorSamples(
        box_centres=generator.uniform(-70, 70, (400, 3)),
        line_centres=generator.uniform(-30, 30, (80, 2)),
        futures=[generator.normal(size=(30, 12, 2)).cumsum(1) for _ in range(10)],
        plans=[generator.normal(size=(20, 6, 2)).cumsum(1) for _ in range(3)],
    )


def test_clusters_that_are_far_apart_are_found() -> None:
    generator = np.random.default_rng(1)
    middles = np.array([[0.0, 0], [50, 0], [0, 50], [50, 50]])
    points = np.concatenate([middle + generator.normal(size=(40, 2)) for middle in middles])
    found = find_cluster_centres(points, 4, "points")
    expected = points.reshape(4, 40, 2).mean(1)
    np.testing.assert_allclose(found[np.lexsort(found.round().T)], expected, atol=1e-9)
    assert np.array_equal(found, find_cluster_centres(points, 4, "points")), "the same points give the same centres"


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), clusters=st.integers(1, 9))
def test_every_centre_is_the_mean_of_what_is_nearest_to_it(seed: int, clusters: int) -> None:
    points = np.random.default_rng(seed).normal(size=(60, 3))
    found = find_cluster_centres(points, clusters, "points")
    nearest = np.linalg.norm(points[:, None] - found, axis=-1).argmin(1)
    for cluster in range(clusters):
        np.testing.assert_allclose(found[cluster], points[nearest == cluster].mean(0), atol=1e-6)


def test_anchors_have_the_form_of_the_published_ones_and_fit_the_network() -> None:
    made = cluster_anchors(sightings(), MINIATURE)
    network = filled("sparsedrive")
    network.load_state_dict({**network.state_dict(), **made}, strict=True)
    with torch.inference_mode():
        assert torch.isfinite(network(frame(0)).plan).all()
    boxes, lines = made[BOXES], made[LINES].view(-1, 4, 2)
    assert bool((boxes[:, 3:] == torch.tensor([1.0, 1, 1, 1, 0, 0, 0, 0])).all())
    assert float(boxes[:, :2].norm(dim=-1).max()) <= 55
    torch.testing.assert_close(lines[:, -1] - lines[:, 0], torch.tensor([0.0, 8]).expand(9, -1))
    assert made[FORECASTS].shape == (10, 6, 12, 2) and made[PLANS].shape == (3, 6, 6, 2)


def test_rare_classes_repeat_and_unseen_ones_stand_still() -> None:
    seen = sightings()
    futures = [np.ones((2, 12, 2)) * [[[1.0]], [[2.0]]], np.zeros((0, 12, 2)), *seen.futures[2:]]
    made = cluster_anchors(replace(seen, futures=futures), MINIATURE)[FORECASTS]
    assert made[0, :, 0, 0].tolist() == [1, 2, 1, 2, 1, 2]
    assert not made[1].any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"box_centres": np.zeros((400, 3))}, "1 different boxes within 55 m but anchors need 24"),
        ({"line_centres": []}, "0 different map elements"),
        ({"plans": [np.ones((9, 6, 2))] * 3}, "plans of command 0"),
        ({"plans": []}, "plans of 3 commands"),
        ({"futures": [np.zeros((4, 5, 2))] * 10}, "N x 12 x 2"),
        ({"box_centres": np.full((400, 3), np.nan)}, "NaN"),
    ],
)
def test_data_sets_that_do_not_do_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        cluster_anchors(replace(sightings(), **changes), MINIATURE)  # type: ignore[arg-type]


def test_a_checkpoint_keeps_its_anchors_and_others_are_an_error() -> None:
    made = cluster_anchors(sightings(), MINIATURE)
    state = dict(filled("sparsedrive").state_dict()) | made
    trained = state | {BOXES: state[BOXES] + 0.3}
    assert torch.equal(add_anchors(trained, made)[BOXES], trained[BOXES]), "training moved it"
    without = {name: tensor for name, tensor in state.items() if name != PLANS}
    assert torch.equal(add_anchors(without, made)[PLANS], made[PLANS])
    with pytest.raises(InputError, match=r"trained with other anchors: head.motion_plan_head.motion_anchor"):
        add_anchors(state, cluster_anchors(sightings(5), MINIATURE))
    with pytest.raises(InputError, match="have shape"):
        add_anchors(state, made | {LINES: made[LINES][:3]})
