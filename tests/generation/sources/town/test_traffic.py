"""The town drives like seven nuScenes-mini recordings (docs/data.md): bounds are theirs, or those of issue 64."""

from pathlib import Path
from typing import Final

import pytest

from adapters.models import baselines, build_baseline
from benchmark.datasets.roots import open_data
from benchmark.fairness.traffic import measure_scenes
from benchmark.records.statistics import TrafficStatistics
from generation.sources.mini import TownSettings, build_town_data_set
from generation.sources.town import DEFAULT_VAL_SCENES

HEADWAYS: Final = {"leader_within_1_s": (0.0, 0.0), "follower_within_1_s": (0.0, 0.0)}
FIGURES: Final = HEADWAYS | {
    "leader_within_3_s": (0.20, 0.35),
    "leader_headway_s": (1.70, 2.02),
    "follower_within_3_s": (0.12, 0.25),
    "follower_headway_s": (2.29, 3.21),
    "speed_m_s": (3.2, 10.2),
    "acceleration_m_s2": (0.0, 0.77),
    "curvature_1_m": (0.0005, 0.0231),
    "standing": (0.10, 0.30),
    "turning": (0.107, 0.406),
    "junction": (0.0, 0.308),
    "road_users": (5.6, 26.7),
    "pedestrians": (1.5, 12.0),
    "parked": (0.158, 0.778),
    "oncoming": (0.0, 1.0),
    "crossing": (0.125, 0.85),
    "hidden": (0.024, 0.271),
}
RATES: Final = {
    "stop": (0.15, 0.30),
    "constant-velocity": (0.05, 0.09),
    "constant-velocity-on-path": (0.0, 0.01),
    "ego-status": (0.0, 0.281),
    "idm": (0.0, 0.0),
    "log-replay": (0.0, 0.0),
    "noisy-log": (0.0, 0.01),
    "noisy-log-published": (0.001, 0.071),
}
"""Collisions within 3 s, `exact`."""
NOISY_LOG_AVERAGE: Final = 0.001


def measure(root: Path, scenes: int, draws: dict[str, int]) -> TrafficStatistics:
    data = open_data(build_town_data_set(root, TownSettings(val_scenes=scenes, images=False, version=2), workers=1))
    return measure_scenes(data, data.scene_names("val"), draws, build_baseline)


def list_misses(traffic: TrafficStatistics, figures: dict[str, tuple[float, float]]) -> dict[str, float | None]:
    rates = {name: RATES[name] for name in traffic.planners}
    known = {name: traffic.figures[name].value for name in figures}
    known |= {name: traffic.planners[name].collision["3s"].value for name in rates}
    misses = {}
    for name, (least, most) in (figures | rates).items():
        value = known[name]
        if value is None or not least <= value <= most:
            misses[name] = value
    return misses


def test_the_first_scenes_leave_a_driver_time_and_room(tmp_path: Path) -> None:
    draws = {"constant-velocity-on-path": 1, "log-replay": 1, "idm": 1, "noisy-log": 2}
    traffic = measure(tmp_path, 6, draws)
    assert not list_misses(traffic, HEADWAYS)
    around = [traffic.figures[name].value for name in ("oncoming", "crossing", "parked", "pedestrians", "standing")]
    assert all(value is not None and value > 0.1 for value in around)


@pytest.mark.slow
def test_all_scenes_are_within_what_was_recorded(tmp_path: Path) -> None:
    traffic = measure(tmp_path, DEFAULT_VAL_SCENES, {name: model.draws for name, model in baselines().items()})
    assert not list_misses(traffic, FIGURES)
    average = traffic.planners["noisy-log"].collision["avg"].value
    assert average is not None and average <= NOISY_LOG_AVERAGE
