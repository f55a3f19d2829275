"""The child process: takes one foreign file apart within limits and answers with plain values and arrays.

It imports numpy and nothing heavier, reads the file from its standard input, writes the answer to its standard output,
and ends with its parent. What it says when it fails becomes the parent's sentence (`children.py`).
"""

import contextlib
import ctypes
import os
import resource
import signal
import sys
import zipfile
from collections.abc import Callable
from typing import Any, BinaryIO, Final

from benchmark.machine.extension import import_reference
from benchmark.untrusted.answers import UnencodableValueError, write_answer
from benchmark.untrusted.checkpoint_structure import read_checkpoint_structure
from benchmark.untrusted.files import CHECKPOINT, GIB, PICKLE, PLAN_COLUMNS, PLANS, RESULTS, Limits, to_one_line
from benchmark.untrusted.legacy_storages import AllowListUnpickler, DisallowedNameError
from benchmark.untrusted.result_values import read_result_value


def read_parquet_columns(stream: BinaryIO, limits: Limits) -> dict[str, Any]:
    """Numbers as arrays and texts as lists, by column, as pandas has them: missing numbers are NaN."""
    from pyarrow import parquet

    file = parquet.ParquetFile(stream)
    declared = file.metadata
    if declared.num_rows > limits.values or declared.num_columns > PLAN_COLUMNS:
        raise UnencodableValueError(f"it has {declared.num_rows} rows and {declared.num_columns} columns")
    groups = [declared.row_group(number) for number in range(declared.num_row_groups)]
    if sum(group.total_byte_size for group in groups) > limits.content_bytes:
        raise UnencodableValueError(f"it unpacks to more than {limits.content_bytes} bytes")
    table = file.read(use_threads=False)
    columns = {}
    for name in table.column_names:
        values = table.column(name).to_numpy()
        columns[name] = values.tolist() if values.dtype.kind == "O" else values
    return columns


_DIE_WITH_PARENT: Final = 1
"""``PR_SET_PDEATHSIG`` of Linux."""


def read_value(stream: BinaryIO, limits: Limits) -> Any:
    """The value of a pickle."""
    return AllowListUnpickler(stream).load()


KINDS: Final[dict[str, tuple[Callable[[BinaryIO, Limits], Any], Limits]]] = {
    "pickle": (read_value, PICKLE),
    "checkpoint": (read_checkpoint_structure, CHECKPOINT),
    "parquet": (read_parquet_columns, PLANS),
    "results": (read_result_value, RESULTS),
}
"""Kinds of files that the child can read; extensions name a function of theirs, ``module:function``."""


def apply_limits(limits: Limits, parent: int) -> None:
    """Limit this process for good; it ends with the process `parent` that waits for it."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    for resource_kind, most in (
        (resource.RLIMIT_AS, limits.memory_bytes),
        (resource.RLIMIT_CPU, limits.cpu_s),
        (resource.RLIMIT_FSIZE, limits.content_bytes + GIB),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(resource_kind)[1]
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        # Some systems do not limit memory; the limits on wall and processor time still hold.
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource_kind, (least, least))


def read_request(kind: str, limits: Limits, stream: BinaryIO, *request: str) -> tuple[Any, ...]:
    """Read the file as one of `KINDS`: ``("value", V)``, or what was wrong; ``request`` says what of it is wanted.

    That is ``("refused", NAME)``, ``("unanswerable", WHY)``, ``("memory",)``, ``("archive", WHY)`` or
    ``("broken", TYPE, MESSAGE)``.
    """
    try:
        read = KINDS[kind][0] if kind in KINDS else import_reference(kind)
        return "value", read(stream, limits, *request)
    except DisallowedNameError as refused:
        return "refused", to_one_line(refused)
    except UnencodableValueError as why:
        return "unanswerable", to_one_line(why)
    except MemoryError:
        return ("memory",)
    except zipfile.BadZipFile as error:
        return "archive", to_one_line(error)
    # A malformed stream may raise anything, from EOFError to numpy's errors on a damaged array.
    except Exception as error:
        return "broken", type(error).__name__, to_one_line(error)


def main() -> None:
    """Answer the parent; ends the process without giving anything back, which could take as long as reading did."""
    kind, parent, *numbers = sys.argv[2:10]
    depth, values, name_characters, content_bytes, memory_bytes, cpu_s = map(int, numbers)
    given = Limits(
        kind,
        content_bytes,
        depth=depth,
        values=values,
        name_characters=name_characters,
        content_bytes=content_bytes,
        memory_bytes=memory_bytes,
        cpu_s=cpu_s,
    )
    apply_limits(given, int(parent))
    parts = read_request(kind, given, os.fdopen(0, "rb"), *sys.argv[10:])
    out = os.fdopen(1, "wb")
    try:
        write_answer(out, parts, given)
        out.flush()
    # Writing may fail on any value, for example on a whole number of a million digits.
    except Exception as why:
        del parts
        out.seek(0)
        out.truncate()
        write_answer(out, ("memory",) if isinstance(why, MemoryError) else ("unanswerable", to_one_line(why)), given)
        out.flush()
    os._exit(0)
