"""What is tested of the whole product: with an extension missing such tests are skipped, or leave out what is its."""

from importlib.util import find_spec

import pytest

import benchmark
from benchmark.machine.extension import OFFERS

_NAMED = (
    *(reference for offered in OFFERS.values() for reference in offered.values()),
    *vars(benchmark)["_PLACES"].values(),
)


def is_installed(reference: str) -> bool:
    """Whether what a reference, ``module:attribute``, leads to is of the core or of an extension that is installed."""
    parts = reference.partition(":")[0].split(".")
    if len(parts) < 3 or parts[1] != "extensions":
        return True
    try:
        return find_spec(".".join(parts[:3])) is not None
    except ModuleNotFoundError:
        return False


ABSENT = sorted({".".join(reference.split(".")[:3]) for reference in _NAMED if not is_installed(reference)})
"""Extensions that the core names and that are not installed, as ``package.extensions.name``."""
ABSENT_COMMANDS = tuple(words for words, reference in OFFERS["command"].items() if not is_installed(reference))
"""Words of their commands and groups of commands."""
REASON = f"of the whole product, and not installed: {', '.join(ABSENT)}"
needs_extensions = pytest.mark.skipif(bool(ABSENT), reason=REASON)


def command_is_installed(line: str) -> bool:
    """Whether a command line, without ``challenger-bench``, is of the core or of an extension that is installed."""
    return not any(line == words or line.startswith(f"{words} ") for words in ABSENT_COMMANDS)
