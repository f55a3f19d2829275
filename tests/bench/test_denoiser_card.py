"""The measured model card of the trajectory model: two-sample test, tracking, distances, cost of fewer calls."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.denoiser_card import evaluation, sampling_steps, sections
from bench.denoiser_card.__main__ import write_measured_card
from bench.denoiser_card.drawing import asked, drawn_again, replayed
from bench.denoiser_card.evaluation import compare_with_held_out, load_held_out
from bench.denoiser_card.feasibility import track
from bench.denoiser_card.sampling_steps import FULL_CALLS, full_process_costs
from bench.denoiser_card.two_sample import (
    FEATURES,
    energy_distance,
    motion_features,
    permutation_test,
    rejection_rate,
)
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256
from generation.diffusion.bank import write_bank
from generation.diffusion.checkpoint import load_denoiser, save_denoiser
from generation.diffusion.denoiser import PACKAGED, DenoiserConfig, TrajectoryDenoiser
from generation.diffusion.kinematics import motion
from generation.extensions.denoiser_training.card import write_model_card
from tests.generation.extensions.denoiser_training.test_tracks import drive, write_tracks


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def energy_distance_by_loops(first: Floats, second: Floats) -> float:
    """The definition, pair by pair."""

    def mean(one: Floats, other: Floats) -> float:
        return float(np.mean([[np.sqrt(((a - b) ** 2).sum()) for b in other] for a in one]))

    return 2 * mean(first, second) - mean(first, first) - mean(second, second)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), sizes=st.tuples(st.integers(1, 12), st.integers(1, 12)), features=st.integers(1, 4))
def test_energy_distance_is_its_definition(seed: int, sizes: tuple[int, int], features: int) -> None:
    first, second = (rng(seed + index).standard_normal((size, features)) for index, size in enumerate(sizes))
    expected = energy_distance_by_loops(first, second)
    assert energy_distance(first, second) == pytest.approx(expected, abs=1e-9)
    assert energy_distance(second, first) == pytest.approx(expected, abs=1e-9)
    assert expected >= -1e-12


def test_equal_gaussians_are_told_apart_as_rarely_as_promised() -> None:
    draw = rng(1)
    first, second = draw.standard_normal((2, 4000, 3))
    rate = rejection_rate(first, second, 40, 200, draw)
    assert rate is not None
    assert 0.01 <= rate <= 0.10


@pytest.mark.parametrize(("shift", "stretch"), [(0.7, 1.0), (0.0, 2.5)])
def test_shifted_and_stretched_gaussians_are_told_apart(shift: float, stretch: float) -> None:
    draw = rng(2)
    first, second = draw.standard_normal((2, 1000, 3))
    distance, p_value = permutation_test(first[:100], shift + stretch * second[:100], draw)
    assert distance > 0.1
    assert p_value == 1 / 200
    assert rejection_rate(first, shift + stretch * second, 100, 20, draw) == 1.0


def test_a_vehicle_is_never_compared_with_itself() -> None:
    apart = np.eye(40)
    assert rejection_rate(apart, apart, 20, 40, rng(6)) == 0.0


def test_p_value_does_not_depend_on_the_unit() -> None:
    first, second = rng(3).standard_normal((2, 30, 2))
    plain = permutation_test(first, second, rng(4))
    scaled = permutation_test(1e6 * first, 1e6 * second, rng(4))
    assert scaled[1] == plain[1]
    assert scaled[0] == pytest.approx(1e6 * plain[0])


def test_the_same_draws_twice_are_never_told_apart() -> None:
    same = rng(5).standard_normal((20, 2))
    distance, p_value = permutation_test(same, same, rng())
    assert (abs(distance) < 1e-9, p_value) == (True, 1.0)


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (np.zeros((0, 2)), np.zeros((3, 2)), "rows of the same features"),
        (np.zeros((3, 2)), np.zeros((3, 1)), "rows of the same features"),
        (np.full((3, 2), np.nan), np.zeros((3, 2)), "NaN or infinity"),
    ],
)
def test_samples_that_cannot_be_compared_are_refused(first: Floats, second: Floats, words: str) -> None:
    with pytest.raises(InputError, match=words):
        energy_distance(first, second)


def test_too_few_draws_give_no_rate() -> None:
    assert rejection_rate(np.zeros((19, 1)), np.zeros((19, 1)), 10, 5, rng()) is None


def test_features_of_a_steady_turn() -> None:
    yaw = 0.2 * 0.5 * np.arange(-1, 17)
    path = np.column_stack([40 * np.sin(yaw), 40 * (1 - np.cos(yaw)), yaw])
    features = dict(zip(FEATURES, motion_features(motion(path[None, 2:], path[0]))[0], strict=True))
    assert features["speed after 8 s, m/s"] == pytest.approx(8.0, abs=0.01)
    assert features["mean lateral acceleration, m/s^2"] == pytest.approx(1.6, abs=0.1)
    assert features["turn over 8 s, rad"] == pytest.approx(1.6, abs=0.06)
    assert abs(features["mean acceleration, m/s^2"]) < 0.01


def straight(speeds: Floats) -> Floats:
    """(16, 3) waypoints at the given speeds of each half second."""
    return np.column_stack([np.cumsum(0.5 * speeds), np.zeros((16, 2))])


def test_steady_driving_is_followed_and_hard_braking_needs_the_limits() -> None:
    steady = straight(np.full(16, 8.0))
    braking = straight(np.maximum(8.0 - 3.9 * np.arange(1, 17), 0.0))
    sideways = steady + np.column_stack([np.zeros(16), 4.0 * (np.arange(16) % 2), np.zeros(16)])
    followed = track(np.stack([steady, braking, sideways])[None], np.array([[-4.0, 0.0, 0.0]]))
    assert followed.error_m.shape == (3, 16)
    assert followed.error_m[0].max() < 0.3
    assert followed.error_m[2].max() > 1.0
    assert list(followed.limited) == [False, True, True]
    assert followed.share_within(1.0, 8) == pytest.approx(1 / 3)
    assert followed.share_limited == pytest.approx(2 / 3)


def test_speed_and_steering_now_are_read_from_the_past() -> None:
    yaw = 0.2 * 0.5 * np.arange(-1, 17)
    path = np.column_stack([40 * np.sin(yaw), 40 * (1 - np.cos(yaw)), yaw])
    turning = track(path[None, None, 2:], path[None, 0])
    from_straight = track(path[None, None, 2:], np.array([[-4.0, 0.0, 0.0]]))
    assert turning.error_m[0, 1] < 0.5 * from_straight.error_m[0, 1]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Tracks of two sources, one of them held out, and figures small enough for a test."""
    torch.set_num_threads(1)
    draw = rng(7)
    for name, count in (("made_up", 8), ("interaction_sample", 12)):
        made = [
            drive(
                np.clip(draw.uniform(5, 12) + draw.uniform(-0.1, 0.1) * np.arange(120), 2, 20), draw.uniform(-0.1, 0.1)
            )
            for _ in range(count)
        ]
        write_tracks(tmp_path / f"{name}.npz", made, source=np.array(name))
    monkeypatch.setattr(evaluation, "TEST_SIZES", (4, 100))
    monkeypatch.setattr(sections, "TEST_SIZES", (4, 100))
    monkeypatch.setattr(evaluation, "TRACKED_STARTS", 5)
    monkeypatch.setattr(evaluation, "REPLAYED", 200)
    monkeypatch.setattr(sampling_steps, "FULL_SAMPLES", 64)
    return tmp_path


@pytest.fixture
def weights(folder: Path) -> Path:
    torch.manual_seed(0)
    small = DenoiserConfig(feature_dim=16, heads=2, layers=1, feedforward_dim=16, history_tokens=0, preconditioned=True)
    denoiser = TrajectoryDenoiser(small)
    assert denoiser.preconditioner is not None
    denoiser.preconditioner.fit(load_held_out(folder).replayed)
    path = folder / "denoiser.safetensors"
    facts = {"seed": 0, "steps": 1, "batch": 1, "windows": {"made_up": 3}, "licences": {"made_up": "none"}}
    save_denoiser(path, denoiser.eval(), facts)
    write_bank(path, count=128)
    return path


def test_report_is_the_same_every_time_and_says_what_was_compared(folder: Path, weights: Path) -> None:
    held_out = load_held_out(folder)
    assert len(np.unique(held_out.vehicle)) == 12
    assert len(held_out.replayed) == 200
    report = compare_with_held_out(weights, held_out)
    again = compare_with_held_out(weights, load_held_out(folder))
    assert report.comparisons == again.comparisons
    assert report.told_apart == again.told_apart
    assert report.told_apart.vehicles == 12
    assert report.told_apart.rates["samples"][1] is None
    assert list(report.told_apart.rates) == ["samples", "replay", "replay of held-out", "held-out"]
    assert 0 < report.denoising_error[1] < report.denoising_error[100]
    assert report.tracking["held-out"].error_m.shape == (5, 16)


def test_fewer_calls_are_compared_with_all_calls(folder: Path, weights: Path) -> None:
    costs = full_process_costs(weights, load_held_out(folder))
    assert [(cost.process, cost.calls) for cost in costs[:2]] == [("reference", 100), ("solver", FULL_CALLS[0])]
    assert [cost.calls for cost in costs[1:]] == list(FULL_CALLS)
    assert (costs[0].from_reference, costs[0].off_m) == (0.0, None)
    assert all(cost.from_reference > 0 for cost in costs[1:])
    off = [cost.off_m or 0.0 for cost in costs[1:]]
    assert all(0 < more < fewer for more, fewer in itertools.pairwise(off))


def test_card_is_written_from_measurements(folder: Path, weights: Path) -> None:
    text = write_measured_card(weights, folder).read_text()
    for words in ("Two-sample test", "Can a car follow them?", "full processes", "| held-out |", "| n = 4 |"):
        assert words in text
    assert text == write_measured_card(weights, folder).read_text()
    assert not any(line.endswith("nan |") for line in text.splitlines())


def test_card_puts_another_model_beside_measured_in_the_same_run(folder: Path, weights: Path) -> None:
    other = weights.with_name("other.safetensors")
    other.write_bytes(weights.read_bytes())
    text = write_measured_card(weights, folder, other).read_text()
    section = text.partition("## Beside another model")[2].partition("## ")[0]
    assert file_sha256(other) in section
    rows = [row.split("|")[1:-1] for row in section.splitlines() if row.startswith("| ")][1:]
    assert len(rows) == 6
    assert all(this == that for _, this, that in rows)


def test_sources_ask_for_each_start(weights: Path) -> None:
    """A network that is told the speed answers other speeds with other actions, one that is not does not."""
    slow, fast = np.tile([-1.0, 0.0, 0.0], (8, 1)), np.tile([-8.0, 0.0, 0.0], (8, 1))
    untold = asked(load_denoiser(weights))
    np.testing.assert_array_equal(untold(slow, rng(1)), untold(fast, rng(1)))
    torch.manual_seed(1)
    network = TrajectoryDenoiser(replace(PACKAGED, feature_dim=16, feedforward_dim=16)).eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    assert np.abs(asked(network)(slow, rng(1)) - asked(network)(fast, rng(1))).max() > 0.01


def test_draws_are_repeated_until_they_can_be_driven() -> None:
    braking, steady = np.zeros((2, 16, 3))
    braking[0, 0] = -1.0
    draws = replayed(np.stack([braking, steady]))
    previous = np.tile([-1.0, 0.0, 0.0], (200, 1))
    once, again = (motion(drawn_again(draws, previous, rng(), attempts), previous).excess for attempts in (1, 64))
    assert 0.3 < (once > 0).mean() < 0.7
    assert not again.any()


def test_card_without_held_out_sources_says_so(folder: Path, weights: Path) -> None:
    (folder / "interaction_sample.npz").unlink()
    text = write_measured_card(weights, folder).read_text()
    assert "Not measured" in text
    assert "Two-sample" not in text
    assert "INTERACTION" not in text


def test_card_of_the_training_command_says_how_to_measure(folder: Path, weights: Path) -> None:
    text = write_model_card(weights, folder).read_text()
    assert "python -m bench.denoiser_card" in text
    assert "Two-sample" not in text
    assert "Not trained on, they only check the result: INTERACTION." in text
    assert write_measured_card(weights, folder).read_text().startswith(text.partition("## Measurements")[0])


def test_weights_that_do_not_say_how_they_were_trained_have_no_card(folder: Path, weights: Path) -> None:
    save_denoiser(weights, load_denoiser(weights), {"seed": 0})
    with pytest.raises(InputError, match="does not say its batch, licences, steps, windows"):
        write_model_card(weights, folder)


def test_nothing_to_compare_with_is_refused(folder: Path) -> None:
    (folder / "interaction_sample.npz").unlink()
    with pytest.raises(InputError, match="nothing to compare"):
        load_held_out(folder)
