"""Encounters in golden sets: their tracks, and what hangs on the last bit."""

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.verification.golden_sets import GoldenArrays

SAME_TIME_S: Final = 1e-9


def read_interaction(stored: GoldenArrays, facts: Mapping[str, Any]) -> ContinuousTracks:
    """The two tracks of an encounter, 10 Hz, which facts name."""
    name = facts["name"]
    ego = stored.floats(f"{name}/ego", None, 5)
    other, valid = stored.floats(f"{name}/other", len(ego), 5), stored.verdicts(f"{name}/valid", len(ego))
    return ContinuousTracks(STEP_S * np.arange(len(ego)), ego, other[None], valid[None], (facts["category"],))


def is_fragile(facts: Mapping[str, Any], *names: str) -> bool:
    """Whether a value is marked as one that changes when its inputs move a little, and so is to be left out.

    ``is_fragile`` of the facts is true, or a list that has one of the names in it, alone or at the end of a path; no
    names ask for all of the facts.
    """
    marked = facts.get("fragile", False)
    return marked if isinstance(marked, bool) else any(re.split(r"[/.: ]", mark)[-1] in names for mark in marked)


def differ(ours: float | None, golden: float | None) -> bool:
    """Whether two times differ; absent ones are the same."""
    return ours is not golden if ours is None or golden is None else abs(ours - golden) > SAME_TIME_S
