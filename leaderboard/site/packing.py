"""Numbers of a scene as short JSON, in scripts: a page opened from disk may load scripts and may not fetch files."""

import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, parse_json


def encode_script(target: str, value: Any) -> bytes:
    """A script, in ASCII, that assigns a value to JavaScript of ours (no name from a record, unless written as JSON).

    The value, without NaN and infinity, is parsed as JSON: faster for large values, and a name such as ``__proto__``
    stays a name.
    """
    text = canonical_json(value).replace("\\", "\\\\").replace("'", "\\'").replace("<", "\\x3c")
    return f"\"use strict\";\n{target} = JSON.parse('{text}');\n".encode("ascii")


def decode_script(text: str) -> Any:
    """The value that a script of `encode_script` assigns."""
    _, separator, rest = text.partition("JSON.parse('")
    literal, end, _ = rest.rpartition("')")
    if not separator or not end:
        raise InputError("a script of the site assigns no data; write the leaderboard again")
    plain = re.sub(r"\\(x3c|.)", lambda escape: "<" if escape[1] == "x3c" else escape[1], literal)
    try:
        return parse_json(plain.encode())
    except ValueError as error:
        raise InputError(f"a script of the site holds damaged data ({error}); write the leaderboard again") from error


CENTIMETRE: Final = 0.01
DECIMETRE: Final = 0.1
MILLIRADIAN: Final = 0.001

PackedSeries = list[int | None]
"""First value, then steps, in whole units; null where there is no value; zeros at the end are left out."""


def pack_series(values: Sequence[float | None], unit: float) -> PackedSeries:
    """A series as steps between values rounded to the unit first, so that errors do not add up; zeros at the end go."""
    steps: PackedSeries = []
    before = 0
    for value in values:
        if value is None:
            steps.append(None)
            continue
        now = round(value / unit)
        steps.append(now - before)
        before = now
    while steps and steps[-1] == 0:
        steps.pop()
    return steps


def pack_poses(
    x: Sequence[float | None], y: Sequence[float | None], yaw: Sequence[float | None]
) -> dict[str, PackedSeries]:
    """A track, of metres and radians, as scripts have it."""
    return {"x": pack_series(x, CENTIMETRE), "y": pack_series(y, CENTIMETRE), "yaw": pack_series(yaw, MILLIRADIAN)}


def pack_path(points: ArrayLike, unit: float, start: tuple[float, float] = (0.0, 0.0)) -> list[int]:
    """(N, 2) metres as 2 N steps from ``start``, x and y in turn; zeros at the end stay: they tell its length."""
    steps = np.rint(np.vstack([np.array([start]), np.asarray(points, np.float64).reshape(-1, 2)]) / unit)
    return [int(step) for step in np.diff(steps, axis=0).ravel()]
