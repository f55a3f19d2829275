"""What is attacked: which file of which kind, and the command that reads it."""

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bench.attacking.children import CommandOutcome
from bench.attacking.table import TABLE, arguments
from tests.adapters.result_files.broken_files import HOSTILE, Broken
from tests.benchmark.datasets.hostile_tables import HOSTILE_ROOTS
from tests.benchmark.untrusted import variants
from tests.benchmark.untrusted.hostile_recordings import RECORDINGS

Change = Callable[[Path, Path], None]
"""Given the copied input and the attacked file in it."""
Numbers = Callable[[CommandOutcome, Path], str]
"""What a command found, to be compared: of how it ended and the folder that it wrote to."""


@dataclass(frozen=True, slots=True)
class NamedVariant:
    """A variant that somebody thought of.

    Attributes:
        name: Says what is wrong.
        change: Makes it.
        may_be_valid: Whether it may be read as well as refused, with other numbers.
    """

    name: str
    change: Change
    may_be_valid: bool = False


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of input, read by a command.

    Attributes:
        kind: Row of the table.
        command: What is attacked in it, in a word or two; unique within the kind.
        arguments: Of the command line; ``{in}`` is the copied input, ``{valid}`` the folder of valid files, ``{out}``
            the folder to write to.
        copied: The file or folder that is copied for each variant, by its name among the valid files.
        form: One of `mutations.FORMS`.
        numbers: What is compared where the command ends well.
        files: Patterns of the attacked files in it, if it is a folder.
        named: Variants that somebody thought of.
        lists_faults: Whether exit code 1 with a list of faults is an answer, as of ``data check`` and ``verify``.
        other_files: Whether another content of one file is no fault that could be seen: pictures, for example.
        keeps_work: Whether a file is read when its turn comes, and what was done before it stays.
        rewrites: Whether it is the command's work to replace what it read, as of ``rescore``.
    """

    kind: str
    command: str
    arguments: tuple[str, ...]
    copied: str
    form: str
    numbers: Numbers
    files: tuple[str, ...] = ()
    named: tuple[NamedVariant, ...] = ()
    lists_faults: bool = False
    other_files: bool = False
    keeps_work: bool = False
    rewrites: bool = False

    @property
    def name(self) -> str:
        """Kind and command."""
        return f"{self.kind}: {self.command}"


def replace_content(file: Path, content: bytes) -> None:
    """Write a file anew."""
    file.unlink()
    file.write_bytes(content)


def _byte_variants(*found: variants.Variant) -> tuple[NamedVariant, ...]:
    def made(variant: variants.Variant) -> Change:
        return lambda _, file: replace_content(file, variant.change(file.read_bytes()))

    return tuple(NamedVariant(item.name, made(item), item.harmless) for item in found)


def _broken_variant(broken: Broken) -> NamedVariant:
    """A file that is broken whatever the valid one holds."""

    def change(_: Path, file: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            replace_content(file, broken.make(Path(folder)).read_bytes())

    return NamedVariant(broken.name, change)


def _sparse_variants(size: int) -> tuple[NamedVariant, ...]:
    def change(_: Path, file: Path) -> None:
        file.unlink()
        variants.write_sparse(file, size)

    def after(_: Path, file: Path) -> None:
        with file.open("r+b") as stream:
            stream.truncate(size)

    description = f"{size >> 30} GB of nothing"
    return NamedVariant(description, change), NamedVariant(f"{description} behind the content", after)


def _root_variants(*readable: str) -> tuple[NamedVariant, ...]:
    """Roots with a small change; those of some names may be read."""
    return tuple(
        NamedVariant(root_change.name, lambda root, _, act=root_change.damage: act(root), root_change.name in readable)  # type: ignore[misc]
        for root_change in HOSTILE_ROOTS
    )


NAMED: Final[dict[str, tuple[NamedVariant, ...]]] = {
    "sparse": (*_sparse_variants(20 << 30), *_sparse_variants(3 << 30)),
    "roots": _root_variants(),
    "roots that are looked at": _root_variants("1 Hz", "10 Hz"),
    "checkpoints": _byte_variants(*variants.CHECKPOINTS),
    "pickles": _byte_variants(*variants.PICKLES),
    "headers": _byte_variants(*variants.SAFETENSORS),
    "json": _byte_variants(*variants.JSONS),
    "json plans": _byte_variants(*variants.JSON_PLANS),
    "plans": _byte_variants(*variants.PLANS),
    "recordings": _byte_variants(*RECORDINGS),
    "result files": tuple(map(_broken_variant, HOSTILE)),
}


def _without_places(value: Any) -> Any:
    """JSON without what only says where something lies, or of which bytes it is the hash."""
    if isinstance(value, dict):
        left_out = ("directory", "path", "root", "source_sha256", "fingerprint", "says")
        return {key: _without_places(held) for key, held in value.items() if key not in left_out}
    return [_without_places(held) for held in value] if isinstance(value, list) else value


def _printed_json(ended: CommandOutcome, _: Path) -> str:
    return json.dumps(_without_places(json.loads(ended.out)), sort_keys=True)


def _printed(ended: CommandOutcome, folder: Path) -> str:
    """Standard output, but for the place of the case."""
    return ended.out.replace(str(folder.parent), "")


def _verdicts(_: CommandOutcome, folder: Path) -> str:
    """What a challenge says of an entry, but for hashes of what was given."""
    contents = [json.loads(path.read_text()) for path in sorted(folder.glob("challenge/*/verdict.json"))]
    return json.dumps([_without_places(content) for content in contents], sort_keys=True)


def _reviewed(_: CommandOutcome, folder: Path) -> str:
    """The verdicts that stand beside the root."""
    return (folder.parent / "reviewed" / "root" / "review.json").read_text()


NUMBERS: Final[dict[str, Numbers]] = {
    "json": _printed_json,
    "printed": _printed,
    "verdicts": _verdicts,
    "review": _reviewed,
}


def _read_written(patterns: list[str]) -> Numbers:
    """The files of some patterns below the output."""

    def numbers(_: CommandOutcome, folder: Path) -> str:
        digest = hashlib.sha256()
        for path in sorted({path for pattern in patterns for path in folder.glob(pattern)}):
            digest.update(f"{path.relative_to(folder)} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
        return digest.hexdigest()

    return numbers


def _targets() -> Iterator[Target]:
    for shared in TABLE["target"]:
        for own in shared.pop("by", [{}]):
            members = shared | ({"command": own} if isinstance(own, str) else own)
            if "line" not in members:
                members = TABLE["of_root"][members["command"]] | members
            numbers = members.pop("numbers", "json")
            yield Target(
                arguments=arguments(members.pop("line")),
                numbers=NUMBERS[numbers] if isinstance(numbers, str) else _read_written(numbers),
                files=tuple(members.pop("files", ())),
                named=tuple(variant for group in members.pop("named", ()) for variant in NAMED[group]),
                **members,
            )


TARGETS: Final = tuple(_targets())
