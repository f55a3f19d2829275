"""Tracks of encounters in golden sets."""

import numpy as np

from benchmark.errors import InputError
from benchmark.interactions.tracks import STEP_S, Tracks
from benchmark.verification.golden import GoldenArrays


class TrackArrays(GoldenArrays):
    """Arrays of one file with the tracks of encounters."""

    def encounter(self, name: str, category: str) -> Tracks:
        """The two tracks of an encounter, 10 Hz.

        Args:
            name: Of the encounter.
            category: Of the other.

        Returns:
            The tracks.

        Raises:
            InputError: If they are not there.
        """
        ego = self.floats(f"{name}/ego", None, 5)
        if len(ego) < 2:
            raise InputError(f"{self.path}: {name} has fewer than two frames; get the set again")
        other, valid = self.floats(f"{name}/other", len(ego), 5), self.verdicts(f"{name}/valid", len(ego))
        return Tracks(STEP_S * np.arange(len(ego)), ego, other[None], valid[None], (category,))
