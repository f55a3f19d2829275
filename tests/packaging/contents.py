"""Compare what a built wheel holds with the tree that it was built from: ``python contents.py WHEEL SDIST``."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("adapters", "benchmark", "generation", "leaderboard")
BESIDE_THE_PACKAGES = ("LICENSE", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "Makefile", "constraints.txt")


def files_of_packages(root: Path = ROOT) -> set[str]:
    """Files of the four packages below a checkout or an unpacked source archive, as paths from its root."""
    tracked = subprocess.run(["git", "ls-files", "--", *PACKAGES], cwd=root, capture_output=True, text=True)
    if tracked.returncode == 0 and tracked.stdout:
        return {name for name in tracked.stdout.splitlines() if (root / name).exists()}
    found = (path for package in PACKAGES for path in (root / package).rglob("*") if path.is_file())
    return {path.relative_to(root).as_posix() for path in found if "__pycache__" not in path.parts}


def wheel_files(wheel: Path) -> set[str]:
    """What a wheel installs, without its own metadata."""
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def archive_files(sdist: Path) -> set[str]:
    """What a source archive holds, as paths below its one folder."""
    with tarfile.open(sdist) as archive:
        return {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}


def differences(wheel: Path, sdist: Path) -> list[str]:
    """One sentence for everything that the wheel or the source archive lacks or should not hold."""
    expected, packed, archived = files_of_packages(), wheel_files(wheel), archive_files(sdist)
    return [
        *(f"{wheel.name} lacks {name}" for name in sorted(expected - packed)),
        *(f"{wheel.name} holds {name}, which is not in the tree" for name in sorted(packed - expected)),
        *(f"{sdist.name} lacks {name}" for name in sorted((expected | set(BESIDE_THE_PACKAGES)) - archived)),
    ]


if __name__ == "__main__":
    built = [Path(argument) for argument in sys.argv[1:]]
    wrong = differences(*sorted(built, key=lambda path: path.suffix != ".whl"))
    print("\n".join(wrong) or "wheel and source archive hold the whole tree and nothing else")
    print("\n".join(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB" for path in built))
    sys.exit(1 if wrong else 0)
