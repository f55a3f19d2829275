"""What a plan may be made of."""

from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.planning import NoViews, Plan, PlanFrame

AHEAD = np.column_stack([4.0 * np.arange(1, 7), np.zeros(6)])


@pytest.mark.parametrize("frame", ["ego", "lidar"])
def test_a_frame_may_be_given_in_words(frame: Any) -> None:
    plan = Plan(AHEAD, frame)
    assert plan.frame is PlanFrame(frame)
    assert np.array_equal(plan.waypoints_in_lidar(), Plan(AHEAD, PlanFrame(frame)).waypoints_in_lidar())


@pytest.mark.parametrize(("frame", "said"), [("car", "'car'"), (AHEAD, "a ndarray"), (None, "a NoneType")])
def test_what_is_no_frame_is_refused_with_those_there_are(frame: Any, said: str) -> None:
    with pytest.raises(InputError, match=f"the frame of a plan is {said}; use 'ego' .* or 'lidar'"):
        Plan(AHEAD, frame)


def test_views_of_a_world_without_cameras_know_whether_somebody_looked() -> None:
    views = NoViews()
    assert not views.looked and views == {}
    for look in (list, len, lambda seen: seen.get("CAM_FRONT"), lambda seen: seen.items(), lambda seen: "a" in seen):
        views = NoViews()
        look(views)
        assert views.looked
    with pytest.raises(KeyError):
        NoViews()["CAM_FRONT"]
