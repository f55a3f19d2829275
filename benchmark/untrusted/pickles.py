"""Pickles of recordings and anchors: arrays, numbers and plain containers, unpickled in a child process."""

from pathlib import Path
from typing import Any

from benchmark.errors import InputError
from benchmark.untrusted.children import taken_apart
from benchmark.untrusted.limits import PICKLE, Limits


def read_pickle(path: Path, limits: Limits = PICKLE) -> Any:
    """Read a pickle of arrays and plain containers without trusting it.

    Args:
        path: The file.
        limits: How large and deep it may be, and what reading it may cost.

    Returns:
        Its value.

    Raises:
        InputError: If the file is absent or broken, asks for anything that is not on the allow-list (the message names
            what it asked for), or is more than the limits allow.
    """
    answer = taken_apart(path, "pickle", limits)
    if answer.kind == "value":
        return answer.parts[0]
    if answer.kind == "refused":
        raise InputError(
            f"{path} is refused: its pickle asks for {answer.parts[0]}, which is not among the arrays and containers "
            "that a recording needs and could run code; do not open this file, get the recording from a source you "
            "trust"
        )
    reason = ": ".join(answer.parts)
    raise InputError(f"{path} is not a readable pickle ({reason}); it may be truncated, fetch it again")
