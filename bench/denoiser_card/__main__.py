"""Measure a trajectory model against driving that it never saw, and write its model card with the figures.

Run as ``python -m bench.denoiser_card WEIGHTS TRACKS`` in the project's folder: WEIGHTS is a file of ``challenger-bench
train denoiser``, TRACKS the folder of recordings that it was trained on.
"""

import argparse
import sys
from pathlib import Path
from typing import Final

from bench.denoiser_card.evaluation import compare_with_held_out, load_held_out
from bench.denoiser_card.sampling_steps import full_process_costs, stride_errors
from bench.denoiser_card.sections import (
    beside_section,
    comparison_sections,
    full_process_section,
    truncated_process_section,
)
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
from benchmark.weights.tensors import read_tensors
from generation.diffusion.checkpoint import load_denoiser
from generation.extensions.denoiser_training.card import TITLES, held_out_sources, write_model_card
from generation.extensions.denoiser_training.loop import HELD_OUT_SOURCES

NOTHING_HELD_OUT: Final = """\
## Against driving it never saw

Not measured: the folder of tracks held none of the held-out sources.
"""


def write_measured_card(weights: Path, tracks: Path, beside: Path | None = None) -> Path:
    """Measure a model and write MODEL_CARD.md beside it.

    Args:
        weights: Written by `train_denoiser`, with a bank beside it.
        tracks: Folder of recordings that it was trained on; without held-out sources in it the card says that nothing
            was compared.
        beside: Weights of another model that is measured in the same run.

    Returns:
        The card.

    Raises:
        InputError: If weights, bank or recordings cannot be read, or the weights do not say how they were trained.
    """
    _, facts = read_tensors(weights)
    present = held_out_sources(facts, tracks)
    sections = [NOTHING_HELD_OUT]
    if present:
        held_out = load_held_out(tracks, tuple(facts.get("held_out", HELD_OUT_SOURCES)))
        titles = sorted({TITLES.get(name, name) for name in present})
        report = compare_with_held_out(weights, held_out)
        sections = comparison_sections(report, titles)
        if beside is not None:
            parameters = sum(tensor.numel() for tensor in load_denoiser(beside).parameters())
            which = f"{parameters:,} parameters, SHA-256 {file_sha256(beside)}"
            sections.append(beside_section(report, compare_with_held_out(beside, held_out), which))
        sections.append(full_process_section(full_process_costs(weights, held_out)))
    return write_model_card(weights, tracks, [*sections, truncated_process_section(stride_errors(weights))])


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", type=Path, metavar="WEIGHTS")
    parser.add_argument("tracks", type=Path, metavar="TRACKS")
    parser.add_argument("--beside", type=Path, metavar="WEIGHTS", help="another model, measured in the same run")
    given = parser.parse_args()
    try:
        print(write_measured_card(given.weights, given.tracks, given.beside))
    except InputError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
