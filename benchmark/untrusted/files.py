"""A foreign file before it is read, what one of each kind may be and may cost, and kinds of refusals."""

import os
import stat
from dataclasses import dataclass, replace
from io import BufferedReader
from pathlib import Path
from typing import Final, Literal, get_args

from benchmark.errors import InputError

Category = Literal[
    "truncated", "empty", "unknown", "no_plan", "class", "nesting", "size", "trailing", "shape", "not_finite", "token",
    "duplicate", "count", "order", "unit", "offsets", "time", "frame", "origin",
]  # fmt: skip
"""Why a file of results is refused."""
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)


class RefusedFileError(InputError):
    """Refusal of a result file, with its category in one word."""

    def __init__(self, category: Category, sentence: str) -> None:
        super().__init__(sentence)
        self.category: Category = category


MIB: Final = 1 << 20
GIB: Final = 1 << 30


@dataclass(frozen=True, slots=True)
class Limits:
    """Upper limits of an untrusted file of one kind.

    Attributes:
        what: The kind, in words that fit after "a".
        depth: Containers within containers.
        values: Values, entries or rows, each counted as often as it is named.
        line_bytes: Bytes of one line, where there are lines.
        content_bytes: What it unpacks to.
        memory_bytes: Of the child process that takes it apart, as are ``cpu_s`` and ``clock_s``.
    """

    what: str
    file_bytes: int
    depth: int = 64
    values: int = 4_000_000
    name_characters: int = 4096
    line_bytes: int = 16 * MIB
    content_bytes: int = GIB
    memory_bytes: int = 3 * GIB // 2
    cpu_s: int = 8
    clock_s: float = 15.0


PICKLE: Final = Limits("pickle", 256 * MIB)
"""ScenarioNet files and published anchors; real ones have some megabytes."""
COMPRESSED_PICKLE: Final = replace(PICKLE, what="compressed pickle", content_bytes=256 * MIB)
ARCHIVE: Final = Limits("archive of tables", 256 * MIB, values=10_000)
"""Golden roots: tables, CAN bus and maps, some megabytes; values are files."""
PROGRAM: Final = Limits("program", MIB)
CHECKPOINT: Final = Limits("checkpoint", 16 * GIB, values=1_000_000, content_bytes=256 * MIB)
"""PyTorch files; the largest that is read here has 5 GB. Their content is what stands beside the numbers."""
LIBRARY_CHECKPOINT: Final = replace(CHECKPOINT, file_bytes=64 * GIB)
"""For files read by third-party libraries: the prompt encoder has 45 GB in one file."""
SAFETENSORS: Final = Limits("weights file", 64 * GIB, values=1_000_000, content_bytes=64 * MIB)
"""Content is the header."""
NPZ: Final = Limits("file of arrays", 4 * GIB, values=10_000, content_bytes=8 * GIB)
JSON: Final = Limits("JSON file", 512 * MIB, values=12_000_000, line_bytes=64 * MIB)
"""Maps, CAN bus, manifests, small tables: the largest map of nuScenes has 40 MB and 4 million values."""
TABLE: Final = replace(JSON, what="table", file_bytes=4 * GIB, values=150_000_000)
"""Tables that are read whole by their check; those of nuScenes have up to 2 GB."""
CACHED_ARRAYS: Final = Limits("file of kept arrays", 4 * GIB)
"""Of the user's own cache: where the rows of tables are, 120 MB for nuScenes trainval."""
RECORD: Final = Limits("record", 512 * MIB, values=60_000_000)
"""Run records, manifests and lists of a submission."""
PLANS: Final = Limits("plan file", 256 * MIB, values=1_000_000, line_bytes=64 * 1024, name_characters=256)
"""One row a sample: all of nuScenes has 34,149."""
RESULTS: Final = Limits("result file", 8 * GIB, values=8_000_000, memory_bytes=GIB)
"""Files that planners' repositories write: plans, boxes, maps and forecasts of up to 34,149 samples. What reading may
cost grows with the file (`scale_limits`)."""
ANSWER: Final = Limits("answer of a planner", 64 * 1024, values=10_000)
"""One text file of a folder of results."""
PLANNER_ANSWER: Final = Limits(
    "answer of a planner's process", 64 * MIB, depth=16, values=4_000_000, content_bytes=64 * MIB
)
"""A plan with its modes and forecasts, or what was raised; some kilobytes."""
RESULT_FILES: Final = 40_000
"""Files of a folder of results, one a sample."""
PLAN_COLUMNS: Final = 64
VERDICTS: Final = Limits("file of verdicts", 64 * MIB, depth=8, values=1_000_000, line_bytes=64 * 1024)
"""One a scene, with a reason of a few words; all of nuScenes has 1,000 scenes."""
PACKAGE: Final = Limits("package of a split", 256 * MIB, values=1000, name_characters=200, content_bytes=256 * MIB)
"""Frozen splits have some kilobytes a scene; values are files."""
SETTINGS: Final = Limits("file of settings", 256 * 1024)
"""TOML and YAML that people write: rules of a challenge have a page, scenarios of NeuroNCAP half of one."""
PICTURE: Final = Limits("picture", 256 * MIB, values=64_000_000)
"""Values are pixels: cameras have 1.4 to 12 million."""
HTTP_REQUEST: Final = Limits("request", 64 * MIB, depth=8, values=10_000)
"""Bodies that a simulator posts: six pictures of 1600 x 900 as plain numbers in base64 have 34.6 MB; values beside the
pictures are some two hundred."""
HTTP_ANSWER: Final = Limits("answer over HTTP", 64 * MIB, depth=8, values=4_000_000)
"""Plans with objects, forecasts and, of some models, a view from above; or a renderer's actors and pictures."""
HTTP_PICTURE: Final = Limits("picture over HTTP", 48 * MIB, values=16_000_000)
"""Values are pixels; six of them are in memory together."""
GRPC_MESSAGE: Final = Limits("message over gRPC", 4 * MIB, depth=16, values=100_000)
"""Of a simulator or a policy: 8 s of poses every 0.01 s, six times, have 60,000 fields."""
GRPC_PICTURE: Final = replace(GRPC_MESSAGE, what="message with a picture", file_bytes=16 * MIB)
"""A PNG of 1600 x 900 has 2 to 4 MB."""
GRPC_SESSION: Final = replace(GRPC_MESSAGE, what="start of a session", file_bytes=64 * MIB, values=4_000_000)
"""Tracks of all road users of a recording: 300 of them for 20 s have 700,000 fields."""
RECORDING_S: Final = 3600.0
"""Seconds of one imported recording, for any step."""
RECORDED_OBJECTS: Final = 5000
RECORDED_POSES: Final = 4_000_000
"""Its objects times its frames; a crowded scene of nuScenes has 60,000."""
MAP_POINTS: Final = 500_000
"""Of its map; real ones have 20,000."""
MAP_LANES: Final = 4000
MAP_LINKS: Final = 200_000
MAP_MEETINGS: Final = 2_000_000
"""Pairs of pieces of its lines that come near each other: what it costs to join its surfaces."""
EXPANSION: Final = 4
"""How many times its own size a checkpoint's tensors may claim, since tensors may share what is stored."""


_MOST_MORE_BYTES: Final = 16 * GIB


def scale_limits(limits: Limits, size: int) -> Limits:
    """Limits in proportion to a file of `size` bytes, so that reading a small one never costs much."""
    more_s = size // (8 * MIB)
    return replace(
        limits,
        memory_bytes=limits.memory_bytes + min(12 * size, _MOST_MORE_BYTES),
        cpu_s=limits.cpu_s + more_s,
        clock_s=limits.clock_s + 3 * more_s,
    )


def format_bytes(count: int) -> str:
    """Human-readable number of bytes."""
    for unit, size in (("GB", GIB), ("MB", MIB), ("KB", 1024)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count} bytes"


def open_file(path: Path, limits: Limits) -> BufferedReader:
    """Open an untrusted file at its beginning.

    Raises `InputError` if it is absent, no ordinary file, named in bytes that are no text, or too long for its kind.
    """
    require_name(path)
    try:
        # Without waiting: opening a named pipe would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        kind = "Is a directory" if stat.S_ISDIR(status.st_mode) else "it is not a regular file"
        raise InputError(f"cannot read {path}: {kind}")
    if status.st_size > limits.file_bytes:
        os.close(descriptor)
        raise InputError(
            f"{path} has {format_bytes(status.st_size)}, but a {limits.what} has at most "
            f"{format_bytes(limits.file_bytes)}; it is damaged or another kind of file, get it again"
        )
    return os.fdopen(descriptor, "rb")


def read_file(path: Path, limits: Limits) -> bytes:
    """The bytes of a foreign file; arguments and errors as in `open_file`."""
    try:
        with open_file(path, limits) as stream:
            return stream.read()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except MemoryError:
        raise InputError(f"{path} does not fit into the memory of this machine; it is damaged, get it again") from None


def require_name(path: Path) -> None:
    """Refuse a path that could be neither printed nor recorded."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError(f"the file name {str(path)!r} is not UTF-8 text; rename the file") from None


def to_one_line(text: object, longest: int = 160) -> str:
    """Text of an untrusted file or its reader, fit for a message: one line, printable, at most `longest` characters."""
    first = (str(text).splitlines() or [""])[0]
    printable = "".join(letter if letter.isprintable() else "?" for letter in first[: longest + 1])
    return printable if len(printable) <= longest else f"{printable[:longest]}..."
