"""The prior that the search draws from: packaged weights, bank, mutation, diversification."""

import pickle
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256
from benchmark.weights.tensors import write_tensors
from generation.diffusion.checkpoint import (
    PACKAGED_WEIGHTS,
    find_bank_path,
    load_denoiser,
    read_bank,
    sample_actions,
    save_denoiser,
    write_bank,
)
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser
from generation.diffusion.kinematics import compute_motion
from generation.diffusion.prior import SOLVER_CALLS, CandidateSource, SamplerSettings, TrajectoryPrior, diversify
from generation.diffusion.standardiser import convert_waypoints_to_actions
from generation.search.proposals import MutationRequest, Request, SamplingRequest

CRUISING = np.array([-4.0, 0.0, 0.0])
SMALL = DenoiserConfig(feature_dim=16, heads=2, layers=1, feedforward_dim=16, history_tokens=1)


@pytest.fixture(scope="module")
def prior() -> TrajectoryPrior:
    torch.set_num_threads(1)
    return TrajectoryPrior.load()


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_package_stays_small_and_says_where_it_comes_from() -> None:
    bank = find_bank_path(PACKAGED_WEIGHTS)
    assert PACKAGED_WEIGHTS.stat().st_size + bank.stat().st_size < 1_500_000
    card = (PACKAGED_WEIGHTS.parent / "MODEL_CARD.md").read_text()
    assert file_sha256(PACKAGED_WEIGHTS) in card
    assert file_sha256(bank) in card
    for source in ("NGSIM", "comma2k19", "nuScenes", "Argoverse 2", "KITTI", "Lyft"):
        assert source in card


def test_samples_are_deterministic_and_seeded(prior: TrajectoryPrior) -> None:
    first, again, other = (prior.sample(64, CRUISING, rng(seed)) for seed in (1, 1, 2))
    assert first.shape == (64, 16, 3)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.array_equal(first, TrajectoryPrior.load().sample(64, CRUISING, rng(1)))


@pytest.fixture(scope="module")
def stored() -> TrajectoryPrior:
    return TrajectoryPrior.load(None, SamplerSettings(samples=CandidateSource.STORED))


def test_stored_samples_are_drawn_without_repetition(stored: TrajectoryPrior) -> None:
    sampled = stored.sample(256, CRUISING, rng())
    assert len(np.unique(sampled.reshape(256, -1), axis=0)) == 256
    # More than there are can be asked for.
    assert stored.sample(5000, CRUISING, rng()).shape == (5000, 16, 3)


def test_fresh_samples_are_none_of_the_stored_ones(prior: TrajectoryPrior, stored: TrajectoryPrior) -> None:
    """Every planning frame has draws of its own, whatever was drawn before."""
    chance = rng(3)
    first, second = prior.sample(128, CRUISING, chance), prior.sample(128, CRUISING, chance)
    everything = np.concatenate([first, second, stored.sample(4096, CRUISING, rng())]).reshape(-1, 48)
    assert len(np.unique(everything.round(9), axis=0)) == 128 + 128 + 4096


def test_fresh_samples_cost_few_network_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where most are drivable, one batch of a quarter more than are asked for."""
    made = TrajectoryPrior.load()
    rows: list[int] = []
    forward = TrajectoryDenoiser.forward

    def counted(self: TrajectoryDenoiser, noisy: torch.Tensor, *told: Any) -> torch.Tensor:
        rows.append(len(noisy))
        return forward(self, noisy, *told)

    monkeypatch.setattr(TrajectoryDenoiser, "forward", counted)
    assert len(made.sample(256, CRUISING, rng())) == 256
    assert rows == [320] * SOLVER_CALLS


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_a_model_that_is_told_the_speed_seldom_brakes_into_reverse(speed: float) -> None:
    """As drawn, without drawing again."""
    previous = np.array([-0.5 * speed, 0.0, 0.0])
    settings = [SamplerSettings(drivable=False, conditioned=conditioned) for conditioned in (True, False)]
    told, untold = (TrajectoryPrior.load(None, asked).sample(256, previous, rng()) for asked in settings)
    shares = [float((compute_motion(drawn, previous).excess == 0).mean()) for drawn in (told, untold)]
    assert shares[0] > shares[1] + 0.1


def wasserstein(first: Floats, second: Floats) -> float:
    """1-Wasserstein distance of two samples of one quantity, by their quantiles, in the unit of the values."""
    at = (np.arange(2000) + 0.5) / 2000
    quantiles = [
        np.interp(at * (values.size - 1), np.arange(values.size), np.sort(values, axis=None))
        for values in (np.asarray(first), np.asarray(second))
    ]
    return float(np.abs(quantiles[0] - quantiles[1]).mean())


def test_bank_and_exact_sampling_have_the_same_distribution() -> None:
    """The distance of both from each other is what chance gives."""
    bank = read_bank(find_bank_path(PACKAGED_WEIGHTS), PACKAGED_WEIGHTS)
    exact = sample_actions(load_denoiser(PACKAGED_WEIGHTS), 64, None, rng(11))
    for channel in range(3):
        for steps in (slice(0, 16), slice(15, 16)):
            pool, drawn = (actions[:, steps, channel].sum(axis=1) for actions in (bank, exact))
            by_chance = [wasserstein(rng(seed).choice(pool, len(drawn)), pool) for seed in range(100)]
            assert wasserstein(drawn, pool) < 1.3 * np.quantile(by_chance, 0.99), (channel, steps)


@pytest.mark.parametrize("speed", [0.0, 5.0, 30.0])
def test_samples_can_be_driven_from_any_speed(prior: TrajectoryPrior, speed: float) -> None:
    previous = np.array([-0.5 * speed, 0.0, 0.0])
    moved = compute_motion(prior.sample(64, previous, rng()), previous)
    assert (moved.excess == 0).mean() > 0.9
    assert np.abs(moved.acceleration).max() < 8


def test_samples_differ_from_each_other(prior: TrajectoryPrior) -> None:
    ends = prior.sample(256, np.array([-5.0, 0.0, 0.0]), rng())[:, -1]
    assert ends[:, 0].std() > 8
    assert ends[:, 1].std() > 3
    assert (ends[:, 1] > 2).any() and (ends[:, 1] < -2).any()


def test_mutation_changes_more_at_higher_noise(prior: TrajectoryPrior) -> None:
    start = prior.sample(128, CRUISING, rng())
    change = [np.abs(prior.mutate(start, level, CRUISING, rng(1)) - start)[..., :2].mean() for level in (1, 3, 5, 20)]
    assert 0.05 < change[0] < change[1] < change[2] < change[3]
    assert change[2] < 5


@pytest.mark.parametrize("speed", [0.0, 2.0, 20.0])
def test_mutation_makes_no_candidate_less_drivable(prior: TrajectoryPrior, speed: float) -> None:
    previous = np.array([-0.5 * speed, 0.0, 0.0])
    start = prior.sample(64, previous, rng())
    candidates = start
    for round_, level in enumerate((5, 4, 3, 2, 1)):
        candidates = prior.mutate(candidates, level, previous, rng(round_))
    assert (compute_motion(candidates, previous).excess <= compute_motion(start, previous).excess + 1e-6).all()
    unchanged = (candidates == start).all(axis=(1, 2)).mean()
    assert unchanged < 0.5
    free = TrajectoryPrior.load(None, SamplerSettings(drivable=False)).mutate(start, 5, previous, rng())
    assert not (free == start).all(axis=(1, 2)).any()


def test_mutation_is_deterministic_and_leaves_its_input_alone(prior: TrajectoryPrior) -> None:
    start = prior.sample(16, CRUISING, rng())
    kept = start.copy()
    first = prior.mutate(start, 5, CRUISING, rng(4))
    assert np.array_equal(start, kept)
    assert np.array_equal(first, prior.mutate(start, 5, CRUISING, rng(4)))


def test_mutation_does_not_mind_wrapped_headings(prior: TrajectoryPrior) -> None:
    start = prior.sample(16, CRUISING, rng())
    start[..., 2] += np.linspace(0.1, 4.0, 16)
    wrapped = start.copy()
    wrapped[..., 2] = (wrapped[..., 2] + np.pi) % (2 * np.pi) - np.pi
    assert (np.abs(wrapped - start) > 6).any()
    assert np.allclose(prior.mutate(start, 5, CRUISING, rng()), prior.mutate(wrapped, 5, CRUISING, rng()), atol=1e-4)


def test_strided_mutation_is_close_to_the_reference_number_of_calls(prior: TrajectoryPrior) -> None:
    """The difference is small beside what two draws of the reference's process differ by."""
    start = prior.sample(128, CRUISING, rng())
    two_calls = TrajectoryPrior.load(None, SamplerSettings(mutation_steps=2))
    reference, other = prior.mutate(start, 5, CRUISING, rng(1)), prior.mutate(start, 5, CRUISING, rng(2))
    strided = two_calls.mutate(start, 5, CRUISING, rng(1))

    def rms(difference: Floats) -> float:
        return float(np.sqrt((difference[..., :2] ** 2).sum(-1).mean()))

    assert rms(strided - reference) < 0.2 * rms(reference - other)
    assert rms(strided - start) == pytest.approx(rms(reference - start), rel=0.1)


def test_quarters_of_the_first_batch() -> None:
    start = np.random.default_rng(0).uniform(1, 2, (41, 16, 3))
    varied = diversify(start, rng())
    ratio = varied / start
    assert np.array_equal(varied[:10], start[:10])
    assert np.allclose(ratio[..., 2], 1)
    assert np.allclose(ratio[:30, :, 1], 1)
    for part, low, high in ((slice(10, 20), 0.2, 0.8), (slice(20, 30), 1.2, 1.8), (slice(30, 41), 0.5, 1.5)):
        assert ratio[part, :, 0].min() >= low and ratio[part, :, 0].max() <= high
        assert np.allclose(ratio[part, :, 0], ratio[part, :1, 0])
    assert np.allclose(ratio[30:, :, 0], ratio[30:, :, 1])


def test_published_kind_of_checkpoint_loads(tmp_path: Path) -> None:
    denoiser = TrajectoryDenoiser(DenoiserConfig(layers=8))
    torch.save(denoiser.state_dict(), tmp_path / "published.ckpt")
    loaded = load_denoiser(tmp_path / "published.ckpt")
    assert not loaded.training
    assert torch.equal(loaded.type_embedding.weight, denoiser.type_embedding.weight)


class _Evil:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (print, ("ran",))


def test_bad_weights_are_refused_with_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = tmp_path / "code.ckpt"
    code.write_bytes(pickle.dumps({"weights": _Evil()}))
    inside = tmp_path / "inside.ckpt"
    torch.save({"weights": _Evil()}, inside)
    empty, broken = tmp_path / "empty.ckpt", tmp_path / "broken.safetensors"
    empty.write_bytes(b"")
    broken.write_bytes(PACKAGED_WEIGHTS.read_bytes()[:1000])
    other = tmp_path / "other.ckpt"
    torch.save({"layer.weight": torch.zeros(2)}, other)
    not_finite = tmp_path / "nan.safetensors"
    denoiser = TrajectoryDenoiser(SMALL)
    torch.nn.init.constant_(denoiser.trajectory_encoder.weight, float("nan"))
    save_denoiser(not_finite, denoiser, {})
    boundless = tmp_path / "boundless.safetensors"
    facts = {"denoiser": {**asdict(SMALL), "layers": 10**400}}
    write_tensors(boundless, TrajectoryDenoiser(SMALL).state_dict(), facts)
    hostile = (code, inside, empty, broken, other, not_finite, boundless, tmp_path / "absent.safetensors", tmp_path)
    for path in hostile:
        with pytest.raises(InputError):
            TrajectoryPrior.load(path)
    assert "ran" not in capsys.readouterr().out


def test_bank_of_other_weights_is_refused(tmp_path: Path) -> None:
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    for seed, path in enumerate((first, second)):
        torch.manual_seed(seed)
        save_denoiser(path, TrajectoryDenoiser(SMALL), {})
    bank = write_bank(first, count=4)
    assert bank.read_bytes() == write_bank(first, count=4).read_bytes()
    asked = SamplerSettings(samples=CandidateSource.STORED)
    assert TrajectoryPrior.load(first, asked).sample(3, CRUISING, rng()).shape == (3, 16, 3)
    with pytest.raises(InputError, match="no stored samples"):
        TrajectoryPrior.load(second, asked)
    bank.rename(find_bank_path(second))
    with pytest.raises(InputError, match="not sampled from"):
        TrajectoryPrior.load(second, asked)
    with pytest.raises(InputError, match="without dropout"):
        TrajectoryPrior.load(second, replace(asked, dropout=True))
    assert TrajectoryPrior.load(second).sample(3, CRUISING, rng()).shape == (3, 16, 3)


def test_settings_are_part_of_the_fingerprint() -> None:
    kinds = [
        TrajectoryPrior.load(),
        TrajectoryPrior.load(None, SamplerSettings(mutation_steps=2)),
        TrajectoryPrior.load(None, SamplerSettings(drivable=False)),
        TrajectoryPrior.load(None, SamplerSettings(samples=CandidateSource.REFERENCE)),
        TrajectoryPrior.load(None, SamplerSettings(samples=CandidateSource.STORED)),
        TrajectoryPrior.load(None, SamplerSettings(solver_calls=6)),
        TrajectoryPrior.load(None, SamplerSettings(conditioned=False)),
        TrajectoryPrior.load(None, SamplerSettings(dropout=True)),
    ]
    assert len({kind.fingerprint for kind in kinds}) == len(kinds)
    assert kinds[0].fingerprint == TrajectoryPrior.load().fingerprint


def test_wrong_use_is_refused(prior: TrajectoryPrior) -> None:
    start = prior.sample(4, CRUISING, rng())
    with pytest.raises(InputError, match="at least one trajectory"):
        prior.sample(0, CRUISING, rng())
    with pytest.raises(InputError, match="finite x, y, heading"):
        prior.sample(4, np.array([np.nan, 0, 0]), rng())
    with pytest.raises(InputError, match="finite x, y, heading"):
        prior.mutate(start, 5, np.zeros(2), rng())
    for level in (0, 101):
        with pytest.raises(InputError, match="noise level"):
            prior.mutate(start, level, CRUISING, rng())
    for wrong in (start[0], start[:, :8], np.full_like(start, np.nan)):
        with pytest.raises(InputError, match="candidates"):
            prior.mutate(wrong, 5, CRUISING, rng())
    with pytest.raises(InputError, match="denoising step"):
        TrajectoryPrior.load(None, SamplerSettings(mutation_steps=0))
    with pytest.raises(InputError, match="2 to 100 network calls"):
        TrajectoryPrior.load(None, SamplerSettings(solver_calls=1))
    for device in ("cuda:77", "toaster", "meta"):
        with pytest.raises(InputError, match="cannot compute on device"):
            TrajectoryPrior.load(device=device)


@pytest.mark.parametrize("block", [None, 96])
@pytest.mark.parametrize("samples", list(CandidateSource))
def test_an_answer_does_not_depend_on_who_asks_beside_it(
    prior: TrajectoryPrior, block: int | None, samples: CandidateSource
) -> None:
    """Blocks are what an accelerator computes with; here they run on the processor."""
    bank = read_bank(find_bank_path(PACKAGED_WEIGHTS), PACKAGED_WEIGHTS) if samples is CandidateSource.STORED else None
    asked = TrajectoryPrior(load_denoiser(PACKAGED_WEIGHTS), SamplerSettings(samples), "", bank, block=block)
    start = prior.sample(40, CRUISING, rng())

    def requests() -> list[Request]:
        slow = np.array([-1.5, 0.0, 0.0])
        return [
            MutationRequest(start, 5, CRUISING, rng(1)),
            SamplingRequest(24, slow, rng(2)),
            MutationRequest(start[:7], 5, slow, rng(3)),
            MutationRequest(start, 1, CRUISING, rng(4)),
            SamplingRequest(8, CRUISING, rng(5)),
        ]

    together = asked.answer(requests())
    for one, request in zip(together, requests(), strict=True):
        np.testing.assert_array_equal(one, asked.answer([request])[0])
    plain = prior.mutate(start, 5, CRUISING, rng(1))
    np.testing.assert_allclose(together[0], plain, atol=1e-4)


def test_dropout_changes_answers_but_not_the_seed(prior: TrajectoryPrior) -> None:
    """The packaged network has none, so a network of the published kind stands in."""
    network = TrajectoryDenoiser(SMALL).eval()
    with_dropout = TrajectoryPrior(network, SamplerSettings(dropout=True, drivable=False), "")
    start = prior.sample(6, CRUISING, rng())
    first, again = (with_dropout.mutate(start, 5, CRUISING, rng(1)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    without = TrajectoryPrior(network, SamplerSettings(drivable=False), "").mutate(start, 5, CRUISING, rng(1))
    assert np.abs(first - without).max() > 1e-6
    state = torch.random.get_rng_state()
    TrajectoryPrior(network, SamplerSettings(dropout=True), "").mutate(start, 5, CRUISING, rng(1))
    assert torch.equal(state, torch.random.get_rng_state())


def test_packaged_samples_are_smooth(prior: TrajectoryPrior) -> None:
    """Real driving changes its acceleration by 0.4 m/s^2 per half second (model card)."""
    sampled = prior.sample(512, np.array([-5.0, 0.0, 0.0]), rng())
    change = np.diff(convert_waypoints_to_actions(sampled, np.array([-5.0, 0.0, 0.0])), axis=1)[..., :2] * 16
    assert 0.1 < np.sqrt((change**2).sum(-1).mean()) < 1.0
