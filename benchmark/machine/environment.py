"""Environment of a run: metadata for run records, and checks that this machine computes correctly."""

import importlib.metadata
import importlib.util
import platform
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.report.words import pluralise

PACKAGES = (
    "challenger-bench",
    "numpy",
    "torch",
    "nuscenes-devkit",
    "shapely",
    "opencv-python-headless",
    "pandas",
    "safetensors",
)
OLDEST_NUMPY = (1, 24)
_MIN_FREE_BYTES = 2 * 10**9


@dataclass(frozen=True, slots=True)
class MachineCheck:
    """One finding of ``challenger-bench doctor``; the sentence says what to do if it is not fine."""

    name: str
    ok: bool
    sentence: str


def read_package_versions() -> dict[str, str | None]:
    """Versions of the packages that numbers depend on, and of Python; ``None`` where one is not installed."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    return versions


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@cache
def read_device_name(gpu: bool) -> str:
    """Name of what networks run on: this process' GPU, or the machine's processor."""
    if gpu:
        import torch

        return torch.cuda.get_device_name()
    return _cpu_model()


@cache
def read_source_state() -> dict[str, Any]:
    """Commit of this project's source and whether it was changed since; both ``None`` outside a git checkout."""
    root = Path(__file__).resolve().parents[2]
    unknown: dict[str, Any] = {"commit": None, "dirty": None}
    if not (root / ".git").exists() or shutil.which("git") is None:
        return unknown
    git = ["git", "--no-optional-locks", "-C", str(root)]
    commit = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    status = subprocess.run([*git, "status", "--porcelain"], capture_output=True, text=True, check=False)
    if commit.returncode != 0 or status.returncode != 0:
        return unknown
    return {"commit": commit.stdout.strip(), "dirty": bool(status.stdout.strip())}


def read_machine_metadata() -> dict[str, Any]:
    """Environment fields of a run record; nothing that changes between two runs on the same machine."""
    return {"packages": read_package_versions(), "hardware": {"cpu": _cpu_model()}, "source": read_source_state()}


def checks(folder: Path) -> list[MachineCheck]:
    """Everything that ``challenger-bench doctor`` looks at.

    Args:
        folder: Where output will be written; its disk is measured.

    Returns:
        Findings, in a fixed order.
    """
    return [
        _numpy_version(),
        _linear_algebra(),
        _threads(),
        _importable("nuscenes", "nuscenes-devkit", "data sets cannot be read"),
        _importable("cv2", "opencv-python-headless", "images cannot be read or drawn"),
        _importable("shapely", "shapely", "maps cannot be read"),
        _disk_space(folder),
    ]


def _linear_algebra() -> MachineCheck:
    """Solve, multiply and decompose matrices whose answers are known in closed form.

    NumPy 1.23 with some OpenBLAS builds returns wrong inverses and products on recent server processors without any
    error; such numbers must never reach a table.
    """
    size = 64
    index = np.arange(1, size + 1)
    # Second-difference matrix: the normal equations of a minimum-acceleration tracker have this shape.
    matrix = 2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)
    inverse = np.minimum.outer(index, index) * (size + 1 - np.maximum.outer(index, index)) / (size + 1)
    eigenvalues = 2 - 2 * np.cos(index * np.pi / (size + 1))
    counting = np.outer(index, index)
    errors = {
        "inverse": np.abs(np.linalg.inv(matrix) - inverse).max() / inverse.max(),
        "solve": np.abs(np.linalg.solve(matrix, matrix @ index.astype(float)) - index).max() / size,
        "eigenvalues": np.abs(np.linalg.eigvalsh(matrix) - eigenvalues).max(),
        "singular values": np.abs(np.linalg.svd(matrix, compute_uv=False)[::-1] - eigenvalues).max(),
        "product": float(np.abs(counting.astype(float) @ counting.astype(float) - counting @ counting).max()),
    }
    worst = max(errors, key=lambda name: errors[name])
    if errors[worst] < 1e-9:
        return MachineCheck("linear algebra", True, f"matrix results are accurate to {errors[worst]:.0e}")
    return MachineCheck(
        "linear algebra",
        False,
        f"NumPy's {worst} is wrong by {errors[worst]:.1e} on this processor; install another NumPy build "
        "(pip install --force-reinstall 'numpy>=1.26,<3') before using any results",
    )


def _numpy_version() -> MachineCheck:
    version = tuple(int(part) for part in np.__version__.split(".")[:2])
    if version >= OLDEST_NUMPY:
        return MachineCheck("numpy", True, f"NumPy {np.__version__}")
    return MachineCheck(
        "numpy",
        False,
        f"NumPy {np.__version__} has builds that compute wrong matrix products on recent processors; "
        "install a newer one (pip install 'numpy>=1.26,<3')",
    )


def _threads() -> MachineCheck:
    import torch

    return MachineCheck(
        "torch", True, f"PyTorch {torch.__version__}, {pluralise(torch.get_num_threads(), 'thread')} until work starts"
    )


def _importable(module: str, distribution: str, consequence: str) -> MachineCheck:
    if importlib.util.find_spec(module) is not None:
        return MachineCheck(distribution, True, f"{distribution} {importlib.metadata.version(distribution)}")
    return MachineCheck(distribution, False, f"{distribution} is missing, so {consequence}; pip install {distribution}")


def _disk_space(folder: Path) -> MachineCheck:
    existing = next(place for place in (folder, *folder.resolve().parents) if place.exists())
    free = shutil.disk_usage(existing).free
    sentence = f"{free / 1e9:.1f} GB free for {folder}"
    if free < _MIN_FREE_BYTES:
        return MachineCheck(
            "disk", False, f"{sentence}; generated data sets need a few GB; choose another location with --out"
        )
    return MachineCheck("disk", True, sentence)
