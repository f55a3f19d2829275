"""Published files from the internet, for users who have it: broken-off downloads go on, nothing is taken unchecked."""

import http.client
import shutil
import urllib.error
import urllib.request
from pathlib import Path
from typing import Final

from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, writing_to
from benchmark.weights.catalogue import PublishedFile, PublishedWeights

_TIMEOUT_S: Final = 60.0
_PIECE_BYTES: Final = 1 << 20
_PARTIAL_CONTENT: Final = 206
_RANGE_NOT_SATISFIABLE: Final = 416


def fetch_files(weights: PublishedWeights, folder: Path) -> None:
    """Fetch the files that a folder lacks, each whole or not at all; the same call goes on where it broke off."""
    if any(file.url is None for file in weights.files):
        _fetch_from_hub(weights, folder)
        return
    for file in weights.files:
        if not (folder / file.name).is_file():
            _download(weights, file, folder / file.name)


def require_published(weights: PublishedWeights, file: PublishedFile, path: Path) -> None:
    """Raise `InputError` if a file has another size or hash than the published one, as far as these are known."""
    size = path.stat().st_size
    if file.size_bytes not in (None, size):
        raise InputError(
            f"{path} has {size} bytes instead of {file.size_bytes}; get {file.name} from {weights.address} again"
        )
    if file.sha256 is not None and not file_sha256(path).startswith(file.sha256.lower()):
        raise InputError(
            f"{path} is not the published {file.name} (its SHA-256 differs); get it from {weights.address}"
        )


def _fetch_from_hub(weights: PublishedWeights, folder: Path) -> None:
    """A folder of the hub by the hub's own client, which knows how to go on and how to come in."""
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        extra = "quality" if weights.used_by.startswith("quality") else "render"
        raise InputError(
            f"weights fetch {weights.name} needs the package huggingface_hub; install it with: pip install "
            f"'challenger-bench[{extra}]'"
        ) from error
    names = [file.name for file in weights.files]
    with writing_to(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        snapshot_download(weights.repository, revision=weights.revision, allow_patterns=names, local_dir=folder)
    # Any error of the network, the hub or its client.
    except Exception as error:
        raise _cannot_fetch(weights.address, error, _format_advice(weights)) from error
    shutil.rmtree(folder / ".cache", ignore_errors=True)
    for file in weights.files:
        path = folder / file.name
        if not path.is_file():
            raise InputError(f"cannot fetch {weights.url(file)} (not found); {_format_advice(weights)}")
        try:
            require_published(weights, file, path)
        except InputError:
            path.unlink()
            raise


def _format_advice(weights: PublishedWeights, file: PublishedFile | None = None) -> str:
    """Advice where there is no way to the internet."""
    named, page = (weights.names, weights.address) if file is None or file.page is None else (file.name, file.page)
    return f"get {named} from {page} with a browser, then run: {weights.how_to_import}"


def _download(weights: PublishedWeights, file: PublishedFile, path: Path) -> None:
    """One file; what an earlier attempt left is not fetched again if the server says that it is the same file."""
    url, size_bytes, sha256 = weights.url(file), file.size_bytes, file.sha256
    with writing_to(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    try:
        _receive(url, part)
    except urllib.error.HTTPError as error:
        if error.code != _RANGE_NOT_SATISFIABLE:
            raise _cannot_fetch(url, error, _format_advice(weights, file)) from error
        # The partial file is longer than the file: it is another one.
        _delete_partial(part)
        raise InputError(f"{url} has changed since its download began; run the command again") from error
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise _cannot_fetch(url, error, _format_advice(weights, file)) from error
    received = part.stat().st_size
    if size_bytes not in (None, received):
        _delete_partial(part)
        raise InputError(f"{url} returned {received} bytes instead of {size_bytes}; fetch {path.name} again")
    if sha256 is not None and not file_sha256(part).startswith(sha256.lower()):
        _delete_partial(part)
        raise InputError(
            f"{url} did not return {path.name} (its SHA-256 differs); get it from {file.page or weights.address}"
        )
    with writing_to(path):
        part.replace(path)
    _delete_partial(part)


def _receive(url: str, part: Path) -> None:
    tag_file = part.with_suffix(".tag")
    received_bytes = part.stat().st_size if part.is_file() and tag_file.is_file() else 0
    request = urllib.request.Request(url)
    if received_bytes:
        request.add_header("Range", f"bytes={received_bytes}-")
        request.add_header("If-Range", tag_file.read_text())
    with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as answer:
        goes_on = received_bytes > 0 and answer.status == _PARTIAL_CONTENT
        tag, announced = answer.headers.get("ETag", ""), answer.headers.get("Content-Length")
        received = 0
        with writing_to(part):
            # A weak tag does not guarantee the same bytes, so a later range request cannot rely on it.
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
    cause = error.reason if isinstance(error, urllib.error.URLError) else error
    reason = (str(cause).splitlines() or [type(error).__name__])[0]
    return InputError(f"cannot fetch {url} ({reason}); {instead}")


def _delete_partial(part: Path) -> None:
    part.unlink(missing_ok=True)
    part.with_suffix(".tag").unlink(missing_ok=True)
