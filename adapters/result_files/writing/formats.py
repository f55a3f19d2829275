"""``--dump-results FORMAT``: who writes which format."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from adapters.result_files.recognition import NO_PLANS, unknown_format_error
from adapters.result_files.samples import RecordedSamples
from adapters.result_files.writing import pickles, texts
from adapters.result_files.writing.pickles import PlansToWrite
from benchmark.errors import InputError
from benchmark.records.run import RunRecord

WRITERS: Final[Mapping[str, Callable[[Path, PlansToWrite], Path]]] = {
    "uniad": pickles.write_uniad,
    "vad-results": pickles.write_vad_results,
    "vad-out": pickles.write_vad_out,
    "sparsedrive": pickles.write_sparsedrive,
    "bev-planner": pickles.write_bev_planner,
    "bev-planner-json": texts.write_global,
    "omnidrive": texts.write_omnidrive,
    "opendrivevla": texts.write_modes,
    "opendrivevla-conversation": texts.write_conversation,
    "pred-trajs": pickles.write_pred_trajs,
    "gptdriver-text": texts.write_gptdriver,
    "admlp": pickles.write_admlp,
}
"""By the names of `adapters.result_files.recognition.FORMATS`."""


def require_writable(name: str) -> None:
    """Refuse a format that ``--dump-results`` does not take: there is none of that name, or it carries no plans."""
    if name == NO_PLANS:
        raise InputError(f"{NO_PLANS} holds metrics of LAW and no plan, so none can be written into it; choose another")
    if name not in WRITERS:
        raise unknown_format_error(name, WRITERS)


def write_results(record: RunRecord, samples: RecordedSamples, name: str, folder: Path) -> Path:
    """Write the plans of a record as a repository's result file.

    Args:
        record: The record.
        samples: Samples of its split.
        name: The format.
        folder: Where to; it is made.

    Returns:
        File or folder that ``--results`` reads.

    Raises:
        InputError: If the format is unknown, cannot hold these plans, or the file cannot be written.
    """
    require_writable(name)
    return WRITERS[name](folder, PlansToWrite.of_record(record, samples))
