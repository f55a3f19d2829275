"""Why the further protocols differ from exact: the ladder explains each of their own rules."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.geometry import Floats
from benchmark.metrics.disagreement import explain_disagreements
from benchmark.protocols import PROTOCOLS
from benchmark.truth import SampleTruth
from tests.benchmark.metrics.test_disagreement import STRAIGHT, Object, truth

CAR = Object([0.0, 12.5])
STANDING = np.zeros((6, 2))


def cause_of(name: str, sample: SampleTruth, plan: Floats = STRAIGHT) -> str | None:
    """Why a protocol differs from exact; the recorded ego stands, so that no warp moves anything."""
    still = replace(sample, index=2, ego_future=np.tile([0.0, 0.0, np.pi / 2], (6, 1)))
    judged = {each: PROTOCOLS[each].evaluate([still], plan[None]) for each in ("exact", name)}
    (found,) = explain_disagreements([still], plan[None], judged)
    return found.get(name)


@pytest.mark.parametrize("name", ["stp3", "bev-planner", "omnidrive", "safemvdrive", "safemvdrive-box", "agent-driver"])
def test_a_car_parked_in_the_way_is_seen(name: str) -> None:
    assert cause_of(name, truth(CAR)) is None and cause_of(name, truth()) is None


def test_who_was_hidden_before_cannot_be_hit_in_stp3() -> None:
    hidden = replace(truth(CAR), seen_before=np.zeros(1, dtype=np.bool_))
    assert cause_of("stp3", hidden) == "miss: not annotated now or since"
    assert cause_of("bev-planner", hidden) is None


def test_classes() -> None:
    adult = truth(Object([0.0, 12.5], "human.pedestrian.adult", size=(2.0, 2.0)))
    assert cause_of("stp3", adult) is None
    for name in ("bev-planner", "omnidrive", "safemvdrive", "opendrivevla", "agent-driver"):
        assert cause_of(name, adult) == "miss: class not counted"


def test_points() -> None:
    unseen = truth(Object([0.0, 12.5], points=False, lidar_points=False))
    by_radar = truth(Object([0.0, 12.5], lidar_points=False))
    assert cause_of("bev-planner", unseen) == "miss: no sensor points" and cause_of("bev-planner", by_radar) is None
    for name in ("safemvdrive-box", "agent-driver-stp3"):
        assert cause_of(name, by_radar) == "miss: no sensor points"
    for name in ("safemvdrive-box-all", "omnidrive", "stp3"):
        assert cause_of(name, unseen) is None


def test_who_appears_later_cannot_be_hit_where_objects_are_those_of_now() -> None:
    appearing = truth(Object([0.0, 12.5], annotated=(False, *(True,) * 6)))
    assert cause_of("omnidrive", appearing) == "miss: not annotated now or since"
    assert cause_of("bev-planner", appearing) is None


def test_latched_verdicts_have_no_causes_of_their_own() -> None:
    sample = truth(Object([0.0, 12.5], size=(1.0, 1.9)))
    latched = PROTOCOLS["safemvdrive-box"].evaluate([sample], STRAIGHT[None])
    assert not latched.step("at_step")[0].all() and latched.collision[0].tolist() == sorted(
        latched.collision[0].tolist()
    )
    assert cause_of("safemvdrive-box", sample) is None
