"""Training of ``ego-status``: what ``challenger-bench train ego-status`` runs. About a minute on one core."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save

from adapters.extensions.training.ego_status_tracks import Samples, joined, read_samples
from adapters.planners.ego_status import EgoMotion, EgoStatusNetwork
from benchmark.constants import HORIZON_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256, write_bytes
from benchmark.planning import Command

TRAINING_SOURCES = (
    "argoverse2",
    "comma2k19_example_ego",
    "kitti_odometry_ego",
    "lyft_l5_prediction",
    "ngsim_commonroad",
    "ngsim_i80_smarts",
)
"""Sources whose licences let the weights be passed on.

nuScenes is left out on purpose: its scenes are what planners are measured on.
"""
HELD_OUT_SOURCES = (
    "nuscenes_mini_scenarionet",
    "womd_scenarionet",
    "womd_gpudrive_nocturne",
    "interaction_sample",
    "levelx_commonroad",
)


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of a training.

    Attributes:
        batch: Samples a step.
        learning_rate: At the start; falls to zero along a cosine.
        weight_decay: Of AdamW.
        blind_start_share: Share of training samples whose past is cut off, as at the start of a scene.
    """

    sources: tuple[str, ...] = TRAINING_SOURCES
    held_out: tuple[str, ...] = HELD_OUT_SOURCES
    steps: int = 6000
    batch: int = 512
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    blind_start_share: float = 0.2


def train_ego_status(
    tracks: Path, out: Path, *, seed: int = 0, settings: TrainingSettings | None = None
) -> dict[str, dict[str, float]]:
    """Train and write the weights.

    Args:
        tracks: Folder of ``SOURCE.npz`` files in the neutral track format.
        out: Weights file to write; the measurements go beside it as JSON.
        seed: Seed of everything.
        settings: How long, how fast and from what it learns; the usual ones by default.

    Returns:
        For each held-out source its number of samples and the L2 at 1, 2 and 3 s, metres, of the network (``l2_1s``)
        and of constant velocity (``constant_velocity_l2_1s``).

    Raises:
        InputError: If a source is missing or unusable, or the weights cannot be written.
    """
    settings = settings or TrainingSettings()
    if settings.steps < 1 or settings.batch < 1:
        raise InputError(f"steps and batch must be at least 1, got {settings.steps} and {settings.batch}")
    # What it is measured on is read first: nothing is trained and written that then cannot be measured.
    held_out = read_samples(tracks, settings.held_out)
    samples = joined(read_samples(tracks, settings.sources))
    network = _fit(samples, settings, seed)
    weights = {name: value.contiguous() for name, value in network.state_dict().items()}
    write_bytes(out, save(weights))
    found = {source: measure(network, held) for source, held in held_out.items()}
    facts = {
        "samples": len(samples),
        "sources": list(settings.sources),
        "steps": settings.steps,
        "seed": seed,
        "sha256": file_sha256(out),
        "held_out": found,
    }
    write_bytes(out.with_suffix(".json"), (json.dumps(facts, indent=1, sort_keys=True) + "\n").encode())
    return found


def measure(network: EgoStatusNetwork, samples: Samples) -> dict[str, float]:
    """L2 of a network and of constant velocity, mean metres at 1, 2 and 3 s, and the number of samples."""
    straight = samples.motion.constant_velocity()
    network.eval()
    with torch.inference_mode():
        planned = straight + network(samples.motion.features()).double().numpy()
    figures: dict[str, float] = {"samples": len(samples)}
    for prefix, plans in (("", planned), ("constant_velocity_", straight)):
        l2 = np.linalg.norm(plans - samples.future, axis=-1)
        figures |= {
            f"{prefix}l2_{name}": round(float(l2[:, step - 1].mean()), 3) for name, step in HORIZON_STEPS.items()
        }
    return figures


def _fit(samples: Samples, settings: TrainingSettings, seed: int) -> EgoStatusNetwork:
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    network = EgoStatusNetwork()
    optimiser = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for _ in range(settings.steps):
        batch = _augmented(samples.rows(rng.integers(len(samples), size=settings.batch)), settings, rng)
        wanted = torch.from_numpy((batch.future - batch.motion.constant_velocity()).astype(np.float32))
        distance = torch.linalg.vector_norm(network(batch.motion.features()) - wanted, dim=-1)
        loss = torch.sqrt(distance**2 + 0.01).mean()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    return network


def _augmented(samples: Samples, settings: TrainingSettings, rng: np.random.Generator) -> Samples:
    """Half of the samples mirrored, some with a past that is cut off, all with noisy accelerations as on a CAN bus."""
    mirror = np.where(rng.random(len(samples)) < 0.5, -1.0, 1.0)
    swap = {Command.RIGHT: Command.LEFT, Command.LEFT: Command.RIGHT, Command.STRAIGHT: Command.STRAIGHT}
    swapped = np.array([int(swap[command]) for command in Command])[samples.motion.command]
    side: Floats = np.stack([np.ones_like(mirror), mirror], axis=-1)
    known = np.where(rng.random(len(samples)) < settings.blind_start_share, rng.integers(0, 5, len(samples)), 4)
    motion = samples.motion
    mirrored = EgoMotion(
        past=motion.past * np.concatenate([side, mirror[:, None]], axis=-1)[:, None],
        past_valid=np.arange(4)[::-1] < known[:, None],
        velocity=motion.velocity * side + rng.normal(0.0, 0.05, motion.velocity.shape),
        acceleration=motion.acceleration * side + rng.normal(0.0, 0.2, motion.acceleration.shape),
        yaw_rate=motion.yaw_rate * mirror + rng.normal(0.0, 0.005, motion.yaw_rate.shape),
        command=np.where(mirror < 0, swapped, motion.command),
    )
    return Samples(mirrored, samples.future * side[:, None])
