"""Speed laws that keep a gap in front of the ego."""

import numpy as np
import pytest

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import REAR_AXLE_BEHIND_CENTER
from benchmark.geometry import Floats
from generation.extensions.effect.leading import (
    LEAVING_M,
    LEAVING_S,
    LeadLaw,
    compute_leading_stations,
    find_led_ego,
)
from generation.extensions.effect.paths import VehiclePath

LENGTH_M = 4.6
FRAMES = 180


def straight_path() -> VehiclePath:
    path = VehiclePath.of("recorded", np.column_stack([np.arange(0.0, 300.0), np.zeros(300)]))
    assert path is not None
    return path


def ego_boxes(behind_m: float, speed: Floats, aside_m: float = 0.0) -> Floats:
    """(F, 5) boxes of an ego that starts so far behind the path's start."""
    x = -behind_m + np.concatenate([[0.0], np.cumsum(speed[:-1]) / FRAME_HZ])
    count = len(x)
    return np.column_stack([x, np.full(count, aside_m), np.full(count, 4.0), np.full(count, 1.8), np.zeros(count)])


def gaps(boxes: Floats, law: LeadLaw, start_speed: float) -> tuple[Floats, Floats]:
    """Gap in front of the ego and speed, (F,) each, of a vehicle that drives by a law."""
    path = straight_path()
    ego = find_led_ego(path, boxes)
    assert ego is not None
    (station,) = compute_leading_stations([path], [ego], [law], start_speed, LENGTH_M)
    axle = path.at(station)[:, 0]
    rear = axle + (REAR_AXLE_BEHIND_CENTER - 0.5) * LENGTH_M
    return rear - boxes[:, 0] - 2.0, np.gradient(station, 1.0 / FRAME_HZ)


def test_the_ego_comes_up_to_the_gap_and_is_left_behind_at_the_end() -> None:
    law = LeadLaw(1.6, 0)
    gap, speed = gaps(ego_boxes(25.0, np.full(FRAMES, 8.0)), law, 8.0)
    assert gap[0] > 15.0
    settled = gap[100 : FRAMES - round(LEAVING_S * FRAME_HZ)]
    assert settled == pytest.approx(1.6, abs=0.6) and gap.min() > 0.8
    assert gap[-1] > 1.6 + 0.5 * LEAVING_M
    change = np.diff(speed) * FRAME_HZ
    assert change.min() >= -4.2 and change.max() <= 2.2 and speed.min() >= 0.0


def test_it_is_closer_for_a_moment() -> None:
    boxes = ego_boxes(10.0, np.full(FRAMES, 8.0))
    steady, closer = (gaps(boxes, LeadLaw(2.4, times), 8.0)[0] for times in (0, 1))
    assert closer.min() < steady[60:150].min() - 0.7
    assert (closer < 1.5).sum() / FRAME_HZ < 3.0


def test_it_waits_for_an_ego_that_stops() -> None:
    speed = np.concatenate([np.full(60, 8.0), np.linspace(8.0, 0.0, 40), np.zeros(FRAMES - 100)])
    gap, own = gaps(ego_boxes(10.0, speed), LeadLaw(1.6, 0), 8.0)
    assert 0.5 < gap[120] < 3.5 and own[120:150].max() < 1.0


@pytest.mark.parametrize(("aside", "turn"), [(6.0, 0.0), (0.0, np.pi)])
def test_an_ego_elsewhere_or_of_the_other_way_is_not_led(aside: float, turn: float) -> None:
    boxes = ego_boxes(-20.0, np.full(FRAMES, 8.0), aside)
    boxes[:, 4] += turn
    assert find_led_ego(straight_path(), boxes) is None


def test_a_vehicle_never_reverses_to_meet_an_ego_far_behind() -> None:
    _, speed = gaps(ego_boxes(100.0, np.full(FRAMES, 8.0)), LeadLaw(1.1, 0), 5.0)
    assert speed.min() >= 0.0
