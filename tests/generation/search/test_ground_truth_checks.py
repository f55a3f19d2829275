"""No kept adversary takes a step out of the evaluation, whichever native protocol judges."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.constants import EGO_BOX_FROM_LIDAR_M, EGO_LENGTH_M, EGO_WIDTH_M, LIDAR_FROM_REAR_AXLE_M
from benchmark.datasets.roots import open_data
from benchmark.dynamics.bicycle import DriverLimits
from benchmark.protocols import NATIVE_PROTOCOLS, find_masking_protocols
from benchmark.records.attempts import read_attempts
from benchmark.scene import Scene
from generation.pipeline.split import build_split
from generation.search.hyperparameters import HyperParameters
from generation.search.verify import (
    DiscardReason,
    compute_raster_footprints,
    count_masked_steps,
    find_recorded_contacts,
    verify,
)
from generation.splits.format import METRE_DIGITS
from tests.generation.labels.recorded_roads import CHEAP, recorded, write_source
from tests.generation.search.test_verify import START, moved, verdict, with_track
from tests.hand_made import Car, scene_on_straight_road

HYPER = HyperParameters()
LEFT_M = 0.5 * (EGO_WIDTH_M + 1.9)
"""From centre to centre where bodies touch side by side."""


def test_kept_scenes_lose_no_step_to_their_adversary(tmp_path: Path) -> None:
    source = write_source(tmp_path / "recorded", recorded("scene-9901"), recorded("scene-9902", seconds=9.0))
    root = tmp_path / "adv"
    report = build_split(source, "adv", replace(CHEAP, out=root))
    assert report.survived >= 2
    data = open_data(root)
    for name in data.scene_names("adv"):
        truths = data.truth(name)
        assert all(truth.adversaries for truth in truths)
        plans = np.stack([truth.ego_future[:, :2] for truth in truths])
        for protocol in NATIVE_PROTOCOLS:
            adversary = find_masking_protocols()[protocol].evaluate(truths, plans).step("recorded_adversary")
            assert not adversary.any(), (name, protocol)
    written = {attempt.written: attempt for attempt in read_attempts(root / "attempts.jsonl") if attempt.written}
    assert written.keys() == set(data.scene_names("adv"))
    for name, attempt in written.items():
        assert attempt.masked_steps == count_masked_steps(data.scene(name))
    assert set(report.masked_steps) == set(find_masking_protocols())
    assert all(report.masked_steps[name]["adversary"] == 0 for name in NATIVE_PROTOCOLS)
    masked = "because of adversaries / of others: uniad 0 / "
    assert masked in report.summary(verbose=True) and masked not in report.summary()


@pytest.mark.parametrize(
    ("left_m", "reason"), [(LEFT_M + 0.3, DiscardReason.TOUCHES_UNIAD), (LEFT_M + 0.9, None), (-LEFT_M - 0.3, None)]
)
def test_an_adversary_that_a_raster_sees_in_contact_is_discarded(left_m: float, reason: DiscardReason | None) -> None:
    scene = with_track(x=52.0, y=198.25 + left_m)
    finding = verify(scene, 0, START, HYPER, DriverLimits())
    assert (None if finding is None else finding.reason) is reason
    if finding is not None:
        said = finding.as_json()
        contacts = find_recorded_contacts(scene, scene.adversaries, ["uniad"])["uniad"][0]
        assert said == {
            "reason": "touches-under-uniad",
            "frame": int(scene.keyframes[1]),
            "other": "ego",
            "quantity": "steps masked under uniad",
            "value": float(contacts.sum()),
            "limit": 0.0,
        }
        assert contacts.sum() > 10


def test_a_contact_that_vad_alone_sees_has_its_reason() -> None:
    """UniAD's block lags behind, VAD's does not: a car 3 cm ahead of the footprint."""
    center = LIDAR_FROM_REAR_AXLE_M + EGO_BOX_FROM_LIDAR_M
    ahead = Car(50.0 + center + 0.5 * (EGO_LENGTH_M + 4.6) + 0.03, 198.25, 8.1)
    scene = scene_on_straight_road((ahead,), ego_speed=8.1)
    poses = np.column_stack([scene.agents.position[0, START:, :2], scene.agents.yaw[0, START:]])
    scene = scene.with_adversary(0, slice(START, len(scene.timestamps_us)), poses)
    assert verdict(scene) is DiscardReason.TOUCHES_VAD


def test_what_the_track_becomes_in_a_frozen_split_is_looked_at_too() -> None:
    """A track half a millimetre beside the border of a cell is on it once it is rounded."""
    found = set()
    for gap_m in np.arange(0.32, 0.33, 0.0005):
        scene = with_track(x=52.0, y=198.25 + LEFT_M + gap_m + 0.0004)
        frames = slice(START, len(scene.timestamps_us))
        track = np.column_stack([scene.agents.position[0, frames, :2], scene.agents.yaw[0, frames]])
        rounded = scene.with_adversary(0, frames, np.asarray(np.round(track, METRE_DIGITS), np.float64))
        as_is, frozen = (
            bool(find_recorded_contacts(seen, seen.adversaries, ["uniad"])["uniad"][0].any())
            for seen in (scene, rounded)
        )
        if as_is != frozen:
            assert verdict(scene) is DiscardReason.TOUCHES_UNIAD
            found.add((as_is, frozen))
    assert (False, True) in found


def test_contacts_of_the_recording_are_counted_and_no_reason() -> None:
    beside = Car(50.0, 198.25 + LEFT_M + 0.3, 8.0)
    scene = with_track(x=52.0, y=194.75, others=(beside,))
    assert verdict(scene) is None
    steps = count_masked_steps(scene)
    assert set(steps) == set(find_masking_protocols())
    assert steps["uniad"].adversary == steps["vad"].adversary == 0
    assert steps["uniad"].others > 10 and steps["vad"].others > 10
    assert steps["sparsedrive"].others == 0


def test_a_step_at_which_both_touch_is_the_adversarys() -> None:
    beside = Car(50.0, 198.25 + LEFT_M + 0.3, 8.0)
    scene = with_track(x=50.0, y=198.25 + LEFT_M + 0.3, others=(beside,))
    assert count_masked_steps(scene)["uniad"].adversary > 10
    assert count_masked_steps(scene)["uniad"].others == 0


def turning(scene: Scene, radius_m: float = 12.0) -> Scene:
    """The ego on a left bend, at 8 m/s."""
    angle = 8.0 * scene.seconds / radius_m
    position = scene.ego.position.copy()
    position[:, 0] = 50.0 + radius_m * np.sin(angle)
    position[:, 1] = 198.25 + radius_m * (1.0 - np.cos(angle))
    rotation = np.column_stack([np.cos(angle / 2), np.zeros((len(angle), 2)), np.sin(angle / 2)])
    return replace(scene, ego=replace(scene.ego, position=position, rotation=rotation))


def test_footprints_are_what_the_rasters_of_the_steps_before_show() -> None:
    """Something small well inside of a footprint is seen, something well outside of it is not, in a bend as well."""
    scene = turning(with_track(x=52.0, y=194.75, seconds=9.0))
    rng, frames = np.random.default_rng(0), scene.keyframes
    footprints = compute_raster_footprints(scene, frames)
    assert footprints.shape == (len(frames), 6, 5)
    seen = []
    for place in rng.uniform(-4.0, 4.0, (30, 2)):
        poses = np.column_stack([scene.ego.boxes[:, :2] + place, np.full(len(scene.timestamps_us), 0.3)])
        small = replace(scene, agents=replace(scene.agents, size=np.array([[0.6, 0.6, 1.0]])))
        placed = small.with_adversary(0, slice(0, len(poses)), poses)
        found = find_recorded_contacts(placed, placed.adversaries, ("uniad", "vad"))
        either = found["uniad"][0] | found["vad"][0]
        for sample in range(6, len(frames) - 6):
            for step in range(6):
                box = footprints[sample + step + 1, step]
                offset = poses[frames[sample + step + 1], :2] - box[:2]
                cos, sin = np.cos(box[4]), np.sin(box[4])
                along, across = offset @ [cos, sin], offset @ [-sin, cos]
                outside = max(abs(along) - 0.5 * box[2], abs(across) - 0.5 * box[3])
                seen.append((outside, bool(either[sample, step])))
    outside, contact = (np.array(column) for column in zip(*seen))
    assert contact[outside < -0.3].mean() > 0.99 and (outside < -0.3).sum() > 50
    assert not contact[outside > 1.0].any() and (outside > 1.0).sum() > 50


def test_where_the_adversary_was_recorded_before_its_launch_counts_too() -> None:
    close = with_track(x=52.0, y=198.25 + LEFT_M + 0.3)
    away = np.tile([0.0, 0.6], (len(close.timestamps_us) - START, 1))
    finding = verify(moved(close, away), 0, START, HYPER, DriverLimits())
    assert finding is not None and finding.reason is DiscardReason.TOUCHES_UNIAD
    assert finding.frame is not None and finding.frame < START
