"""What is attacked: which file of which kind, and the command that reads it."""

import hashlib
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bench.attacking.children import Ended
from bench.attacking.valid import SEARCH
from tests.adapters.result_files.broken_files import HOSTILE, Broken
from tests.benchmark.datasets.hostile_tables import HOSTILE_ROOTS
from tests.benchmark.datasets.nuscenes_tables import VERSION
from tests.benchmark.untrusted import variants
from tests.benchmark.untrusted.hostile_recordings import RECORDINGS

Change = Callable[[Path, Path], None]
"""Given the copied input and the attacked file in it."""


@dataclass(frozen=True, slots=True)
class Named:
    """A variant that somebody thought of.

    Attributes:
        name: Says what is wrong.
        change: Makes it.
        may_be_valid: Whether it may be read as well as refused, with other numbers.
    """

    name: str
    change: Change
    may_be_valid: bool = False


Numbers = Callable[[Ended, Path], str]
"""What a command found, to be compared: of how it ended and the folder that it wrote to."""


def _without_places(value: Any) -> Any:
    """JSON without what only says where something lies, or of which bytes it is the hash."""
    if isinstance(value, dict):
        left_out = ("directory", "path", "root", "source_sha256", "fingerprint", "says")
        return {key: _without_places(held) for key, held in value.items() if key not in left_out}
    return [_without_places(held) for held in value] if isinstance(value, list) else value


def printed_json(ended: Ended, _: Path) -> str:
    """The JSON on standard output."""
    return json.dumps(_without_places(json.loads(ended.out)), sort_keys=True)


def printed(ended: Ended, folder: Path) -> str:
    """Standard output, but for the place of the case."""
    return ended.out.replace(str(folder.parent), "")


def written(*patterns: str) -> Numbers:
    """The files of some patterns below the output."""

    def numbers(_: Ended, folder: Path) -> str:
        digest = hashlib.sha256()
        for path in sorted({path for pattern in patterns for path in folder.glob(pattern)}):
            digest.update(f"{path.relative_to(folder)} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
        return digest.hexdigest()

    return numbers


@dataclass(frozen=True, slots=True)
class Target:
    """A kind of input, read by a command.

    Attributes:
        kind: Row of the table.
        command: What is attacked in it, in a word or two; unique within the kind.
        arguments: Of the command line; ``{in}`` is the copied input, ``{valid}`` the folder of valid files, ``{out}``
            the folder to write to.
        copied: The file or folder that is copied for each variant, by its name among the valid files.
        files: Patterns of the attacked files in it, if it is a folder.
        form: One of `mutations.FORMS`.
        numbers: What is compared where the command ends well.
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
    named: tuple[Named, ...] = ()
    lists_faults: bool = False
    other_files: bool = False
    keeps_work: bool = False
    rewrites: bool = False

    @property
    def name(self) -> str:
        """Kind and command."""
        return f"{self.kind}: {self.command}"


def _of_bytes(found: tuple[variants.Variant, ...]) -> tuple[Named, ...]:
    def made(variant: variants.Variant) -> Change:
        return lambda _, file: replaced(file, variant.change(file.read_bytes()))

    return tuple(Named(each.name, made(each), each.harmless) for each in found)


def replaced(file: Path, content: bytes) -> None:
    """Write a file anew."""
    file.unlink()
    file.write_bytes(content)


def _made_elsewhere(broken: Broken) -> Named:
    """A file that is broken whatever the valid one holds."""

    def change(_: Path, file: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            replaced(file, broken.make(Path(folder)).read_bytes())

    return Named(broken.name, change)


def _sparse(size: int) -> tuple[Named, ...]:
    def change(_: Path, file: Path) -> None:
        file.unlink()
        variants.write_sparse(file, size)

    def after(_: Path, file: Path) -> None:
        with file.open("r+b") as stream:
            stream.truncate(size)

    return (
        Named(f"{size >> 30} GB of nothing", change),
        Named(f"{size >> 30} GB of nothing behind the content", after),
    )


SPARSE: Final = (*_sparse(20 << 30), *_sparse(3 << 30))
ROOTS: Final = tuple(
    Named(each.name, lambda root, _, act=each.damage: act(root))  # type: ignore[misc]
    for each in HOSTILE_ROOTS
)
_RATES: Final = ("1 Hz", "10 Hz")
_LOOKED_AT: Final = tuple(each if each.name not in _RATES else Named(each.name, each.change, True) for each in ROOTS)
_TABLES: Final = tuple(
    f"{VERSION}/{table}.json"
    for table in ("sample", "sample_data", "sample_annotation", "ego_pose", "scene", "calibrated_sensor", "[!sec]*")
)
_OUT: Final = ("--out", "{out}", "--workers", "1")
_EVAL: Final = ("eval", *_OUT, "--json")
_MODEL: Final = ("--model", "constant-velocity")
_READ: Final = ("--data", "{valid}/root")
_GENERATE: Final = ("generate", *_OUT)
_ROOT_COMMANDS: Final[dict[str, tuple[tuple[str, ...], Numbers]]] = {
    "eval": ((*_EVAL, "--data", "{in}", *_MODEL), printed_json),
    "generate": ((*_GENERATE, "--data", "{in}", *SEARCH), written("data/*/*/v*/sample_annotation.json")),
    "data show": (("data", "show", "{in}", "--to", "{out}", "--workers", "1"), written("*.png")),
    "sheets": (("sheets", *_OUT, "--data", "{in}"), written("**/*.jsonl", "**/*.png", "**/*.jpg")),
    "data check": (("data", "check", "{in}"), printed),
}
_FILM: Final = ("--format", "png", "--fps", "1", "--until", "3", "--width", "320", "--layout", "birdseye")


def _reviewed(_: Ended, folder: Path) -> str:
    """The verdicts that stand beside the root."""
    return (folder.parent / "reviewed" / "root" / "review.json").read_text()


_GENERATED_COMMANDS: Final[dict[str, tuple[tuple[str, ...], Numbers]]] = {
    "eval": ((*_EVAL, "--data", "{in}", "--split", "adv", *_MODEL), printed_json),
    "data stats": (("data", "stats", "{in}", "--workers", "1"), printed),
    "data show": _ROOT_COMMANDS["data show"],
    "data check": _ROOT_COMMANDS["data check"],
}


def _root(kind: str, command: str, *files: str, form: str = "json", named: tuple[Named, ...] = ()) -> Target:
    arguments, numbers = _ROOT_COMMANDS[command]
    checks = command == "data check"
    return Target(
        kind, command, arguments, "root", form, numbers, files, named, checks, form == "bytes", form == "bytes"
    )


def _file(kind: str, command: str, name: str, form: str, arguments: tuple[str, ...], **said: Any) -> Target:
    return Target(kind, command, arguments, name, form, said.pop("numbers", printed_json), **said)


_RECORD_FILES: Final = ("**/run.json", "**/samples.jsonl", "**/summary.json")
_IMPORT: Final = ("weights", "import", "--json")
_CHECKPOINTS: Final = (*_of_bytes(variants.CHECKPOINTS), *SPARSE)
_PICKLES: Final = (*_of_bytes(variants.PICKLES), *SPARSE)
_HEADERS: Final = (*_of_bytes(variants.SAFETENSORS), *SPARSE)
_WEIGHTS: Final = (
    _file("checkpoints", "weights import", "tensors.pth", "archive", (*_IMPORT, "{in}"), named=_CHECKPOINTS),
    _file("checkpoints", "weights import, old form", "old.pth", "bytes", (*_IMPORT, "{in}"), named=SPARSE),
    _file(
        "anchors",
        "weights import --anchors",
        "anchors.pkl",
        "pickle",
        (*_IMPORT, "{valid}/tensors.pth", "--anchors", "{in}"),
        named=_PICKLES,
    ),
    _file(
        "weights of planners",
        "eval --checkpoint",
        "planner.safetensors",
        "tensors",
        (*_EVAL, *_READ, "--model", "ego-status", "--checkpoint", "{in}"),
        named=_HEADERS,
    ),
    _file(
        "weights of planners",
        "eval --checkpoint of a network",
        "network.safetensors",
        "tensors",
        (*_EVAL, *_READ, "--model", "vad-mini", "--checkpoint", "{in}"),
        named=_HEADERS,
    ),
    _file(
        "weights of the denoiser",
        "generate --denoiser",
        "denoiser.safetensors",
        "tensors",
        (*_GENERATE, *_READ, *SEARCH, "--denoiser", "{in}"),
        numbers=written("data/*/*/v*/sample_annotation.json"),
        named=_HEADERS,
        # The search draws from the file's hash, too: the same weights in another order of bytes make other adversaries.
        other_files=True,
    ),
    _file(
        "weights of the denoiser",
        "generate --denoiser, a checkpoint",
        "denoiser.ckpt",
        "archive",
        (*_GENERATE, *_READ, *SEARCH, "--denoiser", "{in}"),
        named=_CHECKPOINTS,
    ),
)
_RESULTS: Final = ("--results", "{in}", "--name", "theirs")
_RESULT_FILES: Final = tuple(_made_elsewhere(each) for each in HOSTILE)
_FILES: Final = (
    _file(
        "ScenarioNet files",
        "data import scenarionet",
        "recordings",
        "pickle",
        ("data", "import", "scenarionet", "{in}", *_OUT, "--renderer", "none"),
        files=("*.pkl",),
        numbers=written("v*/sample_annotation.json", "v*/ego_pose.json"),
        named=(*_of_bytes(RECORDINGS), *_PICKLES),
    ),
    _file(
        "plan files",
        "eval --plans, CSV",
        "plans.csv",
        "csv",
        (*_EVAL, *_READ, "--plans", "{in}"),
        named=(*_of_bytes(variants.PLANS), *SPARSE),
    ),
    _file(
        "plan files",
        "eval --plans, JSON",
        "plans.json",
        "json",
        (*_EVAL, *_READ, "--plans", "{in}"),
        named=(*_of_bytes((*variants.JSON_PLANS, *variants.JSONS)), *SPARSE),
    ),
    *(
        _file(
            "result files",
            f"eval --results, {name}",
            name,
            form,
            (*_EVAL, *_READ, *_RESULTS),
            named=named,
            # Where samples are named, one less is a partial run: the others are judged, and it is said.
            other_files=form == "json",
        )
        for name, form, named in (
            ("uniad.pkl", "pickle", (*_RESULT_FILES, *SPARSE)),
            ("vad-out.pkl", "pickle", _PICKLES),
            ("opendrivevla.json", "json", (*_of_bytes(variants.JSONS), *SPARSE)),
        )
    ),
    _file(
        "frozen splits",
        "generate --from",
        "frozen.json",
        "json",
        (*_GENERATE, *_READ, "--renderer", "none", "--from", "{in}"),
        numbers=written("data/*/*/v*/sample_annotation.json"),
        named=(*_of_bytes(variants.JSONS), *SPARSE),
    ),
    *(
        _file(
            "golden sets",
            f"verify {what}",
            f"golden-{what}",
            "archive",
            ("verify", what, "--golden", "{in}"),
            numbers=printed,
            files=("*.npz",),
            named=SPARSE,
            lists_faults=True,
            other_files=True,
        )
        for what in ("physics", "denoiser")
    ),
)
_CHECK: Final = ("challenge", "check")
_CHALLENGE: Final = ("--base", "{valid}/root", "--out", "{out}", "--workers", "1", "--no-page")


def _verdicts(_: Ended, folder: Path) -> str:
    """What a challenge says of an entry, but for hashes of what was given."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("challenge/*/verdict.json"))]
    return json.dumps([_without_places(each) for each in found], sort_keys=True)


_EXCHANGED: Final = (
    _file(
        "packages",
        "data unpack",
        "package.zip",
        "package",
        ("data", "unpack", "{in}", "--to", "{out}"),
        numbers=written("**/*.*"),
        named=SPARSE,
        other_files=True,
    ),
    _file(
        "packages",
        "data unpack --data",
        "package.zip",
        "package",
        ("data", "unpack", "{in}", "--to", "{out}/un", *_READ, *_OUT, "--renderer", "none"),
        numbers=written("data/*/*/v*/sample_annotation.json"),
        named=SPARSE,
        other_files=True,
        # A package is checked as a whole; whether its split fits the recordings is seen when that is built.
        keeps_work=True,
    ),
    _file(
        "rules of challenges",
        "challenge check --rules",
        "rules.toml",
        "toml",
        (*_CHECK, "{valid}/generated", "--rules", "{in}", *_CHALLENGE),
        numbers=_verdicts,
        named=SPARSE,
        lists_faults=True,
        other_files=True,
    ),
    _file(
        "rules of challenges",
        "challenge rules",
        "rules.toml",
        "toml",
        ("challenge", "rules", "{in}"),
        numbers=printed,
        named=SPARSE,
        other_files=True,
    ),
    _file(
        "entries of challenges",
        "challenge check",
        "generated",
        "json",
        (*_CHECK, "{in}", "--rules", "{valid}/rules.toml", *_CHALLENGE),
        files=("v*/[!m]*.json", "v*/[!m]*.json", "maps/expansion/*.json", "can_bus/*.json"),
        numbers=_verdicts,
        named=(*_of_bytes(variants.JSONS), *SPARSE),
        lists_faults=True,
        # An entry says for itself what it is; what breaks no rule may be so.
        other_files=True,
    ),
    _file(
        "edited scenes",
        "generate --from FOLDER",
        "edited",
        "pickle",
        (*_GENERATE, *_READ, "--renderer", "none", "--from", "{in}"),
        files=("*.pkl",),
        numbers=written("data/*/*/v*/sample_annotation.json"),
        named=_PICKLES,
        # Another edit is another scene.
        other_files=True,
    ),
)
_RECORDS: Final = tuple(
    _file(
        kind,
        command,
        "records",
        form,
        arguments,
        files=files,
        numbers=numbers,
        named=(*_of_bytes(variants.JSONS), *SPARSE),
        lists_faults=kind == "submissions" or command.startswith("rescore"),
        rewrites=command.startswith("rescore"),
    )
    for form, files in (("json", _RECORD_FILES[::2]), ("jsonl", _RECORD_FILES[1:2]))
    for kind, command, arguments, numbers in (
        ("submissions", f"submit-check, {form}", ("leaderboard", "submit-check", "{in}", *_READ, *_OUT), printed),
        (
            "run records",
            f"leaderboard, {form}",
            ("leaderboard", "--records", "{in}", "--to", "{out}", "--no-site", "--out", "{out}"),
            written("**/*.csv", "**/*.json"),
        ),
        ("run records", f"rescore, {form}", ("rescore", "--records", "{in}", *_READ, *_OUT, "--json"), printed_json),
    )
)
_NEWER: Final = (
    *(
        _file(
            "verdict files",
            f"data review --verdicts, {form}",
            "reviewed",
            form,
            ("data", "review", "{in}/root", "--verdicts", f"{{in}}/said.{form}", *_OUT),
            files=(f"said.{form}",),
            numbers=_reviewed,
            named=(*(_of_bytes(variants.JSONS) if form == "json" else ()), *SPARSE),
            other_files=True,
            rewrites=True,
        )
        for form in ("csv", "json")
    ),
    _file(
        "verdict files",
        "eval of a root with review.json",
        "judged",
        "json",
        (*_EVAL, "--data", "{in}", *_MODEL),
        files=("review.json",),
        named=(*_of_bytes(variants.JSONS), *SPARSE),
        other_files=True,
    ),
    *(
        _file(
            "records of drives",
            f"{command}, {form}",
            "drives",
            form,
            arguments,
            files=files,
            numbers=numbers,
            named=(*_of_bytes(variants.JSONS), *SPARSE),
            lists_faults=command == "rescore",
            rewrites=command == "rescore",
        )
        for form, files in (("json", ("**/drive.json", "**/summary.json")), ("jsonl", ("**/drives.jsonl",)))
        for command, arguments, numbers in (
            (
                "leaderboard",
                ("leaderboard", "--records", "{in}", "--to", "{out}", "--no-site", "--out", "{out}"),
                written("**/*.csv", "**/*.json"),
            ),
            ("rescore", ("rescore", "--records", "{in}", *_READ, *_OUT, "--json"), printed_json),
        )
    ),
    *(
        _file(
            "sheets",
            f"film, {name}",
            "shown",
            form,
            ("film", *_READ, "--out", "{in}", "--split", "val", "--to", "{out}", *_FILM),
            files=(f"sheets/**/{name}",),
            numbers=written("**/*.png"),
            named=(*_of_bytes(variants.JSONS), *SPARSE),
            other_files=True,
            keeps_work=True,
        )
        for name, form in (("sheet.json", "json"), ("split.json", "json"))
    ),
)
TARGETS: Final[tuple[Target, ...]] = (
    *_WEIGHTS,
    *_FILES,
    *(
        _root("nuScenes roots", command, *_TABLES, named=_LOOKED_AT if command == "data show" else ROOTS)
        for command in _ROOT_COMMANDS
    ),
    *_RECORDS,
    *_NEWER,
    *_EXCHANGED,
    *(
        _root("pictures of roots", command, "samples/CAM_*/*.jpg", form="bytes", named=SPARSE)
        for command in ("data show", "sheets", "data check")
    ),
    _file(
        "pictures of roots",
        "eval",
        "root",
        "bytes",
        (*_EVAL, "--data", "{in}", "--model", "vad-mini"),
        files=("samples/CAM_*/*.jpg",),
        named=SPARSE,
        other_files=True,
        keeps_work=True,
    ),
    *(
        _file(
            "generated roots",
            command,
            "generated",
            "json",
            arguments,
            files=("v*/challenger.json", "v*/challenger.json", "v*/splits.json", "v*/[!c]*.json", "report.json"),
            numbers=numbers,
            named=_of_bytes(variants.JSONS),
            lists_faults=command == "data check",
        )
        for command, (arguments, numbers) in _GENERATED_COMMANDS.items()
    ),
    *(
        _root("maps of roots", command, "maps/expansion/*.json", named=_of_bytes(variants.JSONS))
        for command in ("eval", "generate", "data show", "data check")
    ),
    *(
        _root("CAN bus of roots", command, "can_bus/*.json", named=_of_bytes(variants.JSONS))
        for command in ("eval", "data check")
    ),
    *(
        _root("splits and provenance of roots", command, f"{VERSION}/splits.json", f"{VERSION}/challenger.json")
        for command in ("eval", "sheets", "data check")
    ),
)
