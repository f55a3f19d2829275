"""From noise to latents: rectified flow with classifier-free guidance (section 8), and tensors kept between stages."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, Self

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.machine.storage import content_seed
from benchmark.weights.tensors import read_tensors, write_tensors
from generation.extensions.magicdrive.conditions import ClipConditions, TextStates
from generation.extensions.magicdrive.layers import round_to_bfloat16
from generation.extensions.magicdrive.model import EncodedConditions, MagicDriveDiT

_NAME: Final = "tensor"


def cache_tensor(path: Path, key: str, tensor: Tensor, facts: dict[str, Any] | None = None) -> None:
    """Write a tensor and its plain ``facts``, whole or not at all; ``key`` is the content key of all it depends on."""
    plain = tensor.detach().cpu().contiguous()
    write_tensors(path, {_NAME: plain}, {"facts": facts or {}, "key": key, "sha256": _compute_sha256(plain)})


def read_cached_tensor(path: Path, key: str) -> tuple[Tensor, dict[str, Any]] | None:
    """Read a kept tensor, on the processor, and its facts; ``None`` if it is absent, damaged or of another ``key``."""
    try:
        tensors, metadata = read_tensors(path)
    except InputError:
        return None
    tensor = tensors.get(_NAME)
    if tensor is None or metadata.get("key") != key or metadata.get("sha256") != _compute_sha256(tensor):
        return None
    return tensor, metadata["facts"]


def _compute_sha256(tensor: Tensor) -> str:
    plain = tensor.view(torch.uint8) if tensor.dtype is torch.bfloat16 else tensor
    return hashlib.sha256(plain.numpy().tobytes()).hexdigest()


GuidanceMode = Literal["rflow-slice", "rflow"]


def build_null_conditions(model: MagicDriveDiT, conditions: ClipConditions, *, keep_map: bool) -> ClipConditions:
    """Conditions of the null branch (section 8): size and frame rate, and a negative prompt if there is one.

    One empty box stands for all; prompt, camera and ego motion are the learned null ones of ``model``.
    """
    views, frames = conditions.views, conditions.frames
    text, negative = conditions.text, conditions.negative_text
    hidden = model.y_embedder.y_embedding if negative is None else negative.hidden
    ego = conditions.rel_pos.clone()
    ego[:, :3] = model.frame_embedder.uncond_cam
    return replace(
        conditions,
        bboxes=conditions.bboxes.new_zeros(1, frames, 1, 8, 3),
        classes=conditions.classes.new_zeros(1, frames, 1),
        masks=conditions.masks.new_zeros(views, frames, 1),
        box_latent=conditions.box_latent.new_zeros(1, conditions.box_latent.shape[1]),
        cams=model.camera_embedder.uncond_cam.to(conditions.cams.dtype).expand_as(conditions.cams),
        rel_pos=ego,
        maps=conditions.maps if keep_map else torch.zeros_like(conditions.maps),
        # As published: as many tokens as the prompt has, regardless of the negative prompt's length.
        text=TextStates(hidden, text.mask),
        negative_text=None,
    )


class GuidedModel:
    """A network with the conditions of one clip."""

    def __init__(
        self,
        model: MagicDriveDiT,
        conditional: EncodedConditions,
        unconditional: EncodedConditions,
        scale: float,
        *,
        together: bool,
    ) -> None:
        """Take encoded branches; scale 1 is the first alone, both ``together`` as one batch take twice the memory."""
        self._model, self._scale = model, scale
        self._branches = (
            (EncodedConditions.batch([conditional, unconditional]),) if together else (conditional, unconditional)
        )

    @classmethod
    def of(
        cls,
        model: MagicDriveDiT,
        conditions: ClipConditions,
        *,
        mode: GuidanceMode = "rflow-slice",
        scale: float = 2.0,
        together: bool = False,
        keep_keys_values: bool = False,
        rows_multiple: int | None = None,
    ) -> Self:
        """Encode both branches; ``rflow-slice`` takes the map away from the null branch, ``rflow`` leaves it there.

        One batch of both, `together`, takes twice the memory; `keep_keys_values`, for speed, does not go with it.
        `rows_multiple` is by default the configuration's.
        """
        keep = keep_keys_values and not together
        null = build_null_conditions(model, conditions, keep_map=mode == "rflow")
        return cls(
            model,
            model.encode(conditions, rows_multiple=rows_multiple, keep_keys_values=keep),
            model.encode(null, box_repeats=conditions.boxes, rows_multiple=rows_multiple, keep_keys_values=keep),
            scale,
            together=together,
        )

    def compute_branches(self, latent: Tensor, timestep: Tensor, given: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Velocities of both branches; arguments as in `MagicDriveDiT.forward` with a batch of one."""
        if len(self._branches) == 1:
            twice = None if given is None else given.expand(2, -1)
            inputs = latent.expand(2, *latent.shape[1:]), timestep.expand(2)
            both = self._model(*inputs, self._branches[0], twice).chunk(2)
        else:
            both = tuple(self._model(latent, timestep, encoded, given) for encoded in self._branches)
        conditional, unconditional = both
        return conditional, unconditional

    def velocity(self, latent: Tensor, timestep: Tensor, given: Tensor | None = None) -> Tensor:
        """The velocity to follow, (1, 96, t, h, w) in single precision."""
        conditional, unconditional = self.compute_branches(latent, timestep, given)
        return unconditional + self._scale * (conditional - unconditional)


PURE_NOISE: Final = 1000.0
"""Timestep at which there is nothing but noise; at 0 there is none."""
_TRAINED_PIXELS: Final = 512 * 512


@dataclass(frozen=True, slots=True)
class SamplingOptions:
    """Options of sampling; the defaults are those of the published pipeline.

    `steps` are evaluations of each branch; `mode` as in `GuidedModel.of`. The velocities are the same with `together`
    (one batch of both: fewer and larger kernels, twice the memory) and `keep_keys_values` (1 % fewer operations).
    """

    steps: int = 30
    guidance: float = 2.0
    mode: GuidanceMode = "rflow-slice"
    together: bool = False
    keep_keys_values: bool = False


@dataclass(frozen=True, slots=True)
class GivenFrames:
    """Latent frames that are known, so that a clip goes on from another one; `latent` is (1, 96, t, h, w).

    `generate` (t,) is 1 for frames to generate, 0 for given ones; a frame with a share in between is known until the
    timestep falls below that share of 1000, then gets noise and is generated too.
    """

    latent: Tensor
    generate: Tensor


@dataclass(frozen=True, slots=True)
class SamplingState:
    """State of sampling after ``step`` steps: (1, 96, t, h, w) float32 latent, and the seed of all noise."""

    step: int
    latent: Tensor
    seed: int

    def save(self, path: Path, key: str) -> None:
        """Write the state, whole or not at all; ``key`` is the content key of everything that it depends on."""
        cache_tensor(path, key, self.latent, {"step": self.step, "seed": self.seed})

    @classmethod
    def load(cls, path: Path, key: str) -> "SamplingState | None":
        """Read a state, on the processor; ``None`` if it is absent, damaged or of something else than ``key``."""
        cached = read_cached_tensor(path, key)
        if cached is None:
            return None
        latent, facts = cached
        return cls(facts["step"], latent, facts["seed"])


def choose_timesteps(height: int, width: int, frames: int, steps: int, *, rounded: bool) -> Tensor:
    """(steps,) timesteps falling from 1000: the larger the video, the longer it stays near pure noise.

    ``rounded`` computes with the size in bfloat16, as in the published pipeline.
    """
    number_type = torch.bfloat16 if rounded else torch.float32
    high, wide, long = torch.tensor([height, width, frames], dtype=torch.float32).to(number_type)[:, None]
    latent_frames = long if frames == 1 else long // 4 + long % 2
    shift = (high * wide / _TRAINED_PIXELS).sqrt() * latent_frames.sqrt()
    even = torch.tensor([(1.0 - step / steps) * PURE_NOISE for step in range(steps)]) / PURE_NOISE
    times: Tensor = shift * even / (1 + (shift - 1) * even) * PURE_NOISE
    return times


def draw_first_state(model: MagicDriveDiT, conditions: ClipConditions, seed: int) -> SamplingState:
    """Pure noise before the first step, the same on every device; make the ``seed`` of all noise of content."""
    size = model.compute_latent_size(conditions)
    shape = (1, model.config.packed_channels, size.frames, size.rows, size.columns)
    noise = torch.randn(shape, generator=torch.Generator().manual_seed(seed))
    return SamplingState(0, round_to_bfloat16(noise) if model.config.rounded else noise, seed)


@torch.no_grad()
def sample_latents(
    model: MagicDriveDiT,
    conditions: ClipConditions,
    state: SamplingState,
    options: SamplingOptions | None = None,
    *,
    given: GivenFrames | None = None,
    on_step: Callable[[SamplingState], None] | None = None,
) -> Tensor:
    """Sample the latents of one clip from `draw_first_state`, or from a state that was saved after a step.

    (1, 96, t, h, w) float32 on the network's device (`unpack_views` takes the views apart), refused if not finite.
    """
    options = options or SamplingOptions()
    device = model.base_token.device
    guided = GuidedModel.of(
        model,
        conditions.to(device),
        mode=options.mode,
        scale=options.guidance,
        together=options.together,
        keep_keys_values=options.keep_keys_values,
    )
    size = (conditions.height, conditions.width, conditions.frames)
    times = choose_timesteps(*size, options.steps, rounded=model.config.rounded).tolist()
    flow = _GuidedFlow(guided, times, given, device)
    latent = flow.start(state.latent.to(device)) if state.step == 0 else state.latent.to(device)
    for step in range(state.step, options.steps):
        latent = flow.step(latent, step, state.seed)
        if not bool(torch.isfinite(latent).all()):
            raise InputError(
                f"the network gives NaN or infinity at step {step + 1} of {options.steps}; check the weights and the "
                "device with: challenger-bench verify model --model magicdrive --golden DIR"
            )
        if on_step is not None:
            on_step(SamplingState(step + 1, latent, state.seed))
    return latent


class _GuidedFlow:
    """Steps along the guided velocity."""

    def __init__(
        self, guided: GuidedModel, times: list[float], given: GivenFrames | None, device: torch.device
    ) -> None:
        self._guided, self._times, self._device = guided, times, device
        self._given = None if given is None else given.latent.to(device)
        # Compared on the processor: a step must not wait for the device to know which frames are its.
        self._generate = None if given is None else given.generate.float().cpu()

    def start(self, noise: Tensor) -> Tensor:
        """Noise, but for the frames that are known at first."""
        if self._given is None or self._generate is None:
            return noise
        return torch.where(self._frames(self._generate == 1), noise, self._given)

    def step(self, latent: Tensor, step: int, seed: int) -> Tensor:
        """The latent after one step more."""
        time = self._times[step]
        following = self._times[step + 1] if step + 1 < len(self._times) else 0.0
        timestep = torch.tensor([time], device=self._device)
        if self._generate is None:
            return latent + self._guided.velocity(latent, timestep) * ((time - following) / PURE_NOISE)
        active = self._generate * PURE_NOISE >= time
        before = self._generate == 1
        if step:
            before = before | (self._generate * PURE_NOISE >= self._times[step - 1])
        if bool((active & ~before).any()):
            generator = torch.Generator().manual_seed(content_seed("joining frames", seed, step))
            noise = torch.randn(latent.shape, generator=generator).to(self._device)
            level = time / PURE_NOISE
            noisy = level * noise + (1 - level) * latent
            latent = torch.where(self._frames(active & ~before), noisy, latent)
        known = None if bool(active.all()) else ~active[None].to(self._device)
        moved = latent + self._guided.velocity(latent, timestep, known) * ((time - following) / PURE_NOISE)
        return torch.where(self._frames(active), moved, latent)

    def _frames(self, chosen: Tensor) -> Tensor:
        """(t,) for a latent's shape."""
        return chosen.to(self._device)[None, None, :, None, None]
