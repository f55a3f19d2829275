"""Golden info files: roots as archives of their tables, and what the official converters wrote for them.

The set's form is that of ``golden/info_files``: a manifest says which root each file was made from and how the root is
to be had. Its program that makes odd roots of ordinary ones is run only if it is the one known here, byte for byte.
"""

import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, Self

from benchmark.errors import InputError
from benchmark.extensions.infos.repositories import REPOSITORIES, RepositoryName
from benchmark.machine.storage import file_sha256
from benchmark.untrusted.compressed import read_compressed_pickle, unpack_archive
from benchmark.untrusted.files import one_line, read_file
from benchmark.untrusted.limits import PROGRAM
from benchmark.verification.golden import GoldenFolder

MANIFEST: Final = "manifest.json"
_ODD: Final = "make_odd.py"
_ODD_SHA256: Final = "4c47273b5acc593454cf60b25121388e358de834c286dd3e4ecedf99dc84dbfd"
_ARCHIVE: Final = re.compile(r"tables/[\w.-]+\.tar\.xz")
_OF_ANOTHER: Final = re.compile(r"those of ([\w.-]+?)\b")
_SEED: Final = re.compile(r"make_odd\.py \S+ \S+ (\d+)")
_LONGEST_RUN_S: Final = 120.0

Tolerances = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class GoldenFile:
    """One file of a converter, a compressed pickle.

    Attributes:
        official_name: What the converter called it.
        counts: Number of infos of its train and val file.
        left_out: Keys that were taken out of its infos to save room.
    """

    repository: RepositoryName
    path: Path
    official_name: str
    counts: Mapping[str, int]
    left_out: frozenset[str]

    def read(self) -> dict[str, Any]:
        """Its content."""
        found: dict[str, Any] = read_compressed_pickle(self.path)
        if not all(isinstance(info, dict) for info in found["infos"]):
            raise ValueError(f"{self.path.name} holds no list of infos")
        return found


@dataclass(frozen=True, slots=True)
class GoldenRoot:
    """A root that files were made from.

    Attributes:
        tables: How its tables are to be had, in the words of the manifest.
        sha256: Of its tables, by name.
    """

    version: str
    tables: str
    recipe: str
    sha256: Mapping[str, str]
    files: tuple[GoldenFile, ...]

    def changed_tables(self, root: Path) -> dict[str, bool]:
        """Which tables of a root differ from those that the files were made from, by name."""
        folder = root / self.version
        return {name: file_sha256(folder / f"{name}.json") != value for name, value in self.sha256.items()}


@dataclass(frozen=True, slots=True)
class GoldenInfos:
    """A golden set: roots by name, tolerances by repository and keys."""

    folder: Path
    tolerances: Tolerances
    roots: Mapping[str, GoldenRoot]

    @classmethod
    def read(cls, golden: GoldenFolder) -> Self:
        """The set of a folder, as its manifest says."""
        manifest = golden.facts(MANIFEST)
        tolerances = {str(name): dict(found) for name, found in manifest["tolerance"].items()}
        roots = {str(name): _root(golden.path, row) for name, row in manifest["roots"].items()}
        if not roots:
            raise ValueError(f"{MANIFEST} names no roots")
        return cls(golden.path, tolerances, roots)

    def unpack(self, name: str, folder: Path) -> Path:
        """Make a root from the set; one that is there already is taken as it is."""
        root = folder / name
        if root.exists():
            return root
        here = self.folder / "tables" / name
        if here.is_dir():
            return here
        words = self.roots[name].tables
        other, archive = _OF_ANOTHER.search(words), _ARCHIVE.match(words)
        if archive is not None:
            unpack_archive(self.folder / archive[0], folder)
            if not root.is_dir():
                raise ValueError(f"{archive[0]} holds no folder {name}")
            if other is not None and not (root / "maps").exists():
                (root / "maps").symlink_to((self.unpack(other[1], folder) / "maps").resolve())
            return root
        seed = _SEED.search(self.roots[name].recipe)
        if other is None or seed is None:
            raise ValueError(f"{MANIFEST} does not say where the tables of {name} are")
        self._make_odd(self.unpack(other[1], folder), root, seed[1])
        return root

    def _make_odd(self, source: Path, root: Path, seed: str) -> None:
        path = self.folder / _ODD
        program = read_file(path, PROGRAM)
        if sha256(program).hexdigest() != _ODD_SHA256:
            raise InputError(
                f"{path} is not the program that is known here and is not run; look at it, run it yourself, and put "
                f"what it makes into {self.folder / 'tables' / root.name}"
            )
        command = [sys.executable, "-I", "-", str(source.resolve()), str(root.resolve()), seed]
        try:
            subprocess.run(
                command, input=program, capture_output=True, check=True, timeout=_LONGEST_RUN_S, cwd=root.parent
            )
        except (subprocess.SubprocessError, OSError) as error:
            raise InputError(
                f"{path} fails on the tables of {source.name} ({one_line(error)}); fetch the set again"
            ) from error


def _root(golden: Path, row: Mapping[str, Any]) -> GoldenRoot:
    files = tuple(
        GoldenFile(
            repository=REPOSITORIES[name].name,
            path=golden / _inside(found["path"]),
            official_name=str(found["official_name"]),
            counts={str(part): int(count) for part, count in found["infos_in"].items()},
            left_out=frozenset(map(str, found["left_out"])),
        )
        for name, found in row["files"].items()
    )
    hashes = {_inside(name): str(value) for name, value in row["fingerprint"]["sha256"].items()}
    return GoldenRoot(_inside(row["version"]), str(row["tables"]), str(row["recipe"]), hashes, files)


def _inside(name: Any) -> str:
    """A path below a folder; raises `ValueError` for any other."""
    path = Path(str(name))
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"{name} leads out of the set")
    return str(name)
