"""Weights on disk (safetensors of ours or the published bare state dict), and actions sampled in advance.

The model is unconditional, so its samples do not depend on the scene.
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import content_seed, file_sha256
from benchmark.untrusted.files import to_one_line
from benchmark.weights.folders import read_checkpoint
from benchmark.weights.tensors import read_tensors, write_tensors
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser
from generation.diffusion.network_calls import parse_device
from generation.diffusion.schedule import STEPS, choose_strided_timesteps, run_reverse_process
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

PACKAGED_WEIGHTS: Final = Path(__file__).parent / "weights" / "denoiser.safetensors"
_LARGEST_SIZE: Final = 1 << 16
_MOST_LAYERS: Final = 256


def save_denoiser(path: Path, denoiser: TrajectoryDenoiser, facts: dict[str, Any]) -> None:
    """Write a denoiser that `load_denoiser` gives back, with facts on it, for example seed and steps."""
    write_tensors(path, denoiser.state_dict(), {**facts, "denoiser": asdict(denoiser.config)})


def load_denoiser(path: Path) -> TrajectoryDenoiser:
    """A denoiser in evaluation mode: dropout is off, with which the reference samples by an omission.

    A ``.safetensors`` file is ours, or of the published parameters; anything else is read as a state dict of the
    published checkpoint (`benchmark.weights.folders`), and refused if it would run code.
    """
    if not path.is_file():
        raise InputError(f"no weights at {path}; pass a .safetensors file, or the published ig360_adv.ckpt")
    tensors, facts = read_tensors(path) if path.suffix == ".safetensors" else (read_checkpoint(path).tensors, {})
    config = _parse_config(path, facts.get("denoiser", {}))
    _require_same_shapes(path, config, tensors)
    denoiser = TrajectoryDenoiser(config)
    denoiser.load_state_dict({name: tensor.to(torch.float32) for name, tensor in tensors.items()}, strict=True)
    if not all(bool(torch.isfinite(tensor).all()) for tensor in denoiser.state_dict().values()):
        raise InputError(f"the weights in {path} hold NaN or infinity; fetch or make the file again")
    return denoiser.eval()


def _parse_config(path: Path, stored: Any) -> DenoiserConfig:
    kinds = {field.name: type(field.default) for field in fields(DenoiserConfig)}
    wrong = f"{path} describes a network that is not a trajectory denoiser"
    if not isinstance(stored, dict) or not set(stored) <= set(kinds):
        raise InputError(f"{wrong}; fetch or make the file again")
    for name, value in stored.items():
        known = type(value) is kinds[name] or (kinds[name] is float and type(value) is int)
        if not known or not 0 <= abs(value) <= _LARGEST_SIZE:
            raise InputError(f"{wrong} ({name} {str(value)[:40]!r}); fetch or make the file again")
    if not 0 <= stored.get("dropout", 0) < 1 or stored.get("layers", 0) > _MOST_LAYERS:
        raise InputError(f"{wrong} (dropout or layers); fetch or make the file again")
    return DenoiserConfig(**stored)


def _require_same_shapes(path: Path, config: DenoiserConfig, tensors: Mapping[str, Tensor]) -> None:
    """Compare names and shapes with a network that has no memory yet: a file may claim one of any size."""
    try:
        # Constants of the network stay on the CPU: arithmetic on this device imports torch's compiler, 3 s.
        with torch.device("meta"):
            expected = TrajectoryDenoiser(config).state_dict()
    except (ArithmeticError, RuntimeError, ValueError) as error:
        raise InputError(f"{path} does not describe a trajectory denoiser ({error}); get another") from error
    kinds = (
        ([name for name in expected if name not in tensors], "missing"),
        ([name for name in tensors if name not in expected], "too many"),
        ([n for n in expected if n in tensors and tensors[n].shape != expected[n].shape], "of another shape"),
        ([name for name, tensor in tensors.items() if tensor.is_complex()], "no real numbers"),
    )
    differences = "; ".join(
        f"{len(names)} {problem} (first: {to_one_line(names[0])})" for names, problem in kinds if names
    )
    if differences:
        raise InputError(
            f"the weights in {path} do not fit the trajectory denoiser: of its tensors, {differences}; get the "
            "published ig360_adv.ckpt, or a .safetensors file of train denoiser"
        )


BANK_SIZE: Final = 4096
CHUNK: Final = 256


def find_bank_path(weights: Path) -> Path:
    """Bank of a weights file: ``NAME.bank.safetensors`` beside it."""
    return weights.with_suffix(".bank.safetensors")


def draw_normal_noise(rng: np.random.Generator, count: int) -> torch.Tensor:
    """(count, 16, 3) standard normal, drawn in float64 so that it is the same everywhere."""
    return torch.from_numpy(rng.standard_normal((count, WAYPOINTS, CHANNELS)).astype(np.float32))


def sample_actions(denoiser: TrajectoryDenoiser, count: int, steps: int | None, rng: np.random.Generator) -> Floats:
    """(count, 16, 3) standardised actions by the reference's full process; ``steps`` of ``None`` asks at all 100."""
    device = next(denoiser.parameters()).device

    def draw() -> torch.Tensor:
        return draw_normal_noise(rng, count).to(device)

    with torch.inference_mode():
        actions = run_reverse_process(
            denoiser, denoiser.start(draw()), choose_strided_timesteps(STEPS - 1, steps), draw=draw
        )
    return actions.cpu().numpy().astype(np.float64)


def write_bank(weights: Path, *, count: int = BANK_SIZE, seed: int = 0, device: str = "cpu") -> Path:
    """Sample a bank of actions by the full reverse process and write it beside the weights.

    Args:
        weights: A file that `load_denoiser` reads.
        count: Trajectories.
        seed: Recorded in the file.
        device: Where the network runs.

    Returns:
        The bank file: float16, with the SHA-256 of the weights that made it.

    Raises:
        InputError: If weights or device cannot be used or the bank not be written.
    """
    if count < 1:
        raise InputError(f"a bank needs at least one trajectory, got {count}")
    denoiser, digest = load_denoiser(weights).to(parse_device(device)), file_sha256(weights)
    sizes = [min(CHUNK, count - start) for start in range(0, count, CHUNK)]
    chunks = (
        sample_actions(denoiser, size, None, np.random.default_rng(content_seed("bank", seed, chunk)))
        for chunk, size in enumerate(sizes)
    )
    trajectories = CountedUnits("trajectory", total=count, each=len)
    actions = np.concatenate(list(track_progress(chunks, total=len(sizes), label="sampling bank", count=trajectories)))
    held = torch.from_numpy(actions).to(torch.float16)
    facts = {"weights_sha256": digest, "seed": seed, "count": count, "steps": STEPS}
    write_tensors(find_bank_path(weights), {"actions": held}, facts)
    return find_bank_path(weights)


def read_bank(path: Path, weights: Path) -> Floats:
    """Read a bank, (N, 16, 3) actions; it must have been made from ``weights``."""
    tensors, facts = read_tensors(path)
    if facts.get("weights_sha256") != file_sha256(weights):
        raise InputError(f"the bank {path} was not sampled from {weights}; remove it or sample it again")
    actions = tensors.get("actions", torch.empty(0)).to(torch.float64).numpy()
    if actions.ndim != 3 or actions.shape[1:] != (WAYPOINTS, CHANNELS) or not np.isfinite(actions).all():
        raise InputError(f"the bank {path} does not hold (N, {WAYPOINTS}, {CHANNELS}) finite actions; sample it again")
    return np.asarray(actions)
