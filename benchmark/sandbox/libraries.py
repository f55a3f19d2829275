"""Libraries of a planner's process compute and draw as they do in the process of the command.

There everything computes with one thread and every scene seeds PyTorch, which is loaded before the first one. Here it
is loaded when the planner asks for it, perhaps in the middle of a scene: loading takes seconds, and many do without.
"""

import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final

ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment of a process whose libraries compute with one thread, once they are loaded."""
_TORCH: Final = "torch"


def one_thread() -> None:
    """Make the libraries that are loaded compute with one thread, whatever the planner told them."""
    if _TORCH in sys.modules:
        sys.modules[_TORCH].set_num_threads(1)
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")


def on_import_of_torch(seed: int) -> None:
    """Seed PyTorch when it is imported, if it is not there yet; the last seed counts."""
    if _TORCH not in sys.modules:
        sys.meta_path[:] = [each for each in sys.meta_path if not isinstance(each, _Finder)]
        sys.meta_path.insert(0, _Finder(seed))


class _Finder:
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
