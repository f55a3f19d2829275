"""The life of tracks, one instance after the other, beside the code that treats all at once."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.track_memory import SAVE_EVERY, MemoryBank, QueryInteraction
from adapters.networks.uniad.tracking import (
    EGO,
    NO_TRACK,
    PATIENCE,
    Detections,
    Instances,
    Pose,
    move_references,
    select_tracks,
    update_tracks,
)
from tests.adapters.networks.uniad.small_uniad import SMALL

FRESH = 5
APART = replace(SMALL, tracks_apart=0.5)
EASY = replace(SMALL, born_score=0.35, asleep_score=0.2)
CPU = torch.device("cpu")


def instances(count: int, seed: int = 0) -> Instances:
    generator = torch.Generator().manual_seed(seed)

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(count, *shape, generator=generator)

    empty = Instances.fresh(SMALL, noise(32), noise(3))
    return replace(empty, box_codes=noise(10), class_logits=noise(10), states=noise(16), memory=noise(4, 16))


def detections(scores: list[float]) -> Detections:
    logits = torch.full((1, len(scores), 10), -9.0)
    logits[0, :, 3] = torch.logit(torch.tensor(scores))
    count = len(scores)
    return Detections(torch.zeros(1, count, 16), logits, torch.zeros(1, count, 10), torch.zeros(count, 3))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.lists(st.sampled_from([0.1, 0.34, 0.36, 0.39, 0.41, 0.9]), min_size=9, max_size=9), max_size=12),
    st.sampled_from([SMALL, EASY]),
)
def test_life_cycle_against_a_loop(history: list[list[float]], config: UniADConfig) -> None:
    """Nine instances over many frames, none of which is dropped here."""
    known, next_id = instances(9), torch.tensor(7)
    ids, asleep, number = [NO_TRACK] * 9, [0] * 9, 7
    for scores in history:
        known, next_id = update_tracks(known, detections(scores), FRESH, next_id, config)
        ids[FRESH - 1] = EGO
        for place, score in enumerate(scores):
            if score >= config.born_score:
                asleep[place] = 0
            if ids[place] == NO_TRACK and score >= config.born_score:
                ids[place], number = number, number + 1
            elif ids[place] >= 0 and score < config.asleep_score:
                asleep[place] += 1
                if asleep[place] >= PATIENCE:
                    ids[place] = NO_TRACK
        assert known.track_ids.tolist() == ids
        assert known.frames_asleep.tolist() == asleep
        assert int(next_id) == number


def rotation(angle: float) -> np.ndarray[Any, Any]:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


@settings(max_examples=30, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-5, 5), st.floats(0.0, 2.0))
def test_moved_tracks_against_poses_in_double_precision(then: float, now: float, shift: float, step_s: float) -> None:
    tracks = instances(6, seed=1)
    first, second = (
        Pose.of(torch.from_numpy(rotation(angle)), torch.tensor([410.0 + x, 1180.0, 1.8]), 100.0 + time, CPU)
        for angle, x, time in ((then, 0.0, 0.0), (now, shift, step_s))
    )
    low, high = np.array(SMALL.perception_range_m[:3]), np.array(SMALL.perception_range_m[3:])
    place = tracks.reference_logits.sigmoid().double().numpy() * (high - low) + low
    place[:, :2] += tracks.box_codes[:, 8:].double().numpy() * step_s
    world = place @ rotation(then) + np.array([410.0, 1180.0, 1.8])
    expected = (world - np.array([410.0 + shift, 1180.0, 1.8])) @ np.linalg.inv(rotation(now))
    shares = np.clip((expected - low) / (high - low), 1e-5, 1 - 1e-5)
    moved = move_references(tracks, first, second, SMALL).sigmoid().numpy()
    np.testing.assert_allclose(moved, shares, atol=2e-4)


def test_memory_against_one_instance_at_a_time() -> None:
    torch.manual_seed(0)
    bank = MemoryBank(16, 2).eval()
    attention = torch.nn.MultiheadAttention(16, 2, batch_first=True).eval()
    known = instances(5, seed=2)
    empty = torch.tensor([[1, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]], dtype=torch.bool)
    known = replace(
        known,
        memory_empty=empty,
        frames_to_save=torch.tensor([0.0, 3.0, 1.0, 0.0, 0.0]),
        scores=torch.tensor([0.5, 0.5, 0.5, 0.5, 0.0]),
    )
    attention.load_state_dict(bank.temporal_attn.state_dict())
    with torch.no_grad():
        after = bank(known)
        for place in range(5):
            state = known.states[place]
            if not empty[place, -1]:
                slots = known.memory[place][~empty[place]]
                seen = attention(state[None, None], slots[None], slots[None])[0][0, 0]
                state = bank.temporal_norm1(state + seen)
                state = bank.temporal_norm2(state + bank.temporal_fc2(bank.temporal_fc1(state).relu()))
            torch.testing.assert_close(after.states[place], state)
            due = bool(known.frames_to_save[place] == 0) and bool(known.scores[place] > 0)
            memory = torch.cat([known.memory[place, 1:], bank.save_proj(state)[None]]) if due else known.memory[place]
            torch.testing.assert_close(after.memory[place], memory)
    assert after.frames_to_save.tolist() == [SAVE_EVERY, 2.0, 0.0, SAVE_EVERY, 0.0]
    assert after.memory_empty.tolist() == [
        [True, True, True, False],
        [True, True, True, False],
        [True, True, False, False],
        [False] * 4,
        [True, False, False, False],
    ]


def test_tracks_come_and_go_without_touching_each_other() -> None:
    """Interaction of no track is no track; of one, it is its own."""
    torch.manual_seed(0)
    interaction = QueryInteraction(16, 2).eval()
    with torch.no_grad():
        assert len(interaction(instances(0)).queries) == 0
        some = interaction(instances(4))
    assert some.queries.shape == (4, 32) and torch.equal(some.states, instances(4).states)


@given(st.integers(0, 60), st.integers(0, 2**31), st.floats(0.2, 1.5), st.booleans())
@settings(max_examples=25, deadline=None)
def test_what_is_chosen_at_once_is_what_is_chosen_one_by_one(
    count: int, seed: int, spread: float, broken: bool
) -> None:
    generator = torch.Generator().manual_seed(seed)
    known = instances(count, seed=seed)
    codes = known.box_codes * torch.tensor([15.0, 15.0, 1, 1, 8.0, 1, 1, 1, 1, 1]) * spread
    if broken and count:
        codes[0, 0] = float("nan")
    known = replace(
        known,
        scores=torch.rand(count, generator=generator),
        box_codes=codes,
        class_logits=torch.randn(count, SMALL.agent_classes, generator=generator),
        track_ids=torch.randint(-2, 9, (count,), generator=generator),
    )
    vehicle = torch.arange(SMALL.agent_classes) < 5
    found = select_tracks(known, vehicle, SMALL)
    living = [p for p in range(count) if known.track_ids[p] >= 0]
    awake = sorted((p for p in living if known.scores[p] >= SMALL.asleep_score), key=lambda p: -float(known.scores[p]))
    best = awake[: SMALL.max_boxes]
    near = [p for p in best if abs(codes[p, 0]) <= 22 and abs(codes[p, 1]) <= 18 and abs(codes[p, 4]) <= 10]
    assert found.reported.tolist() == near and found.surviving.tolist() == living
    assert found.vehicles.tolist() == [
        order for order, p in enumerate(near) if bool(vehicle[int(known.class_logits[p].argmax())])
    ]


def placed(scores: list[float], places_m: list[tuple[float, float]]) -> Detections:
    """Cars of 4.6 m at given places."""
    found = detections(scores)
    codes = torch.zeros(1, len(scores), 10)
    codes[0, :, :2] = torch.tensor(places_m)
    codes[0, :, 2], codes[0, :, 3] = math.log(1.9), math.log(4.6)
    return Detections(found.states, found.class_logits, codes, found.reference_logits)


def test_what_a_track_follows_is_not_born_again_and_of_two_tracks_on_one_thing_the_surer_lives() -> None:
    """Fresh ones are 0 to 4, of these the last is the ego; 5 to 8 may be tracks."""
    far = [(100.0 * place, 0.0) for place in range(9)]
    known, next_id = update_tracks(
        instances(9), placed([0.1] * 5 + [0.9, 0.8, 0.7, 0.1], far), FRESH, torch.tensor(0), APART
    )
    assert known.track_ids.tolist()[5:] == [0, 1, 2, NO_TRACK] and int(next_id) == 3
    near = list(far)
    # A fresh one beside a track, surer than it; two tracks on one thing; a fresh one beside the ego, which is no track.
    near[0], near[6], near[1] = (far[7][0] + 2.2, 0.0), (far[5][0], 2.2), far[4]
    scores = [0.95, 0.9, 0.1, 0.1, 0.9, 0.6, 0.8, 0.7, 0.1]
    after, then = update_tracks(known, placed(scores, near), FRESH, next_id, APART)
    assert after.track_ids.tolist() == [NO_TRACK, 3, NO_TRACK, NO_TRACK, EGO, NO_TRACK, 1, 2, NO_TRACK]
    assert int(then) == 4
    # As published nothing is compared.
    as_published, last = update_tracks(known, placed(scores, near), FRESH, next_id, SMALL)
    assert as_published.track_ids.tolist() == [3, 4, NO_TRACK, NO_TRACK, EGO, 0, 1, 2, NO_TRACK] and int(last) == 5


def test_what_sleeps_gives_way_to_what_is_seen_again() -> None:
    far = [(100.0 * place, 0.0) for place in range(9)]
    known, next_id = update_tracks(
        instances(9), placed([0.1] * 5 + [0.9] + [0.1] * 3, far), FRESH, torch.tensor(0), APART
    )
    near = [far[5], *far[1:]]
    after, _ = update_tracks(known, placed([0.9] + [0.1] * 8, near), FRESH, next_id, APART)
    assert after.track_ids.tolist() == [1, NO_TRACK, NO_TRACK, NO_TRACK, EGO] + [NO_TRACK] * 4
