"""Training of ``ego-status``, about a minute on one core: each moving recorded vehicle is the ego once."""

import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save

from adapters.planners.ego_status import PAST_STEPS, EgoStatusInputs, EgoStatusNetwork
from benchmark.constants import COMMAND_LATERAL_M, HORIZON_STEPS, LIDAR_FROM_REAR_AXLE_M, PLAN_STEPS
from benchmark.datasets.tracks import RecordedTracks, read_recorded_tracks
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.machine.storage import file_sha256, write_bytes
from benchmark.planning import Command

HZ = 10
_STEP = HZ // 2
_PAST, _FUTURE = PAST_STEPS * _STEP, PLAN_STEPS * _STEP
_FIT_FRAMES = HZ + 1
_VEHICLES = frozenset({"car", "vehicle", "truck", "bus", "van", "large_vehicle"})
_REAR_AXLE_BEHIND_CENTER = 0.34
"""Share of the vehicle's length; that of the recording car of nuScenes."""
_LARGEST_ACCELERATION = 8.0
_LARGEST_SPEED = 45.0
_SMOOTHED_FRAMES = 9


@dataclass(frozen=True, slots=True)
class EgoStatusSamples:
    """B training samples. `future` are (B, 6, 2) rear-axle positions, ego frame, metres."""

    motion: EgoStatusInputs
    future: Floats

    def __len__(self) -> int:
        return len(self.future)

    def rows(self, chosen: NDArray[np.int64]) -> "EgoStatusSamples":
        """Some of the samples."""
        motion = {field.name: getattr(self.motion, field.name)[chosen] for field in fields(EgoStatusInputs)}
        return EgoStatusSamples(EgoStatusInputs(**motion), self.future[chosen])


def read_samples(folder: Path, sources: Sequence[str]) -> dict[str, EgoStatusSamples]:
    """Samples by source, from a folder of ``SOURCE.npz`` files in the neutral track format."""
    return {source: _read(folder / f"{source}.npz") for source in sources}


def _read(path: Path) -> EgoStatusSamples:
    if not path.is_file():
        raise InputError(
            f"there is no track file {path}; name the folder that holds the SOURCE.npz files with --tracks"
        )
    windows = [samples for poses in _vehicle_paths(read_recorded_tracks(path), path) for samples in _windows(poses)]
    if not windows:
        raise InputError(f"{path} holds no vehicle that moves for at least five seconds")
    return _join_samples(windows)


def _vehicle_paths(tracks: RecordedTracks, path: Path) -> Iterator[Floats]:
    """(F, 3) rear-axle paths at 10 Hz of every vehicle that moves more than 5 m, smoothed."""
    stride = round(tracks.hz / HZ)
    if stride < 1 or abs(tracks.hz - stride * HZ) > 1e-6:
        raise InputError(f"{path} has {tracks.hz:g} samples per second; ego-status learns from multiples of {HZ}")
    for track, (start, stop) in enumerate(itertools.pairwise(tracks.pointers)):
        if tracks.kinds[track] not in _VEHICLES:
            continue
        recorded = (tracks.x, tracks.y, tracks.heading)
        columns = [np.asarray(values[start:stop:stride], np.float64) for values in recorded]
        if len(columns[0]) < _PAST + _FUTURE + 1:
            continue
        x, y, yaw = (_smooth(column) for column in (columns[0], columns[1], np.unwrap(columns[2])))
        if np.hypot(x[-1] - x[0], y[-1] - y[0]) < 5.0:
            continue
        behind = 0.0
        if not tracks.is_ego[track] and np.isfinite(tracks.length[track]):
            behind = _REAR_AXLE_BEHIND_CENTER * float(tracks.length[track])
        yield np.column_stack([x - behind * np.cos(yaw), y - behind * np.sin(yaw), yaw])


def _smooth(values: Floats) -> Floats:
    """Local parabolas over 0.9 s, as recorded positions of other vehicles jitter."""
    half = _SMOOTHED_FRAMES // 2
    powers = np.vander(np.arange(-half, half + 1), 3)
    kernel = np.linalg.pinv(powers)[2]
    padded = np.pad(values, half, mode="reflect", reflect_type="odd")
    return np.convolve(padded, kernel[::-1], mode="valid")


def _windows(path: Floats) -> Iterator[EgoStatusSamples]:
    """One sample each half second of a path, as far as its motion is physically possible."""
    starts = np.arange(_PAST, len(path) - _FUTURE, _STEP)
    if len(starts) == 0:
        return
    now = path[starts]
    history = path[starts[:, None] - _STEP * np.arange(PAST_STEPS, 0, -1)]
    ahead = path[starts[:, None] + _STEP * np.arange(1, PLAN_STEPS + 1)]
    recent = path[starts[:, None] + np.arange(1 - _FIT_FRAMES, 1)]
    velocity, acceleration, yaw_rate = _motion(to_local(recent[..., :2], now[:, None]), recent[..., 2])
    future = to_local(ahead[..., :2], now[:, None])
    turned = ahead[:, -1, 2] - now[:, 2]
    past = np.concatenate(
        [to_local(history[..., :2], now[:, None]), wrap_angle(history[..., 2:] - now[:, None, 2:])], axis=-1
    )
    samples = EgoStatusSamples(
        EgoStatusInputs(
            past=past,
            past_valid=np.ones(past.shape[:2], dtype=np.bool_),
            velocity=velocity,
            acceleration=acceleration,
            yaw_rate=yaw_rate,
            command=_command(future[:, -1, 1] + LIDAR_FROM_REAR_AXLE_M * np.sin(turned)),
        ),
        future,
    )
    yield samples.rows(np.flatnonzero(_are_drivable(samples)))


def _motion(local: Floats, yaw: Floats) -> tuple[Floats, Floats, Floats]:
    """Velocity, acceleration and yaw rate now, from parabolas through the last second; nothing of the future."""
    seconds = np.arange(1 - _FIT_FRAMES, 1) / HZ
    parabola = np.linalg.pinv(np.vander(seconds, 3, increasing=True))
    line = np.linalg.pinv(np.vander(seconds, 2, increasing=True))
    return (
        np.einsum("f,bfd->bd", parabola[1], local),
        2 * np.einsum("f,bfd->bd", parabola[2], local),
        np.einsum("f,bf->b", line[1], yaw),
    )


def _command(left_m: Floats) -> NDArray[np.int64]:
    """The official rule: at least 2 m to a side at the last waypoint."""
    straight = np.full(left_m.shape, int(Command.STRAIGHT))
    turned = np.where(left_m >= COMMAND_LATERAL_M, int(Command.LEFT), straight)
    return np.where(left_m <= -COMMAND_LATERAL_M, int(Command.RIGHT), turned)


def _are_drivable(samples: EgoStatusSamples) -> NDArray[np.bool_]:
    """Whether a car could have driven it, and drove forwards."""
    start = np.zeros_like(samples.future[:, :1])
    velocity = np.diff(np.concatenate([start, samples.future], axis=1), axis=1) * 2
    acceleration = np.linalg.norm(np.diff(velocity, axis=1) * 2, axis=-1).max(axis=1)
    speed = np.linalg.norm(velocity, axis=-1).max(axis=1)
    sideways = np.abs(samples.motion.velocity[:, 1])
    return np.asarray(
        (acceleration < _LARGEST_ACCELERATION)
        & (np.linalg.norm(samples.motion.acceleration, axis=1) < _LARGEST_ACCELERATION)
        & (speed < _LARGEST_SPEED)
        & (sideways < 0.3 + 0.1 * np.abs(samples.motion.velocity[:, 0]))
        & (samples.motion.velocity[:, 0] > -1.0)
    )


def _join_samples(parts: Sequence[EgoStatusSamples]) -> EgoStatusSamples:
    motion = {
        field.name: np.concatenate([getattr(part.motion, field.name) for part in parts])
        for field in fields(EgoStatusInputs)
    }
    return EgoStatusSamples(EgoStatusInputs(**motion), np.concatenate([part.future for part in parts]))


def join_sources(samples: dict[str, EgoStatusSamples]) -> EgoStatusSamples:
    """Samples of several sources in one batch, by the name of the source."""
    return _join_samples([samples[source] for source in sorted(samples)])


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

    `learning_rate` falls to zero along a cosine; `weight_decay` is AdamW's; `blind_start_share` is the share of samples
    whose past is cut off, as at the start of a scene.
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
    # Evaluation data is read first, so that no model is trained that then cannot be measured.
    held_out = read_samples(tracks, settings.held_out)
    samples = join_sources(read_samples(tracks, settings.sources))
    network = _fit(samples, settings, seed)
    weights = {name: value.contiguous() for name, value in network.state_dict().items()}
    write_bytes(out, save(weights))
    figures = {source: measure(network, held) for source, held in held_out.items()}
    facts = {
        "samples": len(samples),
        "sources": list(settings.sources),
        "steps": settings.steps,
        "seed": seed,
        "sha256": file_sha256(out),
        "held_out": figures,
    }
    write_bytes(out.with_suffix(".json"), (json.dumps(facts, indent=1, sort_keys=True) + "\n").encode())
    return figures


def measure(network: EgoStatusNetwork, samples: EgoStatusSamples) -> dict[str, float]:
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


def _fit(samples: EgoStatusSamples, settings: TrainingSettings, seed: int) -> EgoStatusNetwork:
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    network = EgoStatusNetwork()
    optimiser = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for _ in range(settings.steps):
        batch = _augment(samples.rows(rng.integers(len(samples), size=settings.batch)), settings, rng)
        target = torch.from_numpy((batch.future - batch.motion.constant_velocity()).astype(np.float32))
        distance = torch.linalg.vector_norm(network(batch.motion.features()) - target, dim=-1)
        loss = torch.sqrt(distance**2 + 0.01).mean()
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    return network


def _augment(samples: EgoStatusSamples, settings: TrainingSettings, rng: np.random.Generator) -> EgoStatusSamples:
    """Half of the samples mirrored, some with a past that is cut off, all with noisy accelerations as on a CAN bus."""
    mirror = np.where(rng.random(len(samples)) < 0.5, -1.0, 1.0)
    swap = {Command.RIGHT: Command.LEFT, Command.LEFT: Command.RIGHT, Command.STRAIGHT: Command.STRAIGHT}
    swapped = np.array([int(swap[command]) for command in Command])[samples.motion.command]
    side: Floats = np.stack([np.ones_like(mirror), mirror], axis=-1)
    known = np.where(rng.random(len(samples)) < settings.blind_start_share, rng.integers(0, 5, len(samples)), 4)
    motion = samples.motion
    mirrored = EgoStatusInputs(
        past=motion.past * np.concatenate([side, mirror[:, None]], axis=-1)[:, None],
        past_valid=np.arange(4)[::-1] < known[:, None],
        velocity=motion.velocity * side + rng.normal(0.0, 0.05, motion.velocity.shape),
        acceleration=motion.acceleration * side + rng.normal(0.0, 0.2, motion.acceleration.shape),
        yaw_rate=motion.yaw_rate * mirror + rng.normal(0.0, 0.005, motion.yaw_rate.shape),
        command=np.where(mirror < 0, swapped, motion.command),
    )
    return EgoStatusSamples(mirrored, samples.future * side[:, None])
