"""A split as one file that a paper can attach: frozen splits and what belongs to them, and no recording."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator

from benchmark.constants import VERSION
from benchmark.datasets.roots import DataSet
from benchmark.datasets.statistics import statistics
from benchmark.errors import InputError
from benchmark.fairness.split_assessment import find_adversarial_names, judge_split
from benchmark.machine.extension import import_from_extension
from benchmark.machine.storage import canonical_json, content_key, write_bytes
from benchmark.machine.workers import Executor
from benchmark.records.drives import DriveRecord
from benchmark.records.review import REVIEW_FILE, ReviewFile, read_review
from benchmark.records.review import SCHEMA as REVIEW_SCHEMA
from benchmark.records.stored import Stored
from benchmark.untrusted.compressed import encode_package
from benchmark.untrusted.files import SETTINGS, read_file, to_one_line
from generation.splits.packaged import NamedSplit

FORMAT: Final = "challenger-bench split package"
SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
RULES_MEMBER: Final = "rules/rules.toml"
VERDICTS_FILE: Final = f"verdicts/{REVIEW_FILE}"
STATISTICS_FILE: Final = "statistics/split.json"
_PLAIN: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")
_DRIVE_SETTINGS: Final = (
    "planner", "split", "scenes_in_split", "frozen_split", "review", "generated", "status", "seed", "measured", "runs",
    "scoring",
)  # fmt: skip
"""Fields of a drive record that define how it was driven; machines, folders and results are left out."""

Kind = Literal["split", "verdicts", "statistics", "drive", "rules"]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class PackedFile(Stored):
    """One file of a package: what it is, how many bytes it has, and their SHA-256.

    Attributes:
        kind: What it is.
        bytes: Its size.
        sha256: Of its bytes.
    """

    kind: Kind
    bytes: Annotated[int, Field(ge=0)]
    sha256: Hash


class PackedSplit(Stored):
    """One frozen split of a package, by `FrozenSplit.content_id`, with name and content hash of its recordings.

    Attributes:
        name: Of the split.
        content: Hash of the frozen split.
        scenes: How many it has.
        recordings: Name of the data set that it was made from.
        fingerprint: Content hash of that data set.
    """

    name: Annotated[str, Field(pattern=_PLAIN.pattern, max_length=200)]
    content: Hash
    scenes: Annotated[int, Field(ge=1)]
    recordings: str
    fingerprint: str


class PackageManifest(Stored):
    """``manifest.json``, the first file of a package; ``files`` are all the others.

    Attributes:
        format: Marks the file.
        schema_version: Version of the format.
        made_with: Version of challenger-bench.
        splits: Frozen splits.
    """

    format: Literal["challenger-bench split package"] = FORMAT
    schema_version: Annotated[int, Field(alias="schema")] = SCHEMA
    made_with: Annotated[str, Field(max_length=100)] = VERSION
    splits: Annotated[tuple[PackedSplit, ...], Field(min_length=1)]
    files: dict[str, PackedFile]

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        split_files = {name for name, file in self.files.items() if file.kind == "split"}
        if split_files != {format_split_path(split.name) for split in self.splits}:
            raise ValueError("its splits do not match its files")
        return self


@dataclass(frozen=True, slots=True)
class PackageContents:
    """Contents of a package.

    Attributes:
        splits: Frozen splits.
        root: A data set that was built from them, whose verdicts and statistics go along.
        drives: Records of drives whose settings go along.
        rules: A file of rules.
    """

    splits: tuple[NamedSplit, ...]
    root: DataSet | None = None
    drives: tuple[DriveRecord, ...] = field(default=())
    rules: Path | None = None


@dataclass(frozen=True, slots=True)
class WrittenPackage:
    """A written package: its path, its SHA-256, and what it says of itself."""

    path: Path
    sha256: str
    manifest: PackageManifest


def format_split_path(name: str) -> str:
    """Path of a frozen split in a package."""
    return f"splits/{name}.json"


def pack_split(path: Path, contents: PackageContents, executor: Executor) -> WrittenPackage:
    """Write a package; the same contents give the same bytes.

    Args:
        path: The file. One that is there is never replaced by another package.
        contents: Contents of the package.
        executor: Where scenes are judged for the statistics that are not judged yet.

    Returns:
        Summary of the written package.

    Raises:
        InputError: If splits have one name or none that a file can have, the root or a record is of another split, the
            rules are none, or the file holds something else or cannot be written.
    """
    _require_names(contents.splits)
    members: dict[str, tuple[Kind, bytes]] = {
        format_split_path(split.name): ("split", split.frozen.text().encode()) for split in contents.splits
    }
    if contents.root is not None:
        members |= _collect_root_files(contents.root, contents.splits, executor)
    members |= dict(_encode_drive(record, contents.splits) for record in contents.drives)
    if contents.rules is not None:
        members[RULES_MEMBER] = (
            "rules",
            validate_package_rules(read_file(contents.rules, SETTINGS), str(contents.rules)),
        )
    manifest = PackageManifest(
        splits=tuple(_describe_split(split) for split in contents.splits),
        files={name: _describe_file(kind, data) for name, (kind, data) in sorted(members.items())},
    )
    manifest_bytes = (canonical_json(manifest.model_dump(mode="json", by_alias=True), indent=1) + "\n").encode()
    data = encode_package({MANIFEST: manifest_bytes} | {name: data for name, (_, data) in sorted(members.items())})
    _require_free(path, data)
    write_bytes(path, data)
    return WrittenPackage(path, hashlib.sha256(data).hexdigest(), manifest)


def validate_package_rules(data: bytes, where: str) -> bytes:
    """A file of rules that the extension of challenges can read; arguments and errors as of its own function."""
    checked: bytes = import_from_extension("package", "rules")(data, where)
    return checked


def _require_names(splits: Sequence[NamedSplit]) -> None:
    names = [split.name for split in splits]
    for name in names:
        if not _PLAIN.fullmatch(name) or names.count(name) > 1:
            why = "is listed twice" if names.count(name) > 1 else "is not a plain file name"
            raise InputError(f"the frozen split {to_one_line(name, 80)} {why}; rename its file")


def _require_free(path: Path, data: bytes) -> None:
    if path.exists() and (not path.is_file() or path.stat().st_size != len(data) or path.read_bytes() != data):
        raise InputError(f"{path} exists with other content; name another file with --to")


def _describe_split(split: NamedSplit) -> PackedSplit:
    frozen = split.frozen
    return PackedSplit(
        name=split.name,
        content=frozen.content_id,
        scenes=len(frozen.scenes),
        recordings=frozen.recordings.name,
        fingerprint=frozen.recordings.fingerprint,
    )


def _describe_file(kind: Kind, data: bytes) -> PackedFile:
    return PackedFile(kind=kind, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def _encode_json(value: Any) -> bytes:
    return (canonical_json(value, indent=1) + "\n").encode()


def _collect_root_files(
    root: DataSet, splits: Sequence[NamedSplit], executor: Executor
) -> dict[str, tuple[Kind, bytes]]:
    known = {scene.name for split in splits for scene in split.frozen.scenes}
    names = root.scene_names(None)
    # In variant roots scenes are named after their recordings.
    strangers = [name for name in names if "/" not in name and name not in known]
    built_from = ((root.provenance() or {}).get("frozen") or {}).get("content")
    contents = {split.frozen.content_id for split in splits}
    if strangers or (built_from is not None and built_from not in contents) or not find_adversarial_names(root, names):
        odd = f"it has the scene {strangers[0]}" if strangers else "it was made from something else"
        raise InputError(f"{root.root} was not built from the packed frozen splits: {odd}; name the right --root")
    members: dict[str, tuple[Kind, bytes]] = {}
    verdicts = read_review(root.root)
    if verdicts:
        stored = ReviewFile(schema=REVIEW_SCHEMA, verdicts=verdicts)
        members[VERDICTS_FILE] = ("verdicts", _encode_json(stored.model_dump(mode="json", by_alias=True)))
    counted = statistics(root.root, version=root.version)
    judged = judge_split(root, find_adversarial_names(root, names), executor)
    summary = {
        **counted.model_dump(mode="json", exclude={"root"}),
        "judgement": judged.model_dump(mode="json"),
    }
    members[STATISTICS_FILE] = ("statistics", _encode_json(summary))
    return members


def _encode_drive(record: DriveRecord, splits: Sequence[NamedSplit]) -> tuple[str, tuple[Kind, bytes]]:
    known = {scene.name for split in splits for scene in split.frozen.scenes}
    inner = {name.rpartition("/")[2] for name in record.facts.scenes}
    if record.facts.frozen_split not in {split.name for split in splits} and not inner <= known:
        raise InputError(
            f"{record.directory} drives scenes that are not in the packed splits, such as "
            f"{to_one_line(sorted(inner - known)[0], 80)}; leave it out of --drives"
        )
    facts = record.facts.model_dump(mode="json", by_alias=True)
    settings = {name: facts[name] for name in _DRIVE_SETTINGS}
    planner = re.sub(r"[^A-Za-z0-9._+-]", "_", record.planner).lstrip("._+-") or "planner"
    return f"drives/{planner[:100]}-{content_key(settings)[:12]}.json", ("drive", _encode_json(settings))
