"""What an adversary considered is kept on request, and is what it chose from."""

from dataclasses import replace

import numpy as np

from benchmark.closed_loop.adversary import AdversaryTrack
from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.geometry import boxes_overlap
from benchmark.records.search_trace import SearchTraceFrame
from benchmark.scene import Scene
from tests.generation.extensions.reactive_adversary.loops import HYPER, SETTINGS, loop, policy_of, road
from tests.hand_made import Car

KEEPING = replace(SETTINGS, keep_considered=True)


def considered(track: AdversaryTrack, scene: Scene) -> list[SearchTraceFrame]:
    found = [SearchTraceFrame.model_validate(each.considered) for each in track.replanned]
    assert [each.frame for each in found] == [each.frame for each in track.replanned]
    assert [each.time_us for each in found] == [int(scene.timestamps_us[each.frame]) for each in found]
    return found


def test_what_was_driven_is_among_it_and_nothing_else_depends_on_it() -> None:
    scene = road(seconds=7.0)
    plain, _, _ = loop(scene, policy_of(scene))
    track, _, _ = loop(scene, policy_of(scene, KEEPING))
    np.testing.assert_array_equal(plain.poses, track.poses)
    assert all(each.considered is None for each in plain.replanned)
    searched = [each for each in considered(track, scene) if each.did == "searched"]
    assert len(searched) >= 3
    for each in searched:
        assert each.chosen is not None and 1 < len(each.candidates) <= HYPER.candidates
        at = each.frame - track.start
        driven = track.poses[at : at + 2 * FRAMES_PER_KEYFRAME + 1 : FRAMES_PER_KEYFRAME, :2]
        chosen = np.array(each.candidates[each.chosen])
        np.testing.assert_allclose(chosen[: len(driven)], driven, atol=0.011)
        # All begin where the adversary is.
        assert np.abs(np.array(each.candidates)[:, 0] - track.poses[at, :2]).max() < 0.02


def test_where_nothing_is_allowed_nothing_is_chosen_and_it_brakes() -> None:
    """A wall of parked trucks across the road: there is no way on, and it stops before them."""
    wall = tuple(Car(85.0, y, category="vehicle.truck", size=(3.0, 4.0, 3.0)) for y in (194.0, 197.5, 201.5, 205.5))
    scene = road(Car(55.0, 194.75, 9.0), *wall, seconds=8.0)
    track, boxes, _ = loop(scene, policy_of(scene, KEEPING))
    assert not boxes_overlap(boxes[:, :1], boxes[:, 1:]).any()
    assert np.hypot(*(boxes[-1, 0] - boxes[-11, 0])[:2]) < 0.5
    assert [each.frame for each in track.replanned] == list(range(12, len(scene.timestamps_us) - 1, 12))
    found = considered(track, scene)
    slowed = [each for each in found if each.did == "slowed"]
    assert slowed and all(each.chosen is None and each.candidates for each in slowed)
    assert [each.did == "slowed" for each in found] == [each.braked for each in track.replanned]


def test_the_scenes_own_track_is_named_and_has_no_candidates() -> None:
    scene = road(Car(62.0, 194.75, 9.0), seconds=6.0)
    made = replace(scene, adversaries=(scene.agents.ids[0],))
    track, _, _ = loop(made, policy_of(made, KEEPING))
    assert {(each.did, each.candidates) for each in considered(track, made)} == {("track", ())}
