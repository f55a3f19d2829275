"""The model card of a miniature, written from the facts of its training."""

from collections.abc import Mapping
from typing import Any, Final

from adapters.extensions.training.plan_figures import ImageAblation
from adapters.models import Model

_TEXT: Final = """\
# {name}

A small network of the same class as {full}, trained by `challenger-bench train planner --model {name}` on the embedded
town so that `--model {name}` is a real run without any download. **It shows the pipeline and ranks nothing**: it is
{parameters} parameters large where the full model has tens of millions, reads images of 224 x 128, has never seen a
photograph, and drives only in the drawn town that it learned from. No figure below says anything about {full}.

## Training

| | |
|---|---|
| data | {frames:,} key frames of {scenes} scenes, split `{split}` of the embedded town (`data build --train-scenes`) |
| seed | {seed} |
| steps | {steps} |
| started from | {started} |
| commit | {commit} |
| version | {tool} |
| file | {bytes:,} bytes, SHA-256 `{sha256}` |

The same command with the same data, seed and starting weights gives the same weights on the same kind of processor; it
resumes where it was interrupted.

## Scores on {judged}, none of them trained on

Mean distance from the recorded position in metres, and the share of plans that touch anything within 3 s (protocol
`exact`). *blank*: all images grey. *shuffled*: images of another scene. The ego's own motion is the true one in all
rows, so the rows below the first say how much of a plan comes from the images.

| shown | samples | L2 1 s | L2 2 s | L2 3 s | collisions |
|---|---|---|---|---|---|
{rows}

{lost}{forecasts}

{seen}

Weights and card: Apache-2.0, as the code; the town is drawn by it.
"""
_FORECASTS: Final = """\
Of {vehicles:,} vehicles within 30 m (annotated, at least one lidar point) {recall:.0%} have a forecast, matched as the
diagnosis of collisions matches (`docs/diagnosis.md`); {precision:.0%} of the forecasts there are of something that is
annotated. Mean error over 3 s of the matched ones: {least_error_m:.2f} m (best mode), {likeliest_error_m:.2f} m (most
likely mode), {standing_error_m:.2f} m if everybody were expected to stay where it is."""
_VISIBLE_TEXT: Final = """\
Of the {vehicles:,} that are at least 40 % visible {recall:.0%} have a forecast whose present box is within 2 m, and
{precision:.0%} of the forecasts there are of something that is annotated. Mean error over 3 s of the matched ones:
{least_error_m:.2f} m (best mode), {likeliest_error_m:.2f} m (most likely mode), {standing_error_m:.2f} m for
standing still."""
_ABLATION_TEXT: Final = """\
With {shown} images, against its own, with the 95 % interval of the paired difference over scenes: {said}.

"""
_STARTS: Final = {"image_encoder": "image encoder", "start_from": "weights"}
_TITLES: Final = {
    "own": "its own images",
    "blank": "blank images",
    "shuffled": "shuffled images",
    "constant-velocity": "(constant velocity)",
}


def format_card(small: Model, facts: Mapping[str, Any]) -> str:
    """The card as Markdown."""
    source = facts["source"]
    commit = source["commit"] or "unknown"
    started = ", ".join(f"{_STARTS[option]} `{key[:16]}`" for option, key in facts["started_from"].items())
    start_share = facts.get("kept_of_start", 0)
    measured, lost = facts["figures"], facts.get("lost", {})
    rows = [
        f"| {title} | {row['samples']:.0f} | {row['l2_1s_m']:.2f} | {row['l2_2s_m']:.2f} | {row['l2_3s_m']:.2f} | "
        f"{row['collisions']:.1%} |"
        for name, title in _TITLES.items()
        if (row := measured.get(name)) is not None
    ]
    return _TEXT.format(
        name=small.name,
        full=small.small.stands_for[-1],
        parameters=f"{facts['parameters']:,}",
        scenes=facts["scenes"],
        frames=facts["frames"],
        split=facts["split"],
        seed=facts["seed"],
        steps=", ".join(
            f"{phase['steps']:,} ({name}, learning rate {phase['learning_rate']:g})"
            for name, phase in facts["phases"].items()
        ),
        started=(started or "random weights")
        + (f", {start_share:.0%} of them kept (weighted mean)" if start_share else ""),
        commit=f"{commit} with changes" if source["dirty"] else commit,
        tool=facts["tool"],
        bytes=facts["bytes"],
        sha256=facts["sha256"],
        judged=f"{len(facts['judged_on']['scenes'])} scenes of `{facts['judged_on']['data']}`",
        forecasts=_FORECASTS.format(**facts["forecasts"]) if facts["forecasts"] else "Forecasts: not measured.",
        seen=_VISIBLE_TEXT.format(**facts["seen"])
        if facts.get("seen")
        else "Forecasts of what is visible: not measured.",
        lost="".join(
            _ABLATION_TEXT.format(shown=name, said=ImageAblation.from_log(ablation).said())
            for name, ablation in lost.items()
        ),
        rows="\n".join(rows) or "| not measured | | | | | |",
    )
