"""What a planner in a process of its own may cost, and the times after which nobody waits any longer."""

import math
from dataclasses import dataclass
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.untrusted.limits import GIB

SAMPLE_S: Final = 120.0
"""For one plan; as long as a drive waits, too."""
LONGEST_S: Final = 86_400.0
LOADING_S: Final = 300.0
SAMPLES_PER_LOADING: Final = 10.0
"""A planner that needs long for a plan needs long to load, too."""
SILENCE_S: Final = 60.0
"""Without one heartbeat: the process is stopped, or hangs in code that never returns to Python."""
BEAT_S: Final = 0.5
GRACE_S: Final = 1.0
"""To end by itself when nobody needs it any more."""
REAPING_S: Final = 10.0
"""For what was killed to be gone: the kernel may have to free gigabytes."""
MOST_PICTURE_BYTES: Final = 8 * GIB
"""Of pictures that a planner keeps."""
LEAST_MEMORY_GIB: Final = 0.1
MOST_MEMORY_GIB: Final = 65_536.0


@dataclass(frozen=True, slots=True)
class Supervision:
    """How a planner in a process of its own is watched over.

    Attributes:
        sample_s: How long ``reset``, ``reveal`` and a plan may take each; reading pictures for it does not count.
        memory_bytes: Of data that the process may hold, or ``None``.
        loading_s: How long importing and building it may take; by default `LOADING_S`, or ten samples if that is more.
        silence_s: So long may it give no sign of life.
    """

    sample_s: float = SAMPLE_S
    memory_bytes: int | None = None
    loading_s: float | None = None
    silence_s: float = SILENCE_S

    @classmethod
    def of(cls, sample_limit: float | None, memory_limit: float | None) -> "Supervision":
        """The limits that options name.

        Args:
            sample_limit: ``--sample-limit``, seconds.
            memory_limit: ``--memory-limit``, GiB.

        Returns:
            They.

        Raises:
            InputError: If one is no such number.
        """
        sample_s = SAMPLE_S if sample_limit is None else sample_limit
        if not 0.0 < sample_s <= LONGEST_S:
            raise InputError(f"--sample-limit must be more than 0 and at most {LONGEST_S:g} seconds, got {sample_s:g}")
        if memory_limit is None:
            return cls(sample_s)
        if not LEAST_MEMORY_GIB <= memory_limit <= MOST_MEMORY_GIB:
            raise InputError(
                f"--memory-limit must be {LEAST_MEMORY_GIB:g} to {MOST_MEMORY_GIB:g} GiB, got {memory_limit:g}"
            )
        return cls(sample_s, math.ceil(memory_limit * GIB))

    @property
    def longest_loading_s(self) -> float:
        """How long importing and building it may take."""
        return max(LOADING_S, SAMPLES_PER_LOADING * self.sample_s) if self.loading_s is None else self.loading_s

    def said(self) -> dict[str, Any]:
        """What a record says of it."""
        return {"sample_limit_s": self.sample_s, "memory_limit_bytes": self.memory_bytes}
