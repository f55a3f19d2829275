"""Foreign files of verdicts on scenes: CSV with a line a scene, or JSON like the one beside a split."""

import csv
import io
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.untrusted.files import VERDICTS, Limits, format_bytes, read_file, to_one_line
from benchmark.untrusted.text_files import read_json

COLUMNS: Final = ("scene", "verdict", "reason", "inspector", "token")
_NEEDED: Final = ("scene", "verdict")
_SAID: Final = {"accept": "accepted", "reject": "rejected"}
"""Accepted short forms of verdicts."""


def read_verdicts(path: Path, limits: Limits = VERDICTS) -> dict[str, dict[str, Any]]:
    """Read inspectors' verdicts on scenes: members by name, texts of verdicts in full, the rest unchecked.

    A ``.csv`` file names its columns in the first line (`COLUMNS`, of which ``scene`` and ``verdict`` must be there). A
    ``.json`` file is an object of objects by name of the scene, with the other columns as members, alone or as
    ``verdicts`` of a ``review.json``. A scene that is named twice is refused.
    """
    kind = path.suffix.lower()
    if kind not in (".csv", ".json"):
        raise InputError(f"{path} is not a file of verdicts; give a .csv or .json file")
    verdicts = _from_csv(path, limits) if kind == ".csv" else _from_json(path, limits)
    for members in verdicts.values():
        verdict = members.get("verdict")
        if isinstance(verdict, str):
            members["verdict"] = _SAID.get(verdict.strip().lower(), verdict.strip().lower())
    return verdicts


def _from_json(path: Path, limits: Limits) -> dict[str, dict[str, Any]]:
    value = read_json(path, limits)
    if isinstance(value, dict) and "format" in value:
        value = value.get("verdicts")
    if not isinstance(value, dict) or not all(isinstance(members, dict) for members in value.values()):
        raise InputError(
            f'{path} must be an object of verdicts by name of the scene, such as {{"scene-0061-1a2b3c4d": '
            '{"verdict": "rejected", "reason": "drives through a kerb"}}; correct it'
        )
    return {name: dict(members) for name, members in value.items()}


def _from_csv(path: Path, limits: Limits) -> dict[str, dict[str, Any]]:
    data = read_file(path, limits)
    if max(map(len, data.splitlines()), default=0) > limits.line_bytes:
        raise InputError(
            f"{path} has a line longer than {format_bytes(limits.line_bytes)}; it is not a file of verdicts"
        )
    try:
        rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig")), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is not a CSV file ({to_one_line(error)}); make it again") from error
    if len(rows) > limits.values:
        raise InputError(f"{path} has more than {limits.values} lines; it is not a file of verdicts")
    verdicts: dict[str, dict[str, Any]] = {}
    for number, row in enumerate(rows, start=2):
        if not set(_NEEDED) <= row.keys() or not {str(name) for name in row} <= set(COLUMNS):
            raise InputError(
                f"{path} must have the columns {', '.join(_NEEDED)}, and may have {', '.join(COLUMNS[2:])}; its first "
                f"line is {to_one_line(','.join(map(str, row)), 80)}"
            )
        members = {name: text.strip() for name, text in row.items() if text is not None and text.strip()}
        name = members.pop("scene", "")
        if not name or name in verdicts:
            raise InputError(f"{path} line {number} {'names a scene twice' if name else 'names no scene'}; correct it")
        verdicts[name] = members
    return verdicts
