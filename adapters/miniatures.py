"""Miniatures of the native models: small networks of the same classes whose weights come with this package.

One entry a model; training, planners, the demo and the speed figures all go through this list. Networks are imported
only when one is built.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from adapters.checkpoints.cache import cached_weights, weights_folder
from benchmark.errors import InputError
from benchmark.machine.devices import Precision
from benchmark.runs.code_identity import one_entry_counts

if TYPE_CHECKING:
    from torch import Tensor, nn

    from adapters.planner import NativePlanner, Weights
    from adapters.training.frames import TrainingFrame
    from adapters.training.phases import Phase

PACKAGED: Final = Path(__file__).parent / "weights"
"""Folder of the weights that come with this package."""
EMBEDDED_DATA: Final = "mini"
"""Name of the data set on which the miniatures stand in for the full models."""


@dataclass(frozen=True, slots=True)
class Miniature:
    """One small network.

    Attributes:
        name: What ``--model`` takes.
        stands_for: Full models in whose place it runs on the embedded data set where their weights are absent.
        build: Makes the network as it is evaluated, with random weights.
        untrained: Makes it as training starts, from frames of the training data and a seed.
        phases: Makes the parts of its training, one after the other.
        planner: Makes a planner of a network with its weights.
        renamed: Brings weights that its training may start from under its own names.
    """

    name: str
    stands_for: tuple[str, ...]
    build: Callable[[], "nn.Module"]
    untrained: "Callable[[Sequence[TrainingFrame], int], nn.Module]"
    phases: "Callable[[], tuple[Phase, ...]]"
    planner: "Callable[..., NativePlanner[Any]]"
    renamed: "Callable[[Mapping[str, Tensor]], dict[str, Tensor]]" = dict

    @property
    def packaged(self) -> Path:
        """File of the weights that come with this package."""
        return PACKAGED / f"{self.name}.safetensors"


def miniature(name: str) -> Miniature:
    """A miniature by name.

    Args:
        name: For example ``uniad-mini``.

    Returns:
        The miniature.

    Raises:
        InputError: If there is none of that name.
    """
    if name not in MINIATURES:
        raise InputError(f"{name!r} is no miniature; those are {', '.join(MINIATURES)}")
    return MINIATURES[name]


def stand_in(name: str, checkpoint: Path | None, data_name: str) -> str:
    """The model that really runs: a miniature where it may stand in for a full one.

    Args:
        name: The model that was asked for.
        checkpoint: Its weights, if any were named.
        data_name: Name of the data set.

    Returns:
        The name of a miniature on the embedded data set if the full model has no weights; else ``name``.
    """
    if checkpoint is not None or data_name != EMBEDDED_DATA:
        return name
    small = next((each for each in MINIATURES.values() if name in each.stands_for), None)
    if small is None or not small.packaged.is_file():
        return name
    full = small.stands_for[-1] if name == "vad" else name
    return name if cached_weights(weights_folder(), full) else small.name


def planner_of(
    name: str, checkpoint: Path | None, device: str = "auto", precision: Precision = "float32"
) -> "NativePlanner[Any]":
    """A miniature under test.

    Args:
        name: Of the miniature.
        checkpoint: Weights that ``train planner`` has written; those of this package where none are named.
        device: See `adapters.planner.NativePlanner`.
        precision: See there.

    Returns:
        The planner.

    Raises:
        InputError: If the weights are absent, broken, or of another model.
    """
    from adapters.planner import Weights

    small = miniature(name)
    if checkpoint is None and not small.packaged.is_file():
        raise InputError(
            f"the weights of {name} are not in this installation; train them with: challenger-bench train planner "
            f"--model {name}, and give the file with --checkpoint"
        )
    network = small.build()
    weights = Weights.load(network, name, checkpoint or small.packaged)
    return planner_with(small, network, weights, device, precision)


def planner_with(
    small: Miniature, network: "nn.Module", weights: "Weights", device: str = "auto", precision: Precision = "float32"
) -> "NativePlanner[Any]":
    """A planner of a network that has its weights.

    Args:
        small: Which miniature.
        network: Made by its ``build``.
        weights: Where the weights came from.
        device: See `adapters.planner.NativePlanner`.
        precision: See there.

    Returns:
        The planner.
    """
    return small.planner(network, name=small.name, **weights.as_arguments(), device=device, precision=precision)


def uniad_mini(
    checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32"
) -> "NativePlanner[Any]":
    """UniAD-mini; see `planner_of`."""
    return planner_of("uniad-mini", checkpoint, device, precision)


def vad_mini(
    checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32"
) -> "NativePlanner[Any]":
    """VAD-mini; see `planner_of`."""
    return planner_of("vad-mini", checkpoint, device, precision)


def sparsedrive_mini(
    checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32"
) -> "NativePlanner[Any]":
    """SparseDrive-mini; see `planner_of`."""
    return planner_of("sparsedrive-mini", checkpoint, device, precision)


def diffusiondrive_mini(
    checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32"
) -> "NativePlanner[Any]":
    """DiffusionDrive-mini; see `planner_of`."""
    return planner_of("diffusiondrive-mini", checkpoint, device, precision)


def _build_vad() -> "nn.Module":
    from adapters.networks.vad.config import VADConfig
    from adapters.networks.vad.model import VAD

    return VAD(VADConfig.miniature())


def _untrained_vad(frames: "Sequence[TrainingFrame]", seed: int) -> "nn.Module":
    from adapters.training.vad.start import untrained

    return untrained(frames, seed)


def _phases_vad() -> "tuple[Phase, ...]":
    from adapters.training.phases import Phase
    from adapters.training.trainer import Recipe
    from adapters.training.vad.objective import VADLesson

    return (Phase("all", VADLesson, Recipe(steps=5000, learning_rate=4e-4, warmup=150, clips=2, check_every=1500)),)


def _planner_vad(network: Any, **known: Any) -> "NativePlanner[Any]":
    from adapters.networks.vad.planner import VADPlanner

    return VADPlanner(network, **known)


def _build_sparse(name: str) -> "nn.Module":
    from adapters.networks.sparse.config import SparseConfig
    from adapters.networks.sparse.model import DiffusionDrive, SparseDrive

    config = replace(SparseConfig.miniature(), memory_crosses_scenes=False)
    return DiffusionDrive(config) if name == "diffusiondrive-mini" else SparseDrive(config)


def _untrained_sparse(name: str, frames: "Sequence[TrainingFrame]", seed: int) -> "nn.Module":
    from adapters.training.sparse.start import untrained

    return untrained(name, frames, seed)


def _phases_sparse(name: str) -> "tuple[Phase, ...]":
    from adapters.training.phases import Phase
    from adapters.training.sparse.objective import SparseLesson
    from adapters.training.trainer import Recipe

    recipe = Recipe(
        steps=2600, learning_rate=1e-3, encoder_rate=0.3, warmup=60, average=0.995, clips=2, gradient_norm=10.0
    )
    if name == "sparsedrive-mini":
        return (Phase("all", SparseLesson, recipe),)
    # DiffusionDrive starts from SparseDrive (``--start-from``): what it sees is seen already, it learns to plan.
    planner = replace(recipe, steps=1000, clips=3)
    return (Phase("planner", partial(SparseLesson, perception=False), planner),)


def _planner_sparse(network: Any, **known: Any) -> "NativePlanner[Any]":
    from adapters.networks.sparse.planner import SparsePlanner

    return SparsePlanner(network, **known)


def _renamed_diffusion(trunk: "Mapping[str, Tensor]") -> "dict[str, Tensor]":
    from adapters.training.sparse.start import planned_from

    return planned_from(trunk)


def _build_uniad() -> "nn.Module":
    from adapters.networks.uniad.config import UniADConfig
    from adapters.networks.uniad.model import UniAD

    return UniAD(UniADConfig.miniature(), stores_anchors=True)


def _untrained_uniad(frames: "Sequence[TrainingFrame]", seed: int) -> "nn.Module":
    from adapters.networks.uniad.config import UniADConfig
    from adapters.training.uniad.start import untrained

    return untrained(UniADConfig.miniature(), frames, seed)


def _phases_uniad() -> "tuple[Phase, ...]":
    from adapters.training.phases import Phase
    from adapters.training.trainer import Recipe
    from adapters.training.uniad.objective import UniADLesson

    # A frame alone costs half as much as a clip; what the past adds is learned after what can be seen at all.
    alone = Recipe(steps=6000, learning_rate=8e-4, encoder_rate=0.3, warmup=100, average=0.995)
    clips = Recipe(steps=5000, learning_rate=6e-4, encoder_rate=0.3, warmup=50, average=0.998)
    return (
        Phase("frames", partial(UniADLesson, clip_frames=1, unaware=0.2), alone),
        Phase("clips", partial(UniADLesson, clip_frames=3, learned_frames=2, unaware=0.15), clips),
    )


def _planner_uniad(network: Any, **known: Any) -> "NativePlanner[Any]":
    from adapters.networks.uniad.planner import UniADPlanner

    return UniADPlanner(network, **known)


MINIATURES: Final = one_entry_counts(
    {
        "uniad-mini": Miniature(
            "uniad-mini",
            ("uniad",),
            build=_build_uniad,
            untrained=_untrained_uniad,
            phases=_phases_uniad,
            planner=_planner_uniad,
        ),
        "vad-mini": Miniature(
            "vad-mini",
            ("vad-tiny", "vad", "vad-base"),
            build=_build_vad,
            untrained=_untrained_vad,
            phases=_phases_vad,
            planner=_planner_vad,
        ),
        "sparsedrive-mini": Miniature(
            "sparsedrive-mini",
            ("sparsedrive",),
            build=partial(_build_sparse, "sparsedrive-mini"),
            untrained=partial(_untrained_sparse, "sparsedrive-mini"),
            phases=partial(_phases_sparse, "sparsedrive-mini"),
            planner=_planner_sparse,
        ),
        "diffusiondrive-mini": Miniature(
            "diffusiondrive-mini",
            ("diffusiondrive",),
            build=partial(_build_sparse, "diffusiondrive-mini"),
            untrained=partial(_untrained_sparse, "diffusiondrive-mini"),
            phases=partial(_phases_sparse, "diffusiondrive-mini"),
            planner=_planner_sparse,
            renamed=_renamed_diffusion,
        ),
    },
    counted=("build", "planner"),
)
