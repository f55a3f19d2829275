"""Official files from the internet, for users who have it."""

import shutil
from pathlib import Path

from adapters.checkpoints.importing import ImportedWeights, import_checkpoint
from adapters.checkpoints.official import OfficialFile, how_to_import
from benchmark.machine.storage import only_writer
from benchmark.weights.downloads import download


def fetch_official(file: OfficialFile, cache: Path, *, normalisation: str | None = None) -> ImportedWeights:
    """Fetch an official file and what it needs, check them and import them; the fetched files themselves are not kept.

    The same command goes on where a download broke off.

    Args:
        file: Which one (`official_file`).
        cache: Folder of weights.
        normalisation: See `import_checkpoint`.

    Returns:
        The imported weights.

    Raises:
        InputError: If it cannot be fetched, is not the official file, or is refused by the import.
    """
    folder = cache / f".fetching-{file.model}"
    with only_writer(folder):
        # An import finds what a file needs beside it.
        for each in (*file.companions, file):
            path = folder / each.name
            if path.is_file():
                continue
            instead = f"get {each.name} from {each.page} with a browser, then run: {how_to_import(file)}"
            download(each.url, path, instead=instead, size_bytes=each.size_bytes, sha256=each.sha256, page=each.page)
        try:
            return import_checkpoint(folder / file.name, file.model, cache, normalisation=normalisation)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
