"""Weights on disk: safetensors of ours, or the published checkpoint, which is a bare state dict."""

import json
import pickle
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, write_bytes
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser

PACKAGED_WEIGHTS: Final = Path(__file__).parent / "weights" / "denoiser.safetensors"
METADATA_KEY: Final = "challenger-bench"


def write_tensors(path: Path, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
    """Write tensors and facts about them.

    Args:
        path: A .safetensors file.
        tensors: By name.
        facts: JSON values; one metadata entry, because the order of several is not fixed.

    Raises:
        InputError: If it cannot be written.
    """
    held = {name: tensor.detach().cpu().contiguous() for name, tensor in sorted(tensors.items())}
    write_bytes(path, safetensors.torch.save(held, {METADATA_KEY: canonical_json(facts)}))


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `write_tensors` wrote.

    Args:
        path: A .safetensors file; one without our facts gives an empty dictionary.

    Returns:
        Tensors by name, facts.

    Raises:
        InputError: If it is absent or broken.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as stream:
            facts = json.loads((stream.metadata() or {}).get(METADATA_KEY, "{}"))
            names = sorted(stream.keys())
            return {name: stream.get_tensor(name) for name in names}, facts
    except (OSError, ValueError, safetensors.SafetensorError) as error:
        raise InputError(f"cannot read weights from {path} ({error}); fetch or make the file again") from error


def save_denoiser(path: Path, denoiser: TrajectoryDenoiser, facts: dict[str, Any]) -> None:
    """Write a denoiser that `load_denoiser` gives back.

    Args:
        path: A .safetensors file.
        denoiser: The network.
        facts: What else to remember, for example seed and steps.
    """
    write_tensors(path, denoiser.state_dict(), {**facts, "denoiser": asdict(denoiser.config)})


def load_denoiser(path: Path) -> TrajectoryDenoiser:
    """A denoiser in evaluation mode.

    Args:
        path: ``.safetensors`` of ours, or of the published parameters; anything else is read as a bare state dict of
            the published checkpoint, by PyTorch's weights-only unpickler.

    Returns:
        The network. (The reference samples with dropout on, by an omission; here it is off.)

    Raises:
        InputError: If the file is absent or broken, would run code, or does not fit the architecture.
    """
    if not path.is_file():
        raise InputError(f"no weights at {path}; pass a .safetensors file, or the published ig360_adv.ckpt")
    tensors, facts = read_tensors(path) if path.suffix == ".safetensors" else (_read_state_dict(path), {})
    try:
        denoiser = TrajectoryDenoiser(DenoiserConfig(**facts.get("denoiser", {})))
        denoiser.load_state_dict(tensors, strict=True)
    except (RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[-1].strip()
        raise InputError(f"the weights in {path} do not fit the trajectory denoiser: {reason}") from error
    if not all(bool(torch.isfinite(tensor).all()) for tensor in denoiser.state_dict().values()):
        raise InputError(f"the weights in {path} hold NaN or infinity; fetch or make the file again")
    return denoiser.eval()


def _read_state_dict(path: Path) -> dict[str, Tensor]:
    try:
        # A foreign pickle protocol is worth a warning to PyTorch; here it either yields tensors or is refused below.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            loaded = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, OSError, ValueError) as error:
        # What PyTorch says goes on with advice to load it unsafely, so only the kind of error is passed on.
        raise InputError(
            f"{path} is not a plain state dict ({type(error).__name__}: empty, damaged, or more than tensors); a "
            "checkpoint may hold tensors only, nothing that runs code"
        ) from error
    if not isinstance(loaded, dict) or not all(isinstance(tensor, Tensor) for tensor in loaded.values()):
        raise InputError(f"{path} is not a bare state dict of tensors; the published ig360_adv.ckpt is one")
    return {str(name): tensor.to(torch.float32) for name, tensor in loaded.items()}
