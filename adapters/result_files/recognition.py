"""Which format a file has: told by its content, never by its name."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files import bev_planner, sparsedrive, text_answers, trajectories, uniad, vad
from adapters.result_files.contract import ResultFormat, refuse
from benchmark.errors import InputError, did_you_mean
from benchmark.untrusted.files import ANSWER, RESULT_FILES, RefusedFileError, require_name, to_one_line
from benchmark.untrusted.result_files import first_bytes, parse_result_json, read_result_pickle, read_result_text

FORMATS: Final[Mapping[str, ResultFormat]] = {
    each.name: each
    for each in (
        uniad.FORMAT,
        vad.RESULTS,
        vad.OUT,
        sparsedrive.FORMAT,
        bev_planner.OUT,
        bev_planner.JSON,
        text_answers.OMNIDRIVE,
        text_answers.MODES,
        text_answers.CONVERSATION,
        trajectories.POSITIONS,
        text_answers.GPTDRIVER,
        trajectories.BATCHES,
    )
}
"""Every format that carries plans, by its name."""
AUTO, NO_PLANS = "auto", "law-out"
_TOKEN_NAME: Final = re.compile(r"[0-9a-f]{32}")
_JSON_STARTS: Final = b"[{"
_PICKLE: Final = 0x80
_PROTOCOLS: Final = range(2, 6)
_STARTS: Final[dict[bytes, str]] = {
    b"PK": "a zip archive, such as PyTorch's checkpoints",
    b"\x1f\x8b": "gzip",
    b"\x93NUMPY": "a numpy array",
    b"<": "a web page, such as a download page, not the file itself",
}
_ADVICE: Final = "a result file is what the repository's own evaluation writes (docs/your-results.md)"


@dataclass(frozen=True, slots=True)
class RecognisedFile:
    """A file whose format is known."""

    path: Path
    format: ResultFormat
    content: Any


def require_format(name: str) -> None:
    """Refuse a format that ``--format`` does not take: there is none of that name, or it carries no plans."""
    if name == NO_PLANS:
        raise InputError(f"{NO_PLANS} holds metrics of LAW and no plan; choose another format")
    if name != AUTO and name not in FORMATS:
        raise unknown_format_error(name, (AUTO, *FORMATS))


def unknown_format_error(name: str, known: Collection[str]) -> InputError:
    """Refusal of an unknown name, suggesting formats of the planner of that name, else similar names."""
    of_planner = [result_format.name for result_format in FORMATS.values() if name.lower() in result_format.planners]
    suggested = f"did you mean {' or '.join(of_planner)}? " if of_planner else did_you_mean(name, known)
    return InputError(f"no format {name!r}; {suggested}use one of {', '.join(known)}")


def recognise(path: Path, wanted: str = AUTO) -> RecognisedFile:
    """Open a result file and tell its format.

    Args:
        path: File or folder.
        wanted: The format that it must have, or ``auto``.

    Returns:
        Format and content.

    Raises:
        RefusedFile: If it is damaged, hostile, of no known format, or holds no plan.
        InputError: If it cannot be opened, or has another format than the one wanted.
    """
    require_name(path)
    if not path.exists():
        raise InputError(f"there is no result file {path}; name an existing one")
    recognised = _recognise_folder(path) if path.is_dir() else _recognise_file(path)
    if wanted not in (AUTO, recognised.format.name):
        raise InputError(f"{path} has the format {recognised.format.name}, not {wanted}; leave --format out")
    return recognised


def _recognise_folder(path: Path) -> RecognisedFile:
    names = []
    for file in path.iterdir():
        if not _TOKEN_NAME.fullmatch(file.name) or not file.is_file():
            fault = (
                f"the folder holds {to_one_line(file.name, 60)!r}, and a folder of answers holds files named by tokens"
            )
            refuse(path, "unknown", fault, "name the file of results, or the folder of OmniDrive's answers alone")
        names.append(file.name)
        if len(names) > RESULT_FILES:
            refuse(path, "size", f"the folder holds more than {RESULT_FILES} files", "name a folder of one run")
    if not names:
        refuse(path, "empty", "the folder is empty", "run the planner again")
    content = {}
    for name in sorted(names):
        data = read_result_text(path / name, ANSWER)
        if not data.strip():
            refuse(path, "truncated", f"the file {name} is empty", "run the planner again, it keeps old answers")
        content[name] = parse_result_json(data, str(path / name), ANSWER)
    return RecognisedFile(path, text_answers.OMNIDRIVE, content)


def _recognise_file(path: Path) -> RecognisedFile:
    start = first_bytes(path)
    if not start:
        refuse(path, "empty", "it is empty", "copy or make it again")
    if start[0] == _PICKLE and len(start) > 1 and start[1] in _PROTOCOLS:
        content = read_result_pickle(path)
        return RecognisedFile(path, _recognise_pickle(path, content), content)
    if start.lstrip()[:1] and start.lstrip()[0] in _JSON_STARTS:
        return _recognise_json(path)
    known = next((description for begin, description in _STARTS.items() if start.lstrip().startswith(begin)), None)
    text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in start[:16])
    refuse(path, "unknown", f"it is {known}" if known else f"it begins with {text!r}, which matches no format", _ADVICE)


def _recognise_json(path: Path) -> RecognisedFile:
    data = read_result_text(path)
    lines = [line for line in data.splitlines() if line.strip()]
    if _is_turn(path, lines[0]):
        content: Any = [parse_result_json(line, f"{path} line {at}") for at, line in enumerate(lines, start=1)]
        if all(isinstance(line, dict) for line in content):
            return RecognisedFile(path, text_answers.CONVERSATION, content)
        refuse(path, "unknown", "not all of its lines are objects", _ADVICE)
    content = parse_result_json(data, str(path))
    if isinstance(content, dict) and content:
        if {"trajs", "map_lane", "map_label"} <= content.keys():
            return RecognisedFile(path, bev_planner.JSON, content)
        if all(key.endswith(text_answers.SUFFIX) for key in content):
            return RecognisedFile(path, text_answers.MODES, content)
        if {"meta", "results"} <= content.keys():
            refuse(path, "no_plan", "it is a submission of detections, which holds boxes and no plan", _ADVICE)
    if not content:
        refuse(path, "empty", "it has no entries", "run the planner again")
    refuse(path, "unknown", f"it is a JSON {_kind(content)} of no known format", _ADVICE)


def _is_turn(path: Path, line: bytes) -> bool:
    """Whether a line by itself is a turn of a conversation: an object with id, question, answer."""
    try:
        value = parse_result_json(line, str(path))
    except RefusedFileError:
        return False
    return isinstance(value, dict) and {"id", "question", "answer"} <= value.keys()


def _recognise_pickle(path: Path, content: Any) -> ResultFormat:
    if isinstance(content, dict) and "plan_results" in content:
        return vad.RESULTS
    if isinstance(content, list) or (isinstance(content, dict) and "bbox_results" in content):
        return _recognise_entries(path, uniad.unwrap_entries(content))
    if isinstance(content, dict):
        if not content:
            refuse(path, "empty", "it has no entries", "run the planner again")
        if {"meta", "results"} <= content.keys():
            refuse(path, "no_plan", "it is a submission of detections, which holds boxes and no plan", _ADVICE)
        first = next(iter(content.values()))
        if isinstance(first, str):
            return text_answers.GPTDRIVER
        if isinstance(first, np.ndarray | list | tuple):
            return trajectories.BATCHES if np.ndim(_numeric(first)) == 3 else trajectories.POSITIONS
    refuse(path, "unknown", f"its pickle holds a {_kind(content)} of no known format", _ADVICE)


def _recognise_entries(path: Path, entries: Any) -> ResultFormat:
    if not isinstance(entries, list):
        refuse(path, "unknown", f"its bbox_results are a {_kind(entries)}, not a list", _ADVICE)
    if not entries:
        refuse(path, "empty", "it has no entries", "run the planner again")
    first = entries[0] if isinstance(entries[0], dict) else {}
    if "token" in first:
        if "planning_traj" not in first:
            refuse(path, "no_plan", "it comes from UniAD's first stage, which tracks but does not plan", _ADVICE)
        return uniad.FORMAT
    if isinstance(first.get("img_bbox"), dict) and "final_planning" in first["img_bbox"]:
        return sparsedrive.FORMAT
    if isinstance(first.get("pts_bbox"), dict) and "ego_fut_preds" in first["pts_bbox"]:
        return vad.OUT
    if "pred_ego_traj" in first:
        return bev_planner.OUT
    if "metric_results" in first:
        fault = f"its entries hold metrics and no plan, as LAW's do (format {NO_PLANS})"
        refuse(path, "no_plan", fault, "change the planner's code to store its trajectory; this file has none to score")
    if any(isinstance(first.get(key), dict) for key in ("img_bbox", "pts_bbox")):
        refuse(path, "no_plan", "its entries hold boxes and no plan", _ADVICE)
    refuse(path, "unknown", "its pickle holds a list of entries of no known format", _ADVICE)


def _numeric(value: Any) -> Any:
    try:
        return np.asarray(value)
    except ValueError:
        return ()


def _kind(value: Any) -> str:
    return {dict: "dictionary", list: "list", str: "text", type(None): "nothing"}.get(type(value), type(value).__name__)
