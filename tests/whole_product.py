"""Tests of the whole product are skipped where an extension is not installed."""

from importlib.util import find_spec

import pytest

from benchmark.machine.extension import OFFERS


def installed(package: str) -> bool:
    """Whether an extension, ``package.extensions.name``, can be imported."""
    try:
        return find_spec(package) is not None
    except ModuleNotFoundError:
        return False


_OFFERING = {".".join(reference.split(".")[:3]) for offered in OFFERS.values() for reference in offered.values()}
ABSENT = sorted(package for package in _OFFERING if not installed(package))
"""Extensions that the table names and that are not installed."""
REASON = f"of the whole product, and not installed: {', '.join(ABSENT)}"
needs_extensions = pytest.mark.skipif(bool(ABSENT), reason=REASON)
