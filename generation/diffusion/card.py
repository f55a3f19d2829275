"""The model card: what the packaged weights were made from and how good they are, written from measurements."""

from pathlib import Path
from typing import Any, Final

from benchmark.storage import file_sha256, write_bytes
from generation.diffusion.bank import bank_beside
from generation.diffusion.checkpoint import read_tensors
from generation.diffusion.evaluation import Report, StrideError, compare_with_held_out, stride_errors

TITLES: Final = {
    "argoverse2": "Argoverse 2 (test excerpts of its API)",
    "comma2k19_example_ego": "comma2k19 (example segment)",
    "kitti_odometry_ego": "KITTI odometry (recording car)",
    "lyft_l5_prediction": "Lyft Level 5 prediction (one scene)",
    "ngsim_commonroad": "NGSIM (CommonRoad scenarios)",
    "ngsim_i80_smarts": "NGSIM I-80",
    "nuscenes_mini_scenarionet": "nuScenes mini (ScenarioNet)",
}

TEXT: Final = """\
# Trajectory denoiser

An unconditional diffusion model of how vehicles move in eight seconds, trained by `challenger-bench train denoiser`
(`generation/diffusion/training.py`). It stands in for the published checkpoint, which was trained on nuPlan; the class
is the same and loads that checkpoint too. Use: candidate trajectories for adversarial vehicles in research. Not a
motion planner: it sees neither road, nor traffic, nor the vehicle's own speed.

| file | SHA-256 | bytes |
|---|---|---|
| denoiser.safetensors | {weights_sha} | {weights_bytes} |
| denoiser.bank.safetensors | {bank_sha} | {bank_bytes} |

Network: {shape}; {parameters} parameters.
A Gaussian of the training data carries the linear part of the prediction.
Trained with seed {seed}, {steps} steps of {batch} windows, averaged weights, uniform noise levels; the same
command gives the same weights up to rounding on another machine. The bank holds {count} samples of the full 100-step
process, seed {bank_seed}, float16.

## Data and licence

Windows of 0.5 s of past and 8 s of future at 2 Hz in the rear-axle frame, smoothed by a local quadratic fit (1.7 s,
rough sources 2.3 s). Left out: paths under 5 m, more than 8 m/s^2 along or across, more than 10 m/s^3, headings against
the motion, turns tighter than 4.5 m. Half of the windows are mirrored, sizes vary by 10 %. A source is drawn with
chance proportional to the square root of its windows.

| source | windows | licence |
|---|---|---|
{sources}

Several sources are for non-commercial use, share alike (CC BY-NC-SA), so **the weights and the bank are too: CC
BY-NC-SA 4.0**, whatever the licence of the code. Waymo, INTERACTION and levelX were not trained on: they only check
the result.

## Against driving it never saw

{held_out_windows} windows of the held-out sources (Waymo Open Motion, INTERACTION, inD, highD). For the start of each
window a sample is drawn, again if no car could drive it from that speed. Distances are 1-Wasserstein. *Replay* draws
training windows instead of samples: what an unconditional model that knows its training data perfectly would reach.

| quantity | spread of held-out | samples to held-out | replay to held-out | samples to replay |
|---|---|---|---|---|
{comparisons}

- Drivable from a held-out start as drawn: {drivable_raw:.1%}; after drawing again: {drivable:.1%}.
  The model does not know the speed, so braking samples would reverse a slow car; that is why they are drawn again.
- Nearest training window, median, root mean square: {nearest_sample:.2f} m/s^2 from a sample,
  {nearest_held_out:.2f} m/s^2 from a held-out window: samples are {copies}.

## Fewer network calls in the truncated processes

The five rounds of refinement on a diversified batch at 8 m/s; root mean square difference of waypoints from the
reference's process (one call per noise level) with the same noise, beside what two draws of that process differ by.

| noise level | two draws, m | one call, m | two calls, m |
|---|---|---|---|
{strides}

Two calls are the default.
"""


def write_model_card(weights: Path, tracks: Path) -> Path:
    """Measure a model and write MODEL_CARD.md beside it.

    Args:
        weights: Written by `train_denoiser`, with a bank beside it.
        tracks: Folder of track files with the held-out sources.

    Returns:
        The card.

    Raises:
        InputError: If weights, bank or held-out sources are missing.
    """
    tensors, facts = read_tensors(weights)
    _, bank_facts = read_tensors(bank_beside(weights))
    report = compare_with_held_out(weights, tracks)
    network, bank = facts["denoiser"], bank_beside(weights)
    learnt = [tensor for name, tensor in tensors.items() if not name.startswith("preconditioner.")]
    text = TEXT.format(
        weights_sha=file_sha256(weights),
        weights_bytes=weights.stat().st_size,
        bank_sha=file_sha256(bank),
        bank_bytes=bank.stat().st_size,
        shape=f"width {network['feature_dim']}, {network['layers']} layers, {network['heads']} heads, "
        f"feed-forward {network['feedforward_dim']}",
        parameters=f"{sum(tensor.numel() for tensor in learnt):,}",
        count=bank_facts["count"],
        bank_seed=bank_facts["seed"],
        sources=_sources(facts),
        comparisons=_comparisons(report),
        strides=_strides(stride_errors(weights)),
        held_out_windows=f"{report.held_out_windows:,}",
        drivable_raw=report.drivable_raw,
        drivable=report.drivable,
        nearest_sample=report.nearest_sample,
        nearest_held_out=report.nearest_held_out,
        copies="not copies" if report.nearest_sample > 0.7 * report.nearest_held_out else "close to copies",
        **{name: facts[name] for name in ("seed", "steps", "batch")},
    )
    card = weights.parent / "MODEL_CARD.md"
    write_bytes(card, text.encode())
    return card


def _sources(facts: dict[str, Any]) -> str:
    return "\n".join(
        f"| {TITLES.get(name, name)} | {windows:,} | {facts['licences'][name]} |"
        for name, windows in sorted(facts["windows"].items())
    )


def _comparisons(report: Report) -> str:
    return "\n".join(
        f"| {row.quantity} | {row.held_out_spread:.3f} | {row.model:.3f} | {row.replay:.3f} | {row.learnt:.3f} |"
        for row in report.comparisons
    )


def _strides(errors: tuple[StrideError, ...]) -> str:
    return "\n".join(
        f"| {error.noise_level} | {error.two_draws:.2f} | {error.by_calls[1]:.2f} | {error.by_calls[2]:.2f} |"
        for error in errors
    )
