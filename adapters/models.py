"""Table of planners: definition, weights and paper name of each built-in one.

Everything is named as ``module:attribute`` and imported when it is asked for (`resolve`), so that reading the table
imports no network. A new model of a known family is one entry; a new family is a folder in `adapters.networks` and an
entry.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.records.run_schema import PlannerInput

PACKAGED: Final = Path(__file__).parent / "weights"
"""Folder of the weights that come with this package."""
MOTION_ANCHORS: Final = "motion_head.anchors"
"""UniAD's typical forecasts, (groups, modes, steps, 2) metres."""


@dataclass(frozen=True, slots=True)
class Network:
    """A network and what is known of its official code; variants of a family replace a few of these.

    Attributes:
        example: Makes inputs of one key frame of a configuration, the same every time, on the processor.
        published_normalisation: Of the official weights (`adapters.camera_inputs.NORMALISATIONS`).
        fitted: Whether `config` is given the shapes of a checkpoint's tensors by name, where official files differ.
        verify: Compares it with numbers of its official code (`adapters.extensions.golden_sets.models`).
        renamed: Patterns and replacements for tensor names that official files have under an older name.
        ignored: Patterns of tensor names that official files may have and the network does not need.
        anchors: Tensor of the network that official checkpoints lack, because it is published in a file of its own.
        clustered: Whether its queries start from cluster centres of a data set (`adapters.checkpoints.anchor_files`).
        as_published: Changes of the configuration by option of `adapters.as_published`.
    """

    build: str
    config: str
    example: str = ""
    published_normalisation: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    fitted: bool = False
    seeded: bool = False
    verify: str | None = None
    renamed: tuple[tuple[str, str], ...] = ()
    ignored: tuple[str, ...] = ()
    anchors: str | None = None
    clustered: bool = False
    as_published: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Miniature:
    """Miniature: the full models for which a small network with packaged weights stands, and its training.

    It replaces them on the embedded data set where their weights are absent. `untrained` makes the network from a
    configuration, frames of the training data and a seed; `renamed` brings weights that training may start from under
    its own names.
    """

    stands_for: tuple[str, ...]
    untrained: str
    phases: str
    renamed: str = "builtins:dict"


@dataclass(frozen=True, slots=True)
class Model:
    """One planner.

    Attributes:
        planner: Its class; that of a network is given the network and where its weights come from.
        weights: Published weights that it has (`benchmark.weights.catalogue`); variants share those of another.
        published_as: Name in the paper; the paper does not state which VAD it ran, usually the larger one.
        wants: Inputs of its plans that a data set may lack.
        requires: Raises `InputError` where a package is absent that it needs.
        extra_package: Import name of the package that the extra installs.
        draws: Seeds that its rates are the mean of (``data stats --traffic``); a run with one of them says little.
    """

    name: str
    planner: str
    network: Network | None = None
    weights: str | None = None
    miniature: Miniature | None = None
    published_as: str | None = None
    native_protocol: str | None = None
    wants: "tuple[PlannerInput, ...]" = ("images", "motion")
    sees: str = ""
    requires: str | None = None
    extra: str = ""
    extra_package: str = ""
    draws: int = 1

    @property
    def blind(self) -> bool:
        """Whether it uses no images, so that none need to be rendered for it."""
        return "images" not in self.wants

    @property
    def packaged(self) -> Path:
        """File of the weights that come with this package."""
        return PACKAGED / f"{self.name}.safetensors"

    @property
    def net(self) -> Network:
        """Its network; only networks have weights, are trained, imported and verified."""
        assert self.network is not None, f"{self.name} is not a network"
        return self.network

    @property
    def small(self) -> Miniature:
        """Its entry as a miniature."""
        assert self.miniature is not None, f"{self.name} is not a miniature"
        return self.miniature

    def configuration(self, shapes: Mapping[str, Sequence[int]] | None = None) -> Any:
        """Configuration of its network; `shapes` are those of the tensors that it is for, by name."""
        make = resolve(self.net.config)
        return make(shapes or {}) if self.net.fitted else make()

    def build(
        self,
        shapes: Mapping[str, Sequence[int]] | None = None,
        *,
        seed: int = 0,
        device: str = "cpu",
        as_published: Sequence[str] = (),
    ) -> Any:
        """Its network, a `torch.nn.Module` in evaluation mode, with random weights.

        `shapes` are those of the checkpoint's tensors by name (`Network.fitted`); the device ``meta`` needs no memory.
        """
        # Read before the device is set: constants of modules need memory even on the meta device.
        make, config = resolve(self.net.build), self.configuration(shapes)
        for option in as_published:
            config = replace(config, **self.net.as_published[option])
        settings = {**self.net.settings, **({"seed": seed} if self.net.seeded else {})}
        with import_module("torch").device(device):
            return make(config, **settings)


def resolve(reference: str) -> Any:
    """Attribute that a text of the table names, ``module:attribute`` where attributes may have dots; it is imported."""
    module, _, attribute = reference.partition(":")
    return attrgetter(attribute)(import_module(module))


def miniatures() -> dict[str, Model]:
    """Small networks whose weights come with this package (docs/miniatures.md), by name."""
    return _select_models(lambda model: model.miniature is not None)


def published_models() -> dict[str, Model]:
    """Networks that have published weights of their own (docs/models.md), by name."""
    return _select_models(lambda model: model.weights == model.name)


def baselines() -> dict[str, Model]:
    """Planners that are no native networks, by name."""
    return _select_models(lambda model: model.network is None)


def build_baseline(name: str, *, seed: int = 0) -> Any:
    """A planner of `baselines` by name; the seed is for one that draws."""
    model = MODELS[name]
    return resolve(model.planner)(**({"seed": seed} if model.draws > 1 else {}))


def published_model(name: str) -> Model:
    """A network with published weights by name; raises `InputError` if there is none."""
    known = published_models()
    if name not in known:
        raise InputError(f"{name!r} is not a model with weights; {did_you_mean(name, known)}choose {', '.join(known)}")
    return known[name]


def miniature(name: str) -> Model:
    """A miniature by name; raises `InputError` if there is none."""
    known = miniatures()
    if name not in known:
        raise InputError(f"{name!r} is not a miniature; {did_you_mean(name, known)}use one of {', '.join(known)}")
    return known[name]


def published_as(planner: str) -> str | None:
    """Name of a planner in the paper, for any run of it; ``None`` if the paper did not run it."""
    model = MODELS.get(planner.lower())
    return None if model is None else model.published_as


def _select_models(kind: Callable[[Model], bool]) -> dict[str, Model]:
    return {name: model for name, model in MODELS.items() if name == model.name and kind(model)}


_VAD: Final = Network(
    build="adapters.networks.vad.model:VAD",
    config="adapters.networks.vad.config:VADConfig.base",
    example="adapters.networks.vad.planner:example_frame",
    published_normalisation="bgr-mean",
    verify="adapters.extensions.golden_sets.vad:GOLDEN",
    as_published={"can-after": {}},
)
_SPARSE: Final = Network(
    build="adapters.networks.sparse.model:SparseDrive",
    config="adapters.networks.sparse.config:SparseConfig.sparsedrive",
    example="adapters.networks.sparse.planner:example_frame",
    published_normalisation="rgb-mean-std",
    verify="adapters.extensions.golden_sets.sparse:GOLDEN",
    clustered=True,
    as_published={"memory": {"memory_crosses_scenes": True}},
)
_DIFFUSION: Final = replace(
    _SPARSE,
    build="adapters.networks.sparse.model:DiffusionDrive",
    config="adapters.networks.sparse.config:SparseConfig.diffusiondrive",
)
_UNIAD: Final = Network(
    build="adapters.networks.uniad.model:UniAD",
    config="adapters.networks.uniad.config:UniADConfig.base_of",
    example="adapters.networks.uniad.planner:example_frame",
    published_normalisation="bgr-mean",
    settings={"solver": "newton", "stores_anchors": True},
    fitted=True,
    verify="adapters.extensions.golden_sets.uniad:GOLDEN",
    renamed=((r"\.conv(\d)_offset\.", r".conv\1.conv_offset."),),
    # Left over from a rewrite of the official code; unused according to its authors.
    ignored=(
        r"^bbox_size_fc\.",
        r"^pts_bbox_head\.query_embedding\.",
        r"^pts_bbox_head\.transformer\.reference_points\.",
    ),
    anchors=MOTION_ANCHORS,
    as_published={"can-once": {"motion_across_scenes": True}, "can-after": {}},
)
_VAD_PLANNER: Final = "adapters.networks.vad.planner:VADPlanner"
_SPARSE_PLANNER: Final = "adapters.networks.sparse.planner:SparsePlanner"
_UNIAD_PLANNER: Final = "adapters.networks.uniad.planner:UniADPlanner"
_VAD_BASE: Final = Model("vad-base", _VAD_PLANNER, _VAD, weights="vad-base", published_as="VAD", native_protocol="vad")
_BASELINES: Final = (
    Model(
        "constant-velocity",
        "adapters.planners.constant_velocity:ConstantVelocity",
        wants=("motion",),
        sees="own motion",
    ),
    Model("log-replay", "adapters.planners.log_replay:LogReplay", wants=(), sees="recorded future"),
    Model("idm", "adapters.planners.idm:IntelligentDriver", wants=("map", "motion"), sees="boxes, map"),
    Model("ego-status", "adapters.planners.ego_status:EgoStatus", wants=("motion",), sees="own motion, command"),
    Model("stop", "adapters.planners.stop:Stop", wants=(), sees="nothing"),
    Model(
        "constant-velocity-on-path",
        "adapters.planners.constant_velocity_on_path:ConstantVelocityOnPath",
        wants=("motion",),
        sees="own motion, recorded path",
    ),
    *(
        Model(
            name, f"adapters.planners.noisy_log:{kind}", wants=("motion",), sees="own motion, recorded future", draws=40
        )
        for name, kind in (("noisy-log", "NoisyLog"), ("noisy-log-published", "PublishedNoisyLog"))
    ),
)
_PUBLISHED: Final = (
    Model(
        "vad-tiny",
        _VAD_PLANNER,
        replace(_VAD, config="adapters.networks.vad.config:VADConfig.tiny"),
        weights="vad-tiny",
        native_protocol="vad",
    ),
    _VAD_BASE,
    Model(
        "sparsedrive",
        _SPARSE_PLANNER,
        _SPARSE,
        weights="sparsedrive",
        published_as="SparseDrive",
        native_protocol="sparsedrive",
    ),
    Model(
        "diffusiondrive",
        _SPARSE_PLANNER,
        replace(_DIFFUSION, seeded=True),
        weights="diffusiondrive",
        published_as="DiffusionDrive",
        native_protocol="diffusiondrive",
    ),
    Model("uniad", _UNIAD_PLANNER, _UNIAD, weights="uniad", published_as="UniAD", native_protocol="uniad"),
    Model(
        "uniad-unoptimised",
        _UNIAD_PLANNER,
        replace(_UNIAD, settings={"solver": None, "stores_anchors": True}),
        weights="uniad",
        native_protocol="uniad",
    ),
    Model(
        "uniad-ipopt",
        _UNIAD_PLANNER,
        replace(_UNIAD, settings={"solver": "ipopt", "stores_anchors": True}),
        weights="uniad",
        native_protocol="uniad",
        requires="adapters.networks.uniad.collision_optimiser:require_casadi",
        extra="[uniad]",
        extra_package="casadi",
    ),
)
_MINIATURES: Final = (
    Model(
        "uniad-mini",
        _UNIAD_PLANNER,
        replace(_UNIAD, config="adapters.networks.uniad.config:UniADConfig.miniature", fitted=False),
        miniature=Miniature(
            ("uniad",),
            "adapters.extensions.training.uniad.phases:build_untrained",
            "adapters.extensions.training.uniad.phases:phases",
            "adapters.extensions.training.uniad.phases:transfer_from_vad",
        ),
        native_protocol="uniad",
    ),
    Model(
        "vad-mini",
        _VAD_PLANNER,
        replace(_VAD, config="adapters.networks.vad.config:VADConfig.miniature"),
        miniature=Miniature(
            ("vad-tiny", "vad-base"),
            "adapters.extensions.training.vad.phases:build_untrained",
            "adapters.extensions.training.vad.phases:phases",
            "adapters.extensions.training.vad.phases:transfer_start_weights",
        ),
        native_protocol="vad",
    ),
    Model(
        "sparsedrive-mini",
        _SPARSE_PLANNER,
        replace(_SPARSE, config="adapters.networks.sparse.config:SparseConfig.miniature"),
        miniature=Miniature(
            ("sparsedrive",),
            "adapters.extensions.training.sparse.start:build_untrained",
            "adapters.extensions.training.sparse.phases:phases",
            "adapters.extensions.training.front:add_front_backbone",
        ),
        native_protocol="sparsedrive",
    ),
    Model(
        "diffusiondrive-mini",
        _SPARSE_PLANNER,
        replace(_DIFFUSION, config="adapters.networks.sparse.config:SparseConfig.miniature"),
        miniature=Miniature(
            ("diffusiondrive",),
            "adapters.extensions.training.sparse.start:build_untrained_diffusion",
            "adapters.extensions.training.sparse.phases:diffusion_phases",
            "adapters.extensions.training.sparse.start:transfer_from_sparsedrive",
        ),
        native_protocol="diffusiondrive",
    ),
)
MODELS: Final = {
    **{model.name: model for model in _BASELINES},
    "vad": _VAD_BASE,
    **{model.name: model for model in (*_PUBLISHED, *_MINIATURES)},
}
"""All built-in planners by what ``--model`` takes; ``vad`` is short for ``vad-base``."""


def verified_models() -> dict[str, str]:
    """References to the comparison of each model with its official code, family by family."""
    known = {name: model.net.verify for name, model in published_models().items() if model.net.verify is not None}
    return dict(sorted(known.items(), key=lambda item: item[1], reverse=True))
