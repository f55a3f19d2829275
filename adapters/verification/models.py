"""`challenger-bench verify model`: networks of ours against numbers of their official code, with synthetic weights."""

from pathlib import Path
from typing import Final

from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from adapters.verification.conditions import set_folders
from adapters.verification.parity_set import ParitySet
from adapters.verification.sparse import NETWORKS, verify_sparse
from adapters.verification.uniad import verify_uniad
from adapters.verification.vad import compare_vad
from benchmark.errors import InputError
from benchmark.machine.devices import single_precision
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import fill, same_names_and_shapes

_VAD: Final = {"vad-tiny": VADConfig.tiny, "vad-base": VADConfig.base}
VERIFIED_MODELS: Final = (*_VAD, "uniad", *NETWORKS)


def verify_model(name: str, golden: Path, device: str = "cpu") -> list[Check]:
    """Fill a network by the names of its tensors, run the golden frames in order, and compare what is stored.

    Args:
        name: One of `VERIFIED_MODELS`.
        golden: A set's folder, or a model's folder whose sets are all compared.
        device: What the network runs on; tolerances are those of single precision on a processor.

    Returns:
        One check for each quantity; the first alone if names or shapes differ, since weights cannot be filled then.

    Raises:
        InputError: If there is no such model, or the set cannot be used.
    """
    if name not in VERIFIED_MODELS:
        raise InputError(f"no model {name!r} can be verified; choose one of {', '.join(VERIFIED_MODELS)}")
    if name in NETWORKS:
        return verify_sparse(name, golden, device)
    if name == "uniad":
        return verify_uniad(golden, device)
    comparison = Comparison()
    network = VAD(_VAD[name]()).to(device)
    for folder in set_folders(golden):
        parity_set = ParitySet.read(folder)
        if not same_names_and_shapes(comparison, network, parity_set.shapes):
            break
        recorded = parity_set.manifest.weights_sha256
        fill(comparison, network, parity_set.manifest, parity_set.shapes, recorded, folder / "manifest.json")
        with single_precision():
            compare_vad(comparison, network, parity_set)
    return comparison.checks()
