"""The matrix that abilities are estimated from: an outcome of each planner in each scene, or none."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats

Outcome = Literal["contact", "score", "ordered"]
"""``contact``: 1 is safe, 0 is not; ``score``: 0 to 1; ``ordered``: categories 0, 1, ... from worst to best."""
FEWEST_PLANNERS: Final = 4
FEWEST_RECORDINGS: Final = 5
"""Below either there is no fit: means with intervals say all that can be said."""


@dataclass(frozen=True)
class OutcomeMatrix:
    """Outcomes of S planners in N scenes made from R recordings.

    Attributes:
        outcome: What a cell holds.
        planners: S names.
        scenes: N names.
        recordings: N recordings, of each scene.
        values: (S, N), higher is better, NaN where a planner did not run a scene.
    """

    outcome: Outcome
    planners: tuple[str, ...]
    scenes: tuple[str, ...]
    recordings: tuple[str, ...]
    values: Floats

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.planners), len(self.scenes)) or len(self.recordings) != len(self.scenes):
            raise ValueError(
                f"{self.values.shape} outcomes of {len(self.planners)} planners, {len(self.scenes)} scenes"
            )
        known = self.values[self.known]
        whole = self.outcome == "score" or np.array_equal(known, np.round(known))
        if not whole or (known < 0).any() or (self.outcome != "ordered" and (known > 1).any()):
            raise ValueError(f"an outcome is no {self.outcome}")

    @cached_property
    def known(self) -> Bools:
        """(S, N) cells that have an outcome."""
        return ~np.isnan(self.values)

    @property
    def missing(self) -> int:
        """Cells without an outcome."""
        return int((~self.known).sum())

    @cached_property
    def places(self) -> tuple[tuple[str, ...], "np.ndarray[tuple[int], np.dtype[np.int64]]"]:
        """R recordings by name, and (N,) which of them each scene was made from."""
        names = sorted(set(self.recordings))
        place = {name: number for number, name in enumerate(names)}
        return tuple(names), np.array([place[name] for name in self.recordings], np.int64)

    @property
    def shares_recordings(self) -> bool:
        """Whether some recording has two scenes: then a planner may do well or badly on a recording as such."""
        return len(set(self.recordings)) < len(self.recordings)

    @cached_property
    def passed(self) -> tuple[Floats, Floats]:
        """(N,) how many planners pass a scene, and how many ran it; a score passes above 0."""
        known = self.known
        best = 0.0 if self.outcome != "ordered" else float(np.nanmax(self.values)) - 0.5
        return (known & (np.nan_to_num(self.values, nan=-1.0) > best)).sum(axis=0), known.sum(axis=0)

    def require_enough(self) -> None:
        """Raise `InputError` where no joint fit is worth its name."""
        reasons = []
        if len(self.planners) < FEWEST_PLANNERS:
            reasons.append(f"{len(self.planners)} of the {FEWEST_PLANNERS} planners that it needs")
        if (count := len(set(self.recordings))) < FEWEST_RECORDINGS:
            reasons.append(f"{count} of the {FEWEST_RECORDINGS} recordings that it needs")
        if reasons:
            raise InputError(
                f"there is no fit of abilities: there are {' and '.join(reasons)}; run further ones, or read ranks "
                "with intervals in the table that challenger-bench leaderboard writes"
            )
