"""Planners of the table with their weights: the network is built, filled, and put under test."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from adapters.as_published import options_of
from adapters.camera_inputs import normalisation_of
from adapters.checkpoints.cache import load_weights, read_shapes
from adapters.checkpoints.importing import resolve_checkpoint
from adapters.models import Model, resolve
from adapters.planner import NativePlanner
from benchmark.errors import InputError
from benchmark.machine.devices import Precision
from benchmark.machine.storage import file_sha256


def planner_of(
    model: Model,
    checkpoint: Path | None = None,
    seed: int = 0,
    device: str = "auto",
    precision: Precision = "float32",
    as_published: Sequence[str] = (),
) -> NativePlanner[Any]:
    """A network under test.

    Without a `checkpoint` (`resolve_checkpoint`) a miniature has the weights of this package, and the others what has
    been imported. `seed` is of the noise, where there is some; ``bfloat16`` computes the matrix products in half the
    bytes; `as_published` as in `adapters.as_published`.
    """
    options = options_of(model.name, model.net.as_published, as_published)
    if model.requires is not None:
        resolve(model.requires)()
    path = _weights_file(model, checkpoint)
    network = model.build(read_shapes(path) if model.net.fitted else None, seed=seed, as_published=options)
    provenance = load_weights(network, path)
    made: NativePlanner[Any] = resolve(model.planner)(
        network,
        name=model.name,
        normalisation=normalisation_of(provenance.normalisation),
        weights_sha256=file_sha256(path),
        settings={"weights": provenance.model_dump(mode="json")},
        native_protocol=model.native_protocol,
        device=device,
        precision=precision,
        as_published=options,
    )
    return made


def _weights_file(model: Model, checkpoint: Path | None) -> Path:
    if model.miniature is None or checkpoint is not None:
        return resolve_checkpoint(model.weights or model.name, checkpoint)
    if not model.packaged.is_file():
        raise InputError(
            f"the weights of {model.name} are not in this installation; train them with: challenger-bench train "
            f"planner --model {model.name}, and give the file with --checkpoint"
        )
    return resolve_checkpoint(model.name, model.packaged)
