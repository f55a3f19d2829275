"""Damages of a golden set, each of which must end as one sentence."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError

Verify = Callable[[Path], Any]


def said(verify: Verify, folder: Path) -> str:
    """The sentence with which a set is refused, which names its folder."""
    with pytest.raises(InputError) as caught:
        verify(folder)
    sentence = str(caught.value)
    assert str(folder) in sentence and len(sentence.splitlines()) == 1, sentence
    return sentence


def notices(verify: Verify, folder: Path) -> None:
    """What is wrong with a set that fits together may be found by its numbers too."""
    try:
        assert not all(check.ok for check in verify(folder))
    except InputError as error:
        assert str(folder) in str(error) and "\n" not in str(error)


def refuses(verify: Verify, whole: Path, file: str, array: str, work: Path) -> None:
    """No damaged copy of a set, in whose npz file ``array`` holds numbers, is compared; ``work`` is an empty folder."""
    with np.load(whole / file) as stored:
        arrays = {name: stored[name] for name in stored.files}
    numbers = arrays[array].astype(np.float64)
    poisoned = numbers.copy()
    poisoned.reshape(-1)[-1] = np.nan
    contents: dict[str, dict[str, Any] | bytes | None] = {
        "absent": None,
        "empty": b"",
        "truncated": (whole / file).read_bytes()[:-100],
        "no npz": b"no numbers",
        "no arrays": {},
        "array missing": {name: values for name, values in arrays.items() if name != array},
        "NaN": arrays | {array: poisoned},
        "shape": arrays | {array: numbers[..., :-1] if numbers.ndim else np.zeros(3)},
        "text": arrays | {array: numbers.astype("U4")},
        "pickled": arrays | {array: np.array([{"a": 1}], dtype=object)},
    }
    for name, content in contents.items():
        folder = Path(shutil.copytree(whole, work / name))
        (folder / file).unlink()
        if isinstance(content, bytes):
            (folder / file).write_bytes(content)
        elif content is not None:
            np.savez(folder / file, **content)
        assert said(verify, folder), name
    (work / "nothing").mkdir()
    said(verify, work / "nothing")
    said(verify, work / "nowhere")
