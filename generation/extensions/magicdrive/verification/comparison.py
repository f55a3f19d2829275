"""`verify model --model magicdrive`: network, guidance and sampler against golden quantities of the official code."""

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.geometry import Floats
from benchmark.machine.devices import single_precision
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import NAMES, fill_network, have_same_names_and_shapes
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder, GoldenSet
from generation.extensions.magicdrive.conditions import ClipConditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.encoders import HIDDEN_BOX
from generation.extensions.magicdrive.layers import round_to_bfloat16
from generation.extensions.magicdrive.model import EncodedConditions, MagicDriveDiT
from generation.extensions.magicdrive.sampling import (
    GivenFrames,
    GuidanceMode,
    GuidedModel,
    SamplingOptions,
    SamplingState,
    build_null_conditions,
    choose_timesteps,
    sample_latents,
)
from generation.extensions.magicdrive.verification.golden_set import GoldenClip, MagicDriveGoldenSet

STEPS: Final = 4
REAL_INTRINSICS: Final = 100.0
"""By how much the intrinsic matrices of the set are smaller than real ones."""


@dataclass(frozen=True, slots=True)
class GoldenClips:
    """Network with a set's weights, the same ``rounded`` to bfloat16 with inputs and frequencies, and the clips."""

    network: MagicDriveDiT
    rounded: MagicDriveDiT
    golden: MagicDriveGoldenSet

    def case(self, name: str = "A", *, negative: bool = False) -> GoldenClip:
        """A clip on the network's device, without its negative prompt if that is not asked for."""
        case, device = self.golden.case(name), self.network.base_token.device
        conditions = case.conditions if negative else replace(case.conditions, negative_text=None)
        return GoldenClip(conditions.to(device), case.latent.to(device), case.timestep.to(device))

    def forward(self, name: str, rows_multiple: int = 1) -> Tensor:
        """One evaluation."""
        case = self.case(name)
        encoded = self.network.encode(case.conditions, rows_multiple=rows_multiple)
        return self.evaluated(case, encoded)

    def evaluated(self, case: GoldenClip, encoded: EncodedConditions, given: Tensor | None = None) -> Tensor:
        """One evaluation of something that is encoded."""
        out: Tensor = self.network(case.latent, case.timestep, encoded, given)
        return out

    def drop_frames(self, first: int, last: int) -> GoldenClip:
        """Clip A with ego motion and boxes of some frames dropped, as in training."""
        case = self.case()
        masks, ego = case.conditions.masks.clone(), case.conditions.rel_pos.clone()
        masks[:, first : last + 1][masks[:, first : last + 1] == 1] = HIDDEN_BOX
        ego[first : last + 1, :3] = self.network.frame_embedder.uncond_cam
        return replace(case, conditions=replace(case.conditions, masks=masks, rel_pos=ego))

    def drop_conditions(self) -> GoldenClip:
        """Clip A with prompt, camera, boxes and ego motion dropped, as in training; the map stays."""
        case = self.drop_frames(0, self.case().conditions.frames - 1)
        prompt = self.network.y_embedder.y_embedding
        camera = self.network.camera_embedder.uncond_cam.expand_as(case.conditions.cams)
        text = TextStates(prompt, torch.ones(len(prompt), dtype=torch.bool))
        return replace(case, conditions=replace(case.conditions, text=text, cams=camera))

    def compute_branches(self, mode: GuidanceMode, *, together: bool, negative: bool = False) -> tuple[Tensor, Tensor]:
        """Both branches of guidance."""
        case = self.case(negative=negative)
        guided = GuidedModel.of(self.network, case.conditions, mode=mode, together=together)
        return guided.compute_branches(case.latent, case.timestep)

    def sample(
        self, mode: GuidanceMode, *, together: bool = False, negative: bool = False, given: bool = False
    ) -> Tensor:
        """Latents after four steps."""
        case = self.case(negative=negative)
        known = None
        if given:
            reference = self.golden.numbers("A.in.ref", *case.latent.shape[1:])[None]
            generate = self.golden.outputs.floats("sample_firstframe_mask", 1, case.latent.shape[2])[0]
            known = GivenFrames(reference, torch.from_numpy(generate))
        options = SamplingOptions(steps=STEPS, mode=mode, together=together)
        return sample_latents(self.network, case.conditions, SamplingState(0, case.latent, 0), options, given=known)

    def compute_schedule(self) -> Tensor:
        """Timesteps of `sampled`."""
        known: ClipConditions = self.case().conditions
        return choose_timesteps(known.height, known.width, known.frames, STEPS, rounded=False)


def _encode_map(clips: GoldenClips, name: str) -> Tensor:
    """(1, t*S, C) before the projection that belongs to the control stream."""
    outputs: list[Tensor] = []
    handle = clips.network.controlnet_cond_patchifier.register_forward_hook(lambda *parts: outputs.append(parts[2]))
    try:
        clips.network.encode(clips.case(name).conditions)
    finally:
        handle.remove()
    return outputs[0].flatten(2, 3)[0]


def _encode_camera(clips: GoldenClips, intrinsics: float) -> Tensor:
    cams = clips.case().conditions.cams[:, 0, 0].clone()
    cams[:, :2, :3] *= intrinsics
    out: Tensor = clips.network.camera_embedder(cams)
    return out


def _encode_null_text(clips: GoldenClips) -> Tensor:
    null = build_null_conditions(clips.network, clips.case().conditions, keep_map=False)
    return clips.network.encode(null).tokens.text[0, 0]


def _encode_boxes(network: MagicDriveDiT, case: GoldenClip) -> Tensor:
    return network.encode(case.conditions).tokens.boxes[0] - network.base_token


def _encode_ego(clips: GoldenClips) -> Tensor:
    tokens = clips.network.encode(clips.case().conditions).tokens.ego[0] - clips.network.base_token
    return tokens.expand(clips.network.config.views, -1, -1, -1)


def _embed_time(clips: GoldenClips) -> Tensor:
    out: Tensor = clips.network.t_embedder(clips.case().timestep)
    return out


def _embed_rate(clips: GoldenClips) -> Tensor:
    return clips.network.encode(clips.case().conditions).rate


def _compute_modulation(clips: GoldenClips) -> Tensor:
    out: Tensor = clips.network.t_block(_embed_time(clips) + _embed_rate(clips))
    return out


def _evaluate_given(clips: GoldenClips) -> Tensor:
    case = clips.case()
    given = torch.tensor([[True, False, False]], device=case.latent.device)
    return clips.evaluated(case, clips.network.encode(case.conditions), given)


def _evaluate_rounded(clips: GoldenClips) -> Tensor:
    case = clips.case()
    encoded = clips.rounded.encode(case.conditions)
    out: Tensor = clips.rounded(round_to_bfloat16(case.latent), case.timestep, encoded)
    return out


def _evaluate_clip(clips: GoldenClips, case: GoldenClip) -> Tensor:
    return clips.evaluated(case, clips.network.encode(case.conditions))


ENCODERS: Final[dict[str, Callable[[GoldenClips], Tensor]]] = {
    "A.enc.text": lambda clips: clips.network.encode(clips.case().conditions).tokens.text[0, 0],
    "A.enc.text_null": _encode_null_text,
    "A.enc.box": lambda clips: _encode_boxes(clips.network, clips.case()),
    "A.enc.box_hidden_frames2_4": lambda clips: _encode_boxes(clips.network, clips.drop_frames(2, 4)),
    "A.enc.camera": lambda clips: _encode_camera(clips, 1.0),
    "A.enc.camera_real_scale": lambda clips: _encode_camera(clips, REAL_INTRINSICS),
    "A.enc.frame": _encode_ego,
    "A.enc.cond_sequence": lambda clips: clips.network.encode(clips.case().conditions).tokens.sequence()[0],
    "A.enc.map_2d": lambda clips: clips.network.controlnet_cond_embedder(clips.case().conditions.maps)[::4],
    "A.enc.map_tokens_view0": lambda clips: _encode_map(clips, "A"),
    "A.enc.t": _embed_time,
    "A.enc.fps": _embed_rate,
    "A.enc.t_block": _compute_modulation,
    "A.enc.pos_emb": lambda clips: clips.network.encode(clips.case().conditions).position[None],
    "B.enc.map_tokens_view0": lambda clips: _encode_map(clips, "B"),
}
"""Each condition on its own."""

LARGE: Final = frozenset({"A.enc.camera_real_scale"})
"""Numbers of some hundreds, whose errors are counted in standard deviations."""

EVALUATIONS: Final[dict[str, Callable[[GoldenClips], Tensor]]] = {
    "A.forward": lambda clips: clips.forward("A"),
    "B.forward": lambda clips: clips.forward("B"),
    "C.forward": lambda clips: clips.forward("C"),
    "D.forward_pad_h_4": lambda clips: clips.forward("A", rows_multiple=4),
    "A.forward_dropped_frames3_5": lambda clips: _evaluate_clip(clips, clips.drop_frames(3, 5)),
    "A.forward_dropped_cond": lambda clips: _evaluate_clip(clips, clips.drop_conditions()),
    "A.forward_x_mask_011": _evaluate_given,
    "A.cfg_rflow_batched": lambda clips: torch.cat(clips.compute_branches("rflow", together=True)),
    "A.cfg_rflow_batched_map0": lambda clips: clips.compute_branches("rflow-slice", together=True)[1],
    "A.cfg_slice_null": lambda clips: clips.compute_branches("rflow-slice", together=False)[1],
    "A.cfg_slice_negprompt": lambda clips: clips.compute_branches("rflow-slice", together=False, negative=True)[1],
}
"""One evaluation of the transformer."""

SAMPLES: Final[dict[str, Callable[[GoldenClips], Tensor]]] = {
    "A.sample_slice_cfg2_4steps": lambda clips: clips.sample("rflow-slice"),
    "A.sample_slice_neg_cfg2_4steps": lambda clips: clips.sample("rflow-slice", negative=True),
    "A.sample_rflow_cfg2_4steps": lambda clips: clips.sample("rflow", together=True),
    "A.sample_slice_first_latent_given": lambda clips: clips.sample("rflow-slice", given=True),
}
"""Four steps of two evaluations."""

SCHEDULES: Final[dict[str, Callable[[GoldenClips], Tensor]]] = {"A.sample_timesteps": GoldenClips.compute_schedule}

HALF_PRECISION: Final[dict[str, Callable[[GoldenClips], Tensor]]] = {
    "E.forward_bf16": _evaluate_rounded,
    "E.enc.box_bf16": lambda clips: _encode_boxes(clips.rounded, clips.case()),
}
"""Quantities that the official code computes in bfloat16; here in single precision on rounded weights and inputs."""


FILES: Final = ("manifest.json", "inputs.npz", "outputs.npz")
OF_SPREAD: Final = 1e-3
"""Largest error as a share of the golden standard deviation."""
EVALUATION: Final = 1e-4
"""Largest absolute error of one evaluation, independent of the spread."""
SAMPLE: Final = 1e-3
"""Largest error of four steps."""
TIMESTEP: Final = 1e-3
UNCORRELATED: Final = 1e-3
"""One less the correlation: official numbers in bfloat16 are themselves no more certain."""
PUBLISHED: Final = "names and shapes of tensors, published size"


def verify_magicdrive(golden: Path, device: str = "cpu") -> list[Check]:
    """Compare with a golden set, its folder or the one above it: one check a quantity, in single-precision tolerances.

    There are those of names alone if names or shapes differ, since weights cannot be filled then.
    """
    below = golden / "dev"
    folder = below if (below / FILES[0]).is_file() else golden
    return GoldenSet("MagicDriveDiT", FILES, (partial(_compare_network, device=device),), usual="dev").verify(folder)


def _compare_network(comparison: Comparison, folder: GoldenFolder, device: str) -> None:
    stored = MagicDriveGoldenSet.read(folder)
    if stored.published_shapes is not None:
        published = _build_meta_network(MagicDriveConfig.full())
        have_same_names_and_shapes(comparison, published, stored.published_shapes, PUBLISHED, "{elements:,} numbers")
    if not have_same_names_and_shapes(comparison, _build_meta_network(stored.config), stored.shapes):
        return
    network = MagicDriveDiT(stored.config).eval()
    fill_network(comparison, network, stored.recipe, stored.shapes)
    clips = GoldenClips(network.to(device), _round_network(network).to(device), stored)
    with single_precision(), torch.inference_mode():
        _compare_schedules(comparison, stored)
        _compare_stored(comparison, clips)
        if stored.inner is not None:
            _compare_inner(comparison, clips, stored.inner)
    known = {**ENCODERS, **EVALUATIONS, **SAMPLES, **SCHEDULES, **HALF_PRECISION, "sample_firstframe_mask": None}
    if unknown := sorted(stored.outputs.names - known.keys()):
        comparison.note(NAMES, f"not compared: {', '.join(unknown)}")


def _build_meta_network(config: MagicDriveConfig) -> MagicDriveDiT:
    """A network that has names and shapes only."""
    with torch.device("meta"):
        return MagicDriveDiT(config)


def _round_network(network: MagicDriveDiT) -> MagicDriveDiT:
    """The network that the published pipeline would run, computed exactly."""
    rounded = MagicDriveDiT(replace(network.config, rounded=True)).eval()
    rounded.load_state_dict(copy.deepcopy(network).to(torch.bfloat16).float().state_dict())
    return rounded


def _compare_schedules(comparison: Comparison, stored: MagicDriveGoldenSet) -> None:
    for entry in stored.schedules:
        size, wanted = (entry.height, entry.width, entry.num_frames), np.asarray(entry.timesteps, np.float64)
        rounded = entry.kwargs_dtype == "bfloat16"
        ours = choose_timesteps(*size, len(wanted), rounded=rounded)
        quantity = f"timesteps ({'size rounded to bfloat16' if rounded else 'exact size'})"
        comparison.numbers(quantity, ours.numpy(), wanted, TIMESTEP, where=" x ".join(map(str, size)))


def _compare_stored(comparison: Comparison, clips: GoldenClips) -> None:
    golden = clips.golden.outputs
    tables = ((ENCODERS, EVALUATION), (EVALUATIONS, EVALUATION), (SAMPLES, SAMPLE), (SCHEDULES, TIMESTEP))
    compared = 0
    for table, allowed in tables:
        for name, compute in table.items():
            if name in golden.names:
                _compare_tensor(comparison, golden, name, compute(clips), allowed)
                compared += 1
    for name, compute in HALF_PRECISION.items():
        if name in golden.names:
            ours = _to_floats(compute(clips))
            wanted = golden.floats(name, *ours.shape)
            correlation = float(np.corrcoef(ours.ravel(), wanted.ravel())[0, 1])
            comparison.errors(f"{name} (1 - correlation)", np.array([1 - correlation]), UNCORRELATED)
            compared += 1
    if not compared:
        raise ValueError("it stores no quantity of MagicDriveDiT")


def _compare_tensor(comparison: Comparison, golden: GoldenArrays, name: str, ours: Tensor, allowed: float) -> None:
    values = _to_floats(ours)
    wanted = golden.floats(name, *values.shape)
    spread = float(wanted.std())
    if name in LARGE:
        comparison.numbers(f"{name} (of its spread)", values / spread, wanted / spread, allowed)
    else:
        comparison.numbers(name, values, wanted, min(allowed, OF_SPREAD * spread))


def _compare_inner(comparison: Comparison, clips: GoldenClips, stored: GoldenArrays) -> None:
    """Compare the blocks in one evaluation of clip A; the same tolerance, since it is the same evaluation."""
    with _record_outputs(clips.network, stored.names) as taps:
        clips.forward("A")
    views = clips.network.config.views
    for name in sorted(stored.names & taps.keys()):
        tokens = taps[name][0].expand(views, -1, -1, -1)
        shaped = tokens if name == "before_proj" else tokens.flatten(1, 2)
        _compare_tensor(comparison, stored, name, shaped, EVALUATION)
    unknown = sorted(stored.names - taps.keys())
    if unknown:
        comparison.note(NAMES, f"not compared in {stored.path.name}: {', '.join(unknown)}")


@contextmanager
def _record_outputs(network: MagicDriveDiT, names: frozenset[str]) -> Iterator[dict[str, Tensor]]:
    """Collect outputs of modules; ``.skip`` after a control block's name is what it hands to the base stream."""
    taps: dict[str, Tensor] = {}

    def keep(name: str) -> Callable[[nn.Module, object, Tensor], None]:
        return lambda _module, _inputs, output: taps.__setitem__(name, output)

    modules = dict(network.named_modules())
    handles = []
    try:
        for name in names:
            place = name.replace(".skip", ".after_proj")
            if place in modules:
                handles.append(modules[place].register_forward_hook(keep(name)))
        yield taps
    finally:
        for handle in handles:
            handle.remove()


def _to_floats(tensor: Tensor) -> Floats:
    numbers: Floats = tensor.double().cpu().numpy()
    return numbers
