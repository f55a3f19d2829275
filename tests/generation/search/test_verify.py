from dataclasses import replace

import numpy as np
import pytest

from benchmark.dynamics.bicycle import DriverLimits
from benchmark.fairness.scene_assessment import AdversaryProvenance, assess_scene
from benchmark.geometry import Floats, boxes_overlap
from benchmark.scene import Scene
from generation.labels.labelling import Side, compute_times_to_collision, find_closest_approach, find_side
from generation.search.hyperparameters import HyperParameters
from generation.search.ranking import compute_challenge_score, rank_scenes
from generation.search.recorded_motion import find_log_replay_contacts, is_in_canvas
from generation.search.verify import DiscardReason, VerificationFailure, check_fairness, find_contacts, verify
from tests.hand_made import Car, scene_on_straight_road

HYPER = HyperParameters()
START = 12


def with_track(*, x: float, y: float, speed: float = 8.0, others: tuple[Car, ...] = (), seconds: float = 8.0) -> Scene:
    """The ego drives at 8 m/s from x = 50 on y = 198.25; agent 0 is the adversary."""
    scene = scene_on_straight_road((Car(x, y, speed), *others), seconds=seconds)
    frames = slice(START, len(scene.timestamps_us))
    poses = np.column_stack([scene.agents.position[0, frames, :2], scene.agents.yaw[0, frames]])
    return scene.with_adversary(0, frames, poses)


def moved(scene: Scene, change: Floats) -> Scene:
    """The adversary's track from the launch on, shifted by (F, 2 or 3)."""
    frames = slice(START, len(scene.timestamps_us))
    poses = np.column_stack([scene.agents.position[0, frames, :2], scene.agents.yaw[0, frames]])
    poses[:, : change.shape[1]] += change
    return scene.with_adversary(0, frames, poses)


def verdict(scene: Scene) -> DiscardReason | None:
    finding = verify(scene, 0, START, HYPER, DriverLimits())
    return None if finding is None else finding.reason


def test_a_close_clean_track_is_kept() -> None:
    assert verdict(with_track(x=52.0, y=194.75)) is None


@pytest.mark.parametrize(
    ("scene", "reason"),
    [
        (with_track(x=53.0, y=198.25), DiscardReason.HITS_EGO),
        (with_track(x=56.0, y=194.75, others=(Car(58.0, 194.75, 8.0),)), DiscardReason.HITS_OBJECT),
        (with_track(x=52.0, y=194.75, speed=17.0), DiscardReason.LEAVES_AREA),
        (with_track(x=52.0, y=192.0), DiscardReason.LEAVES_ROAD),
        (with_track(x=70.0, y=194.75), DiscardReason.NEVER_CLOSE),
        (with_track(x=106.5, y=198.25, speed=0.3, seconds=6.0), DiscardReason.EGO_BLOCKED),
    ],
)
def test_each_fault_has_its_reason(scene: Scene, reason: DiscardReason) -> None:
    assert verdict(scene) is reason


def test_the_first_frame_outside_the_area_is_named() -> None:
    scene = with_track(x=52.0, y=194.75, speed=17.0)
    finding = verify(scene, 0, START, HYPER, DriverLimits())
    out = np.flatnonzero(~is_in_canvas(scene, scene.agents.position[0, :, :2], HYPER.half_extent_m))
    assert out[0] > START
    assert finding is not None and finding.frame == out[0]


def test_motion_that_no_driver_could_drive_is_discarded() -> None:
    scene = with_track(x=52.0, y=194.75)
    count = len(scene.timestamps_us) - START
    sideways = np.column_stack([np.zeros(count), 0.1 * np.arange(count)])
    jump = np.column_stack([np.where(np.arange(count) > 30, 1.5, 0.0), np.zeros(count)])
    spin = np.column_stack([np.zeros((count, 2)), 0.2 * np.arange(count)])
    for change in (sideways, jump, spin, np.full((count, 2), np.nan)):
        assert verdict(moved(scene, change)) is DiscardReason.UNDRIVEABLE


def test_contact_between_the_frames_a_metric_sees_is_found() -> None:
    """A dive towards the ego and back within one keyframe interval is invisible at 2 Hz, and the reverse is found."""
    scene = with_track(x=52.0, y=194.75)
    assert not find_log_replay_contacts(scene).any()
    zigzag = scene.annotations.position.copy()
    zigzag[0, 6, 1] = 199.0
    noted = replace(scene, annotations=replace(scene.annotations, position=zigzag))
    assert not boxes_overlap(noted.agents.boxes[0], noted.ego.boxes).any()
    assert find_log_replay_contacts(noted)[0]
    assert not find_log_replay_contacts(noted, np.array([], dtype=np.int64)).any()


def test_contact_with_another_car_that_only_a_reader_of_the_annotations_sees_is_found() -> None:
    scene = with_track(x=52.0, y=194.75, others=(Car(52.0, 205.25, 8.0),))
    assert verdict(scene) is None
    cut = scene.annotations.position.copy()
    cut[0, 6, 1] = 204.5
    assert verdict(replace(scene, annotations=replace(scene.annotations, position=cut))) is DiscardReason.HITS_OBJECT


def test_metric_replay_ignores_absent_annotations() -> None:
    scene = scene_on_straight_road((Car(53.0, 198.25, 8.0),))
    assert find_log_replay_contacts(scene)[0]
    valid = np.zeros_like(scene.annotations.valid)
    assert not find_log_replay_contacts(replace(scene, annotations=replace(scene.annotations, valid=valid))).any()


def test_metric_replay_uses_the_metric_footprint_not_the_body() -> None:
    """1.85 m wide in the metric, 1.73 m the body: a car 4 cm beside the metric's side is clear, 4 cm inside is not."""
    side = 198.25 - 0.5 * 1.85 - 0.5 * 1.9
    assert not find_log_replay_contacts(scene_on_straight_road((Car(52.0, side - 0.04, 8.0),))).any()
    inside = scene_on_straight_road((Car(52.0, side + 0.04, 8.0),))
    assert find_log_replay_contacts(inside)[0]
    assert not boxes_overlap(inside.agents.boxes[0], inside.ego.boxes).any()


def test_touching_others_skips_the_agent_itself_and_absent_ones() -> None:
    scene = scene_on_straight_road((Car(60.0, 194.75, 8.0), Car(62.0, 194.75, 8.0)))
    frames = np.arange(20, 40)
    boxes = scene.agents.boxes[0, frames]
    step, other = find_contacts(boxes, scene, 0, frames)
    np.testing.assert_array_equal(step, np.arange(20))
    assert set(other) == {1}
    valid = scene.agents.valid.copy()
    valid[1, 30:] = False
    half = replace(scene, agents=replace(scene.agents, valid=valid))
    np.testing.assert_array_equal(find_contacts(boxes, half, 0, frames)[0], np.flatnonzero(frames < 30))


def test_a_finding_says_what_shows_it() -> None:
    def finding(scene: Scene) -> dict[str, object]:
        found = verify(scene, 0, START, HYPER, DriverLimits())
        assert found is not None
        return found.as_json()

    struck = with_track(x=56.0, y=194.75, others=(Car(58.0, 194.75, 8.0),))
    assert finding(struck) == {"reason": "hits-an-object", "frame": START, "other": struck.agents.ids[1]}
    far = finding(with_track(x=70.0, y=194.75))
    assert (far["quantity"], far["limit"]) == ("smallest gap, m", HYPER.close_gap_m)
    assert isinstance(far["value"], float)
    assert far["value"] > HYPER.close_gap_m
    jumping = with_track(x=56.0, y=194.75)
    shift = np.zeros((len(jumping.timestamps_us) - START, 2))
    shift[20:, 1] = 2.0
    assert finding(moved(jumping, shift))["quantity"] == "speed sideways, m/s"


def test_side_closest_approach_and_time_to_collision() -> None:
    ego = np.array([0.0, 0.0, 4.0, 2.0, 0.0])
    for place, side in [((9, 1), Side.FRONT), ((-9, 1), Side.REAR), ((1, 3), Side.LEFT), ((-1, -3), Side.RIGHT)]:
        assert find_side(ego, np.array([*place, 4.0, 2.0, 0.0])) is side
    slower = with_track(x=80.0, y=198.25, speed=5.0)
    closest = find_closest_approach(slower, 0, START)
    assert closest.side == Side.FRONT
    assert closest.frame == len(slower.timestamps_us) - 1
    gap = 80.0 - 51.39 - 0.5 * (4.6 + 4.084) - 3.0 * closest.time_s
    assert closest.gap_m == pytest.approx(gap, abs=1e-4)
    assert compute_times_to_collision(slower, 0, START).min() == pytest.approx(np.ceil(10 * gap / 3.0) / 10, abs=0.11)
    assert np.isinf(compute_times_to_collision(with_track(x=52.0, y=194.75), 0, START)).all()


def test_a_standing_ego_is_not_challenged() -> None:
    moving = with_track(x=52.0, y=194.75)
    position = np.repeat(moving.ego.position[:1], len(moving.timestamps_us), axis=0)
    standing = replace(moving, ego=replace(moving.ego, position=position))
    assert 0.0 < compute_challenge_score(moving, 0, START) <= 1.0
    assert compute_challenge_score(standing, 0, START) == pytest.approx(0.0, abs=1e-9)
    parked = with_track(x=52.0, y=194.75, speed=0.0)
    assert verdict(replace(parked, ego=standing.ego)) is DiscardReason.NEVER_CLOSE
    assert compute_challenge_score(with_track(x=56.0, y=198.25, speed=7.9), 0, START) > compute_challenge_score(
        moving, 0, START
    )


def test_ranking_keeps_the_best_of_each_scene_whatever_the_order() -> None:
    class Result:
        def __init__(self, scene_name: str, agent_id: str, challenge: float) -> None:
            self.scene_name, self.agent_id, self.challenge = scene_name, agent_id, challenge

    results = [Result("a", "1", 0.5), Result("a", "2", 0.9), Result("b", "1", 0.5), Result("c", "1", 0.7)]
    for order in (results, results[::-1]):
        names = [(kept.scene_name, kept.agent_id) for kept in rank_scenes(order, per_scene=1, total=3)]
        assert names == [("a", "2"), ("c", "1"), ("b", "1")]
    assert len(rank_scenes(results, per_scene=None, total=None)) == 4


def test_a_scene_that_a_careful_human_does_not_survive_is_dropped_where_that_is_asked() -> None:
    """The careful human brakes for a slow car ahead, and whoever tailgates runs into it; the recorded ego drives on."""
    slow_ahead = Car(87.0, 198.25, 4.0)
    scene = with_track(x=50.0 - 0.5 * (4.084 + 4.6) - 0.8, y=198.25, others=(slow_ahead,))
    asking = replace(HYPER, careful_survives=True)
    assert verdict(scene) is None
    finding = judged(scene, asking)
    assert finding is not None and finding.reason is DiscardReason.CAREFUL_COLLIDES
    assert finding.other == scene.agents.ids[0]
    assert finding.frame is not None and scene.seconds[finding.frame] > 7.0
    beside = with_track(x=52.0, y=194.75, others=(slow_ahead,))
    assert judged(beside, asking) is None
    assert judged(scene, HYPER) is None


def judged(scene: Scene, hyper: HyperParameters) -> VerificationFailure | None:
    """Whether it asks too much of the ego."""
    return check_fairness(
        scene, assess_scene(scene, AdversaryProvenance(generated=True, launches={scene.agents.ids[0]: START})), hyper
    )
