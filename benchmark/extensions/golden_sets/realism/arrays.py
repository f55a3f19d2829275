"""Arrays of realism's golden files."""

import numpy as np

from benchmark.errors import InputError
from benchmark.fairness.features import Integers
from benchmark.geometry import Floats
from benchmark.interactions.tracks import Tracks
from benchmark.verification.golden import GoldenArrays


class RealismArrays(GoldenArrays):
    """Arrays of one file."""

    def gappy(self, name: str, *shape: int | None) -> Floats:
        """Numbers with NaN where something is absent; arguments and errors as in `floats`."""
        array = np.asarray(self._taken(name, "f", "numbers", shape), np.float64)
        if np.isinf(array).any():
            raise InputError(f"array {name} in {self.path} has infinity in it; fetch or make the file again")
        return array

    def scene(self) -> tuple[Tracks, Integers]:
        """The recording that a file is: everybody, and the indices of the keyframes.

        Raises:
            InputError: If it is none.
        """
        seconds = self.floats("seconds", None)
        frames = len(seconds)
        keyframes = self.integers("keyframes", None)
        if frames < 2 or (np.diff(seconds) <= 0).any():
            raise InputError(f"{self.path}: its times do not rise; fetch or make the file again")
        rise = bool((np.diff(keyframes) > 0).all())
        if not len(keyframes) or not rise or keyframes[0] < 0 or keyframes[-1] >= frames:
            raise InputError(f"{self.path}: its keyframes are no rising frames; fetch or make the file again")
        agents = self.floats("agents", None, frames, 5)
        names = self._taken("categories", "U", "names", (len(agents),))
        tracks = Tracks(
            seconds=seconds,
            ego=self.floats("ego", frames, 5),
            agents=agents,
            valid=self.verdicts("valid", len(agents), frames),
            categories=tuple(str(name) for name in names),
        )
        return tracks, keyframes
