"""Reading a package of a split: every file is checked before anything is written."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.errors import InputError
from benchmark.machine.extension import AbsentExtensionError
from benchmark.machine.storage import write_bytes
from benchmark.records.review import ReviewFile
from benchmark.records.store import validate_stored
from benchmark.untrusted.compressed import read_package
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.text_files import parse_json
from generation.splits.format import FORMAT as SPLIT_FORMAT
from generation.splits.format import SCHEMA as SPLIT_SCHEMA
from generation.splits.format import FrozenSplit
from generation.splits.packaged import NamedSplit
from generation.splits.packing import (
    FORMAT,
    MANIFEST,
    SCHEMA,
    VERDICTS_FILE,
    PackageManifest,
    format_split_path,
    validate_package_rules,
)


@dataclass(frozen=True, slots=True)
class SplitPackage:
    """A package that was found whole; ``left_out`` has a sentence for each file whose extension is not installed."""

    path: Path
    manifest: PackageManifest
    splits: tuple[NamedSplit, ...]
    review: ReviewFile | None
    files: Mapping[str, bytes]
    left_out: tuple[str, ...] = ()

    def split(self, name: str | None) -> NamedSplit:
        """One of its splits; ``None`` is the only one, if there is one alone."""
        names = [packed.name for packed in self.splits]
        if name is None and len(names) == 1:
            return self.splits[0]
        if name not in names:
            problem = f"has no split {name!r}" if name is not None else "has several splits"
            raise InputError(f"{self.path} {problem}; choose one of {', '.join(names)} with --split")
        return self.splits[names.index(name)]


def read_split_package(path: Path) -> SplitPackage:
    """Read and check a package.

    Args:
        path: The file.

    Returns:
        It.

    Raises:
        InputError: If it is no package, a file of it is missing, unknown or has other bytes than the manifest says, or
            does not hold what it must.
    """
    members = read_package(path)
    manifest = _read_manifest(path, members.pop(MANIFEST, None))
    missing, unknown = sorted(manifest.files.keys() - members), sorted(members.keys() - manifest.files)
    if missing or unknown:
        problem = f"lacks {missing[0]}" if missing else f"holds {unknown[0]}, which is not in its manifest"
        raise InputError(f"{path} {problem}; it is damaged, fetch it again")
    left_out = []
    for name, file in manifest.files.items():
        data = members[name]
        if len(data) != file.bytes or hashlib.sha256(data).hexdigest() != file.sha256:
            raise InputError(f"{path}: {name} does not match the manifest (its hash differs); fetch the package again")
        try:
            _require_form(path, name, file.kind, data)
        except AbsentExtensionError as absent:
            left_out.append(f"{path}: {name} is left out: {absent}")
            del members[name]
    splits = []
    for packed in manifest.splits:
        frozen = _read_frozen(path, packed.name, members[format_split_path(packed.name)])
        facts = (frozen.content_id, len(frozen.scenes), frozen.recordings.name, frozen.recordings.fingerprint)
        if facts != (packed.content, packed.scenes, packed.recordings, packed.fingerprint):
            raise InputError(f"{path}: the split {packed.name} is not the one named in the manifest; fetch it again")
        splits.append(NamedSplit(packed.name, frozen))
    review = None
    if VERDICTS_FILE in members:
        review = validate_stored(
            ReviewFile.model_validate,
            _read_json(path, VERDICTS_FILE, members[VERDICTS_FILE]),
            _build_damage_formatter(path, VERDICTS_FILE),
        )
    return SplitPackage(path, manifest, tuple(splits), review, members, tuple(left_out))


def write_package_files(package: SplitPackage, to: Path) -> tuple[Path, ...]:
    """Write the files of a package, its manifest too, below a folder; what is there stays.

    Raises:
        InputError: If a file is there with other content, or cannot be written; of the first nothing is written.
    """
    manifest = read_package(package.path)[MANIFEST]
    targets = {to / name: data for name, data in {MANIFEST: manifest, **package.files}.items()}
    for path, data in targets.items():
        if path.exists() and (not path.is_file() or path.read_bytes() != data):
            raise InputError(f"{path} exists with other content; choose another folder with --to")
    for path, data in targets.items():
        write_bytes(path, data)
    return tuple(targets)


def _read_manifest(path: Path, data: bytes | None) -> PackageManifest:
    stored = None if data is None else _read_json(path, MANIFEST, data)
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        raise InputError(
            f"{path} is not a split package: it has no {MANIFEST} of format {FORMAT!r}; make one with data pack"
        )
    if type(stored.get("schema")) is not int or stored["schema"] != SCHEMA:
        raise InputError(
            f"{path} has version {to_one_line(stored.get('schema'), 40)} of the format, but this version reads "
            f"{SCHEMA}; upgrade challenger-bench"
        )
    return validate_stored(PackageManifest.model_validate, stored, _build_damage_formatter(path, MANIFEST))


def _read_frozen(path: Path, name: str, data: bytes) -> FrozenSplit:
    stored = _read_json(path, format_split_path(name), data)
    if not isinstance(stored, dict) or stored.get("format") != SPLIT_FORMAT or stored.get("schema") != SPLIT_SCHEMA:
        raise InputError(
            f"{path}: {format_split_path(name)} is not a frozen split that this version can read; upgrade "
            "challenger-bench"
        )
    return validate_stored(
        FrozenSplit.model_validate_json, data, _build_damage_formatter(path, format_split_path(name))
    )


def _require_form(path: Path, name: str, kind: str, data: bytes) -> None:
    if kind == "rules":
        validate_package_rules(data, f"{path}: {name}")
    elif not isinstance(_read_json(path, name, data), dict):
        raise InputError(f"{path}: {name} must be a JSON object; fetch the package again")


def _read_json(path: Path, name: str, data: bytes) -> Any:
    try:
        return parse_json(data)
    except ValueError as error:
        raise InputError(f"{path}: {name} is not JSON ({to_one_line(error, 80)}); fetch the package again") from error


def _build_damage_formatter(path: Path, name: str) -> Any:
    return lambda where, why: (
        f"{path}: {name} is damaged ({where or 'as a whole'}: {to_one_line(why, 120)}); fetch it again"
    )
