from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from benchmark.dynamics.bicycle import MotionModel, VehicleState, simulate
from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from generation.search.hyperparameters import CANDIDATE_FRAMES, CollisionReading, HyperParameters
from generation.search.threat_settings import ThreatSettings

YOUNGER = (
    "timestep_frames", "varied", "init_least", "score", "motion", "choice", "launch", "discards", "manoeuvre_weight",
    "proposal", "ego",
)  # fmt: skip
THREAT: dict[str, Any] = asdict(ThreatSettings())


def other(value: float | bool) -> str:
    """Another value of a setting, as text."""
    return str(not value).lower() if isinstance(value, bool) else str(value + 0.5)


def test_settings_change_by_text() -> None:
    changed = HyperParameters().changed(["clearance_m=0", "rounds = 2", "parked=true", "collision_reading=half"])
    assert changed == HyperParameters(clearance_m=0.0, rounds=2, parked=True, collision_reading=CollisionReading.HALF)
    assert changed.fingerprint != HyperParameters().fingerprint
    assert HyperParameters().changed([]) == HyperParameters()


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("clearence_m=0", "did you mean clearance_m"),
        ("rounds=1000000000", "rounds must be at most 1000, got 1000000000"),
        ("clearance_m", "NAME=VALUE"),
        ("rounds=2.5", "rounds must be a number"),
        ("clearance_m=wide", "clearance_m must be a number"),
        ("clearance_m=nan", "must be finite"),
        ("parked=yes", "true or false"),
        ("collision_reading=exact", "one of geometry, literal, half"),
        ("candidates=0", "at least 1"),
        ("candidates=1000000000", "at most 65536"),
        ("candidates", "NAME=VALUE of a hyper-parameter; names are"),
        ("shortest_drive_frames=0", "at least 1"),
        ("timestep_frames=0", "at least 1"),
        ("timestep_frames=9", "not be more than 96 together"),
        ("score=mine", "one of appendix, reference"),
        ("launch=now", "one of near, start, reference, reach"),
        ("stopping_m_s2=0", "must be positive"),
        ("half_extent_m=-50", "must be positive"),
        ("init_scale=-1", "must not be negative"),
        ("road_and_collision_last_weight=-1", "must not be negative"),
        ("lookahead_frames=85", "not be more than 96 together"),
        ("__class__=3", "NAME=VALUE"),
    ],
)
def test_what_does_not_fit_is_one_sentence(assignment: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        HyperParameters().changed([assignment])


def test_the_paper_has_its_table_and_the_reading_that_shows_its_pattern() -> None:
    paper = HyperParameters.paper()
    assert paper.scored_frames == (*range(1, 13), *range(14, 37, 2))
    assert paper.executed_frames == 12
    assert (paper.clearance_m, paper.headway_s, paper.tries, paper.staying_preference) == (0.25, 0.15, 1, 0.0)
    assert (paper.varied, paper.best_of_all_rounds, paper.parked) == (False, False, False)
    assert paper.motion_model().limits is None and paper.motion_model().dt == 1 / 12
    table = (paper.dac_weight, paper.cr_weight, paper.ac_weight, paper.temperature, paper.rounds, paper.horizon)
    assert table == (5.0, 10.0, 1.0, 1.0, 5, 12)


def test_the_reference_scores_every_pose_and_counts_frames_as_seconds() -> None:
    reference = HyperParameters.reference()
    assert reference.scored_frames == tuple(range(81))
    assert reference.executed_frames == 12
    assert reference.motion_model() == MotionModel.reference()
    assert (reference.varied, reference.best_of_all_rounds, reference.stable_softmax) == (True, False, False)


def test_younger_settings_that_change_nothing_leave_kept_work_where_it_was() -> None:
    """The key of the settings that were kept before there were any of them."""
    before = HyperParameters(**THREAT)
    said = {name: value for name, value in asdict(before).items() if name not in (*YOUNGER, *THREAT, "solvable")}
    assert before.fingerprint == content_key(said)
    keys = {each.fingerprint for each in (HyperParameters(), HyperParameters.paper(), HyperParameters.reference())}
    assert len(keys) == 3
    for assignment in (
        "timestep_frames=2", "varied=false", "init_least=0.02", "score=reference", "motion=unlimited",
        "choice=reference", "launch=start", "discards=paper", "manoeuvre_weight=1",
        "proposal=retimed", "ego=idm",
    ):  # fmt: skip
        keys.add(HyperParameters().changed([assignment]).fingerprint)
    assert len(keys) == 3 + len(YOUNGER)
    keys |= {HyperParameters().changed([f"{name}={other(value)}"]).fingerprint for name, value in THREAT.items()}
    assert len(keys) == 3 + len(YOUNGER) + len(THREAT)


def test_what_is_kept_as_solvable_moves_no_track_and_the_presets_do_not_ask() -> None:
    kept = HyperParameters().changed(["solvable=false"])
    assert HyperParameters().solvable and kept.fingerprint == HyperParameters().fingerprint
    assert not HyperParameters.paper().solvable and not HyperParameters.reference().solvable


def test_the_longest_look_ahead_is_as_long_as_a_candidate() -> None:
    longest = HyperParameters(lookahead_frames=CANDIDATE_FRAMES - 12, lookahead_stride=1)
    assert longest.scored_frames[-1] == CANDIDATE_FRAMES
    state = VehicleState(np.zeros(3), 5.0)
    waypoints = np.zeros((2, 16, 3))
    assert simulate(waypoints, state, 4.0, steps=CANDIDATE_FRAMES, model=MotionModel.si()).finite.all()
