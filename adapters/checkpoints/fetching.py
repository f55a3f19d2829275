"""Official files from the internet, for users who have it."""

import http.client
import shutil
import urllib.error
import urllib.request
from pathlib import Path
from typing import Final

from adapters.checkpoints.importing import ImportedWeights, import_checkpoint
from adapters.checkpoints.official import OfficialFile
from benchmark.errors import InputError
from benchmark.storage import file_sha256, only_writer, writing_to

_TIMEOUT_S: Final = 60.0
_PIECE_BYTES: Final = 1 << 20


def fetch_official(file: OfficialFile, cache: Path, *, normalisation: str | None = None) -> ImportedWeights:
    """Fetch an official file, check it and import it; the fetched file itself is not kept.

    Args:
        file: Which one (`official_file`).
        cache: Folder of weights.
        normalisation: See `import_checkpoint`.

    Returns:
        The imported weights.

    Raises:
        InputError: If it cannot be fetched, is not the official file, or is refused by the import.
    """
    folder = cache / ".fetching"
    with only_writer(folder):
        path = folder / file.name
        try:
            _download(file, path)
            _require_official(file, path)
            return import_checkpoint(path, file.model, cache, normalisation=normalisation)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _require_official(file: OfficialFile, path: Path) -> None:
    size = path.stat().st_size
    if file.size_bytes not in (None, size):
        raise InputError(f"{file.url} gave {size} bytes instead of {file.size_bytes}; fetch {file.name} again")
    if file.sha256 is not None and file_sha256(path) != file.sha256:
        raise InputError(f"what {file.url} gave is not {file.name} (its SHA-256 differs); get it from {file.page}")


def _download(file: OfficialFile, path: Path) -> None:
    received = 0
    try:
        with urllib.request.urlopen(file.url, timeout=_TIMEOUT_S) as answer, path.open("wb") as stream:
            announced = answer.headers.get("Content-Length")
            while piece := answer.read(_PIECE_BYTES):
                with writing_to(path):
                    stream.write(piece)
                received += len(piece)
    except (OSError, http.client.HTTPException, ValueError) as error:
        reason = error.reason if isinstance(error, urllib.error.URLError) else error
        raise InputError(
            f"cannot fetch {file.url} ({reason}); get {file.name} from {file.page} with a browser, then run: "
            f"challenger-bench weights import {file.name}"
        ) from error
    if announced is not None and announced.isdigit() and received < int(announced):
        raise InputError(f"{file.url} broke off after {received} of {announced} bytes; run the command again")
