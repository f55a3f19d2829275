"""Starting the child process that reads an untrusted file, and one sentence for each way it can fail."""

import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.untrusted.answers import read_answer
from benchmark.untrusted.files import PICKLE, Limits, format_bytes, open_file

_ROOT: Final = Path(__file__).resolve().parents[2]
_PROGRAM: Final = "import sys; sys.path.insert(0, sys.argv[1]); from benchmark.untrusted.child import main; main()"
_PASSED_ENVIRONMENT: Final = ("PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT", "TMPDIR", "LANG", "HOME")
_UNTRUSTED: Final = "it is damaged or malicious, get it from a source that you trust"


@dataclass(frozen=True, slots=True)
class ChildAnswer:
    """The child's result for a file that it handled within its limits, of one of four kinds.

    ``value`` has the value, ``refused`` the name asked for that is not on the allow-list, ``archive`` (a damaged zip
    archive) and ``broken`` what is wrong, in words.
    """

    kind: str
    parts: tuple[Any, ...]


def read_in_child(path: Path, kind: str, limits: Limits, *request: str) -> ChildAnswer:
    """Read an untrusted file as one of `benchmark.untrusted.child.KINDS` in a child process.

    ``request`` is for readers of extensions. Raises `InputError` if the file cannot be opened or is too large, or the
    child exceeds its limits or dies.
    """
    with open_file(path, limits) as stream, tempfile.TemporaryFile() as answer:
        code = _run(path, kind, limits, request, stream.fileno(), answer.fileno())
        if code < 0:
            raise InputError(_death(path, -code, limits))
        size = os.fstat(answer.fileno()).st_size
        # The output of a damaged child is untrusted as well, and may be anything.
        try:
            data = bytearray(size)
            answer.seek(0)
            answer.readinto(data)
            status, *parts = read_answer(data)
        except Exception as error:
            raise InputError(f"{path} broke the process that reads it (exit status {code}); {_UNTRUSTED}") from error
    if status == "memory":
        raise InputError(f"{path} takes more than {format_bytes(limits.memory_bytes)} of memory to read; {_UNTRUSTED}")
    if status == "unanswerable":
        raise InputError(f"{path} is refused: {parts[0]}; {_UNTRUSTED}")
    return ChildAnswer(status, tuple(parts))


def _run(path: Path, kind: str, limits: Limits, request: tuple[str, ...], source: int, target: int) -> int:
    numbers = (
        limits.depth,
        limits.values,
        limits.name_characters,
        limits.content_bytes,
        limits.memory_bytes,
        limits.cpu_s,
    )
    # Numpy's libraries reserve memory for every processor unless limited to one thread.
    environment = {name: os.environ[name] for name in _PASSED_ENVIRONMENT if name in os.environ}
    environment |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    command = [sys.executable, "-I", "-c", _PROGRAM, str(_ROOT), kind, str(os.getpid()), *map(str, numbers), *request]
    try:
        child = subprocess.Popen(
            command, stdin=source, stdout=target, stderr=subprocess.DEVNULL, env=environment, cwd="/"
        )
    except OSError as error:
        raise InputError(
            f"cannot start a process to read {path} in: {error.strerror or error}; close other programs, then try again"
        ) from error
    try:
        return child.wait(timeout=limits.clock_s)
    except subprocess.TimeoutExpired:
        return -signal.SIGXCPU
    finally:
        child.kill()
        child.wait()


def _death(path: Path, number: int, limits: Limits) -> str:
    if number == signal.SIGXCPU:
        return f"{path} takes longer than {limits.cpu_s} s to read as a {limits.what}; {_UNTRUSTED}"
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = str(number)
    return f"{path} broke the process that reads it (signal {name}); {_UNTRUSTED}"


def read_pickle(path: Path, limits: Limits = PICKLE) -> Any:
    """Read a pickle of arrays and plain containers without trusting it.

    Raises `InputError` if it is absent, broken, over the limits, or asks for anything outside the allow-list, which the
    message names.
    """
    answer = read_in_child(path, "pickle", limits)
    if answer.kind == "value":
        return answer.parts[0]
    if answer.kind == "refused":
        raise InputError(
            f"{path} is refused: its pickle uses {answer.parts[0]}, which is not among the arrays and containers that "
            "a recording needs and could run code; do not open this file, get the recording from a source you trust"
        )
    reason = ": ".join(answer.parts)
    raise InputError(f"{path} is not a readable pickle ({reason}); it may be truncated, fetch it again")
