"""The model card: what weights were made from and how good they are, written from the facts of training."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from torch import Tensor

from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, write_bytes
from benchmark.weights.tensors import read_tensors
from generation.diffusion.checkpoint import find_bank_path
from generation.extensions.denoiser_training.loop import HELD_OUT_SOURCES
from generation.extensions.denoiser_training.track_sources import find_track_sources
from generation.extensions.denoiser_training.tracks import MAX_ROUGHNESS
from generation.extensions.denoiser_training.window_pool import EVENING, MOST_OF_ONE_SOURCE

TITLES: Final = {
    "argoverse2": "Argoverse 2 (test excerpts of its API)",
    "comma2k19_example_ego": "comma2k19 (example segment)",
    "interaction_sample": "INTERACTION",
    "kitti_odometry_ego": "KITTI odometry (recording car)",
    "levelx_commonroad": "levelX (inD, highD)",
    "lyft_l5_prediction": "Lyft Level 5 prediction (one scene)",
    "ngsim_commonroad": "NGSIM (CommonRoad scenarios)",
    "ngsim_i80_smarts": "NGSIM I-80",
    "nuscenes_mini_scenarionet": "nuScenes mini (ScenarioNet)",
    "womd_gpudrive_nocturne": "Waymo Open Motion",
    "womd_official_testdata": "Waymo Open Motion",
    "womd_scenarionet": "Waymo Open Motion",
}

INTRODUCTION: Final = """\
# Trajectory denoiser

A diffusion model of how vehicles move in eight seconds, trained by `challenger-bench train denoiser`
(`generation/extensions/denoiser_training/loop.py`). It stands in for the published checkpoint, which was trained on
nuPlan; the class is the same and loads that checkpoint too. Use: candidate trajectories for adversarial vehicles in
research. Not a motion planner: it sees neither road nor traffic{knowing}.

{files}

Network: {shape}; {parameters:,} parameters.
{carried}
Trained by `challenger-bench train denoiser --tracks DIR --out FILE --seed {seed} --steps {steps}`:
{batch} windows a step, averaged weights, {levels}, stored in half precision.
{best}The same command gives the same weights up to rounding on another machine. The state that is kept, the size of the
network and the scaling of windows were chosen by the held-out loss; else held-out sources, cleaned as the others, only
measure.
The bank holds {count} samples of the full 100-step process, told nothing of the vehicle, seed {bank_seed}, float16; a
search uses it only where stored samples are asked for (`generate --samples stored`).

## Data and licence

Windows of 0.5 s of past and 8 s of future at 2 Hz in the rear-axle frame, smoothed by a local quadratic fit (1.7 s,
rough sources 2.3 s). Left out: paths under 5 m, more than 8 m/s^2 along or across, more than 10 m/s^3, jitter of
perception (acceleration that changes by more than {roughness:g} m/s^2 in most half seconds), headings against motion,
turns tighter than 4.5 m. Half of the windows are mirrored, sizes vary by {jitter:.0%}. A source is drawn with chance
proportional to the square root of its windows, but at most {cap:.0%}; then cells of present speed and of turn over 8 s
are evened out to the power of {evening:g} across sources.

{sources}

{terms}
"""
CONDITIONED: Final = "; of the vehicle it is told the present speed and turn, if anything"
UNCONDITIONED: Final = ", nor the vehicle's own speed"
GAUSSIAN_NOTE: Final = "A Gaussian of the training data carries the linear part of the prediction."
GAUSSIAN_BY_SPEED_NOTE: Final = (
    "Gaussians of the training data, one for each of seven present speeds and one of all, carry the linear part."
)
PLAIN: Final = "Without the packaged network's preconditioning, as published."
SHARE_ALIKE: Final = """\
Several sources are for non-commercial use, share alike (CC BY-NC-SA), so **the weights and the bank are too: CC
BY-NC-SA 4.0**, whatever the licence of the code."""
OTHER_TERMS: Final = "**Weights and bank carry the terms of these sources**, whatever the licence of the code."
NOT_MEASURED: Final = """\
## Measurements

Not made. How the packaged model was compared with driving that it never saw, and which script did it, is in
`docs/studies/trajectory-model.md` of challenger-bench.
"""


def write_model_card(weights: Path, tracks: Path, measured: Sequence[str] = (NOT_MEASURED,)) -> Path:
    """Write MODEL_CARD.md beside a model.

    Args:
        weights: Written by `train_denoiser`, with a bank beside it.
        tracks: Folder of recordings that it was trained on.
        measured: Further sections, in Markdown.

    Returns:
        The card.

    Raises:
        InputError: If weights or bank cannot be read, or the weights do not say how they were trained.
    """
    tensors, facts = read_tensors(weights)
    if missing := {"seed", "steps", "batch", "windows", "licences"} - facts.keys():
        raise InputError(f"{weights} does not record its {', '.join(sorted(missing))}; train it with this program")
    card = weights.parent / "MODEL_CARD.md"
    sections = [_format_introduction(weights, tensors, facts, list_held_out_sources(facts, tracks)), *measured]
    write_bytes(card, "\n".join(sections).encode())
    return card


def list_held_out_sources(facts: dict[str, Any], tracks: Path) -> list[str]:
    """Names of the sources in a folder of recordings that check a model; ``facts`` are stored with its weights."""
    named = facts.get("held_out", HELD_OUT_SOURCES)
    return [source.name for source in find_track_sources(tracks) if source.name in named]


def format_table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(map(str, line)) + " |" for line in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def _format_introduction(weights: Path, tensors: dict[str, Tensor], facts: dict[str, Any], held_out: list[str]) -> str:
    bank = find_bank_path(weights)
    _, bank_facts = read_tensors(bank)
    files = [(path.name, file_sha256(path), path.stat().st_size) for path in (weights, bank)]
    learnt = [tensor for name, tensor in tensors.items() if not name.startswith("preconditioner.")]
    rough, shares = facts.get("rough", {}), facts.get("shares", {})
    sources = [
        (
            TITLES.get(name, name),
            f"{windows:,}",
            f"{rough[name]:,}" if name in rough else "-",
            f"{shares[name]:.0%}" if name in shares else "-",
            facts["licences"][name],
        )
        for name, windows in sorted(facts["windows"].items())
    ]
    network, best = facts["denoiser"], facts.get("best_step")
    return INTRODUCTION.format(
        files=format_table(("file", "SHA-256", "bytes"), files),
        knowing=CONDITIONED if network.get("conditioned") else UNCONDITIONED,
        shape=_format_shape(network),
        carried=_format_gaussian_note(network),
        parameters=sum(tensor.numel() for tensor in learnt),
        levels=_format_levels(facts.get("level_power", 1.0)),
        best=f"The state after step {best:,} was the best on held-out windows and is this one.\n" if best else "",
        count=bank_facts["count"],
        bank_seed=bank_facts["seed"],
        jitter=facts.get("size_jitter", 0.1),
        roughness=MAX_ROUGHNESS,
        cap=MOST_OF_ONE_SOURCE,
        evening=1 - EVENING,
        sources=format_table(("source", "windows", "left out as jitter", "share of a batch", "licence"), sources),
        terms=_format_terms(facts, held_out),
        **{name: facts[name] for name in ("seed", "steps", "batch")},
    )


def _format_shape(network: dict[str, Any]) -> str:
    width, layers, hidden = network["feature_dim"], network["layers"], network["feedforward_dim"]
    if network.get("attention", True):
        return f"transformer, width {width}, {layers} layers, {network['heads']} heads, feed-forward {hidden}"
    return f"{layers} residual blocks on all 48 numbers at once, width {width}, hidden width {hidden}"


def _format_gaussian_note(network: dict[str, Any]) -> str:
    if not network.get("preconditioned"):
        return PLAIN
    return GAUSSIAN_BY_SPEED_NOTE if network.get("conditioned") else GAUSSIAN_NOTE


def _format_levels(power: float) -> str:
    return "uniform noise levels" if power == 1 else f"noise levels 100 u^{power:g} for uniform u"


def _format_terms(facts: dict[str, Any], held_out: list[str]) -> str:
    share_alike = any("BY-NC-SA" in licence for licence in facts["licences"].values())
    titles = sorted({TITLES.get(name, name) for name in held_out})
    checked = f"\nNot trained on, they only check the result: {', '.join(titles)}." if titles else ""
    return (SHARE_ALIKE if share_alike else OTHER_TERMS) + checked
