"""Limits of a planner in a subprocess, whose libraries compute and draw as in the process of the command."""

import importlib.util
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.untrusted.files import GIB

ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment of a process whose libraries compute with one thread, once they are loaded."""
_TORCH: Final = "torch"


def use_one_thread() -> None:
    """Make the libraries that are loaded compute with one thread, overriding the planner's settings."""
    if _TORCH in sys.modules:
        sys.modules[_TORCH].set_num_threads(1)
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")


def seed_torch_on_import(seed: int) -> None:
    """Seed PyTorch when it is imported, if it is not there yet; the last seed counts."""
    if _TORCH not in sys.modules:
        sys.meta_path[:] = [finder for finder in sys.meta_path if not isinstance(finder, _SeedingTorchFinder)]
        sys.meta_path.insert(0, _SeedingTorchFinder(seed))


class _SeedingTorchFinder:
    """Finds PyTorch as everybody does, and seeds it once it is loaded."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The usual specification, with a loader that does a little more."""
        if name != _TORCH:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            loader: Any = spec.loader
            seed, execute = self._seed, loader.exec_module

            def execute_and_seed(module: Any) -> None:
                execute(module)
                module.set_num_threads(1)
                module.manual_seed(seed)

            loader.exec_module = execute_and_seed
        return spec


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
"""Time for a process to exit by itself when it is no longer needed."""
REAPING_S: Final = 10.0
"""For what was killed to be gone: the kernel may have to free gigabytes."""
MOST_PICTURE_BYTES: Final = 8 * GIB
"""Of pictures that a planner keeps."""
LEAST_MEMORY_GIB: Final = 0.1
MOST_MEMORY_GIB: Final = 65_536.0


@dataclass(frozen=True, slots=True)
class SandboxLimits:
    """Limits of a planner's process.

    ``sample_s`` is for ``reset``, ``reveal`` and each plan, without the reading of its pictures; ``memory_bytes`` is
    data that the process may hold; ``loading_s`` is for import and construction, by default `LOADING_S` or ten samples
    if that is more; after ``silence_s`` without a sign of life the process is ended.
    """

    sample_s: float = SAMPLE_S
    memory_bytes: int | None = None
    loading_s: float | None = None
    silence_s: float = SILENCE_S

    @classmethod
    def of(cls, sample_limit: float | None, memory_limit: float | None) -> "SandboxLimits":
        """Limits of the options ``--sample-limit`` (seconds) and ``--memory-limit`` (GiB)."""
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
        """Fields of a record."""
        return {"sample_limit_s": self.sample_s, "memory_limit_bytes": self.memory_bytes}
