"""Published files from the internet, for users who have it: broken-off downloads go on, nothing is taken unchecked."""

import http.client
import urllib.error
import urllib.request
from pathlib import Path
from typing import Final

from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, writing_to

_TIMEOUT_S: Final = 60.0
_PIECE_BYTES: Final = 1 << 20
_PARTIAL_CONTENT: Final = 206
_RANGE_NOT_SATISFIABLE: Final = 416


def download(
    url: str, path: Path, *, instead: str, size_bytes: int | None = None, sha256: str | None = None, page: str
) -> None:
    """Fetch one file; what an earlier attempt left is not fetched again if the server says that it is the same file.

    Args:
        url: Where the bytes are.
        path: Where to; written whole or not at all, beside it ``.part`` and ``.tag`` of an unfinished download.
        instead: What to do where there is no way to the internet; the end of a sentence.
        size_bytes: Its size, if known.
        sha256: Its hash in hexadecimal digits, if known; the first few digits check just as well.
        page: Where a person gets it.

    Raises:
        InputError: If it cannot be fetched, broke off, or is not the file that was published.
    """
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    try:
        _receive(url, part)
    except urllib.error.HTTPError as error:
        if error.code != _RANGE_NOT_SATISFIABLE:
            raise _cannot_fetch(url, error, instead) from error
        # What is there is longer than the file: it is another one.
        _forget(part)
        raise InputError(f"{url} has changed since its download began; run the command again") from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise _cannot_fetch(url, error, instead) from error
    received = part.stat().st_size
    if size_bytes not in (None, received):
        _forget(part)
        raise InputError(f"{url} gave {received} bytes instead of {size_bytes}; fetch {path.name} again")
    if sha256 is not None and not file_sha256(part).startswith(sha256.lower()):
        _forget(part)
        raise InputError(f"what {url} gave is not {path.name} (its SHA-256 differs); get it from {page}")
    with writing_to(path):
        part.replace(path)
    _forget(part)


def _receive(url: str, part: Path) -> None:
    tag_file = part.with_suffix(".tag")
    kept = part.stat().st_size if part.is_file() and tag_file.is_file() else 0
    request = urllib.request.Request(url)
    if kept:
        request.add_header("Range", f"bytes={kept}-")
        request.add_header("If-Range", tag_file.read_text())
    with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as answer:
        goes_on = kept > 0 and answer.status == _PARTIAL_CONTENT
        tag, announced = answer.headers.get("ETag", ""), answer.headers.get("Content-Length")
        received = 0
        with writing_to(part):
            # A weak tag does not promise the same bytes, so that a later range could not rely on it.
            if tag and not tag.startswith("W/"):
                tag_file.write_text(tag)
            else:
                tag_file.unlink(missing_ok=True)
            stream = part.open("ab" if goes_on else "wb")
        with stream:
            while piece := answer.read(_PIECE_BYTES):
                with writing_to(part):
                    stream.write(piece)
                received += len(piece)
    if announced is not None and announced.isdigit() and received < int(announced):
        raise InputError(f"{url} broke off after {received} of {announced} bytes; run the command again")


def _cannot_fetch(url: str, error: Exception, instead: str) -> InputError:
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    return InputError(f"cannot fetch {url} ({reason}); {instead}")


def _forget(part: Path) -> None:
    part.unlink(missing_ok=True)
    part.with_suffix(".tag").unlink(missing_ok=True)
