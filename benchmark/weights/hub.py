"""Published weights that are kept as they come: folders of files, fetched, imported or given by the user.

Models that other libraries load (transformers, diffusers) want a folder with a configuration beside the tensors. It
lies in the cache under ``weights/hub/NAME``, or wherever the user says. Nothing in such a folder is a pickle unless
its entry names one, and who reads that reads it without running anything in it.
"""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import quote

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, file_sha256, only_writer, writing_to
from benchmark.machine.workspace import cache_root
from benchmark.weights.downloads import download

_HUB: Final = "https://huggingface.co"
_READ_WHOLE_BYTES: Final = 1 << 22
_BLOCK_BYTES: Final = 1 << 18
_BLOCKS: Final = 16


@dataclass(frozen=True, slots=True)
class HubFile:
    """One file of a folder of weights. ``None`` means that nobody here knows.

    Attributes:
        name: Path in the repository and in the folder, with ``/``.
        size_bytes: Its size.
        sha256: Its hash, or the first digits that its authors put into its name.
    """

    name: str
    size_bytes: int | None = None
    sha256: str | None = None


@dataclass(frozen=True, slots=True)
class HubWeights:
    """Weights as they are published.

    Attributes:
        name: How they are called here, and their folder in the cache.
        repository: ``owner/name`` on the hub (or on GitHub, where ``download_root`` says so).
        revision: Commit, branch or release tag.
        files: What is needed of it.
        licence: Of the weights, as far as their authors say.
        used_by: Which command needs them for what.
        about_megabytes: How much there is to fetch, roughly, where sizes are not known to the byte.
        download_root: Address before the file names, where the files are not on the hub.
        page: Where a person gets them, if not on the hub.
    """

    name: str
    repository: str
    revision: str
    files: tuple[HubFile, ...]
    licence: str
    used_by: str
    about_megabytes: int | None = None
    download_root: str | None = None
    page: str | None = None

    def __post_init__(self) -> None:
        for file in self.files:
            parts = PurePosixPath(file.name).parts
            if not parts or file.name.startswith("/") or any(part in ("..", ".") for part in parts):
                raise ValueError(f"weights {self.name}: {file.name!r} is not a file inside their folder")

    @property
    def address(self) -> str:
        """Where a person gets them with a browser."""
        return self.page or f"{_HUB}/{self.repository}/tree/{self.revision}"

    @property
    def size_text(self) -> str:
        """How big they are, in words."""
        sizes = [file.size_bytes for file in self.files if file.size_bytes is not None]
        if len(sizes) == len(self.files):
            return f"{sum(sizes) / 1e6:.0f} MB"
        return "size unknown" if self.about_megabytes is None else f"about {self.about_megabytes} MB"

    def url(self, file: HubFile) -> str:
        """Where the bytes of a file are."""
        root = self.download_root or f"{_HUB}/{self.repository}/resolve/{self.revision}"
        return f"{root}/{quote(file.name)}"

    def missing_in(self, folder: Path) -> tuple[str, ...]:
        """Names of the files that a folder lacks."""
        return tuple(file.name for file in self.files if not (folder / file.name).is_file())


@dataclass(frozen=True, slots=True)
class KnownHubWeights:
    """Weights, and whether they are in the cache: what ``challenger-bench weights list`` says.

    Attributes:
        weights: As they are published.
        folder: Where they lie, or ``None``.
    """

    weights: HubWeights
    folder: Path | None

    def as_json(self) -> dict[str, Any]:
        """Plain values; what official files of planners say too has the same name there."""
        known = self.weights
        return {
            "model": known.name,
            "repository": known.repository,
            "revision": known.revision,
            "page": known.address,
            "licence": known.licence,
            "used_by": known.used_by,
            "size": known.size_text,
            "files": [
                {"name": file.name, "url": known.url(file), "size_bytes": file.size_bytes, "sha256": file.sha256}
                for file in known.files
            ],
            "imported": [] if self.folder is None else [{"path": str(self.folder)}],
        }

    def plain(self) -> str:
        """A few lines of text."""
        known = self.weights
        kept = "not imported" if self.folder is None else f"in {self.folder}"
        head = f"{known.name}: {known.repository} at {known.revision}, {known.size_text}, for {known.used_by}"
        return "\n".join([head, f"  {known.address}", f"  {known.licence}", f"  {kept}"])


def hub_folder(cache: Path | None = None) -> Path:
    """Where folders of weights are kept.

    Args:
        cache: Folder of all weights; the user's by default.

    Returns:
        A folder that need not exist.
    """
    return (cache or cache_root() / "weights") / "hub"


def folder_of(weights: HubWeights, given: Path | None, cache: Path | None = None) -> Path:
    """The folder in which weights lie.

    Args:
        weights: Which.
        given: What the user says: their folder, or one that holds it under their name here or in the hub; or ``None``
            for the cache.
        cache: Folder of all weights; the user's by default.

    Returns:
        A folder with every file that is needed.

    Raises:
        InputError: If there is none: what to get, where, how big, and with which command.
    """
    places = [hub_folder(cache) / weights.name]
    if given is not None:
        places = [given / weights.name, given / PurePosixPath(weights.repository).name, given]
    for place in places:
        if not weights.missing_in(place):
            return place
    started = next((place for place in places if any((place / file.name).is_file() for file in weights.files)), None)
    lacks = "" if started is None else f" ({started} lacks {', '.join(weights.missing_in(started))})"
    where = "" if given is None else f" in {given}"
    raise InputError(
        f"there are no weights {weights.name}{where}{lacks}, which {weights.used_by} needs; get {_named(weights)} "
        f"({weights.size_text}) from {weights.address} and run: challenger-bench weights import FOLDER --model "
        f"{weights.name}, or on a machine with internet: challenger-bench weights fetch {weights.name}"
    )


def fetch(weights: HubWeights, cache: Path | None = None) -> Path:
    """Fetch weights from the internet into the cache; the same command goes on where it broke off.

    Args:
        weights: Which.
        cache: Folder of all weights; the user's by default.

    Returns:
        Their folder, which is there whole or not at all.

    Raises:
        InputError: If a file cannot be fetched or is not the published one.
    """
    target = hub_folder(cache) / weights.name
    if not weights.missing_in(target):
        return target
    folder = hub_folder(cache) / f".fetching-{weights.name}"
    instead = (
        f"get {_named(weights)} from {weights.address} with a browser, then run: challenger-bench weights import "
        f"FOLDER --model {weights.name}"
    )
    with only_writer(folder):
        for file in weights.files:
            path = folder / file.name
            if not path.is_file():
                url = weights.url(file)
                download(
                    url, path, instead=instead, size_bytes=file.size_bytes, sha256=file.sha256, page=weights.address
                )
        _put_in_place(folder, target)
    return target


def import_folder(weights: HubWeights, path: Path, cache: Path | None = None) -> Path:
    """Copy weights that the user has into the cache, checked as far as anything is known of them.

    Args:
        weights: Which.
        path: Their folder; where they are one file, that file is enough.
        cache: Folder of all weights; the user's by default.

    Returns:
        Their folder in the cache.

    Raises:
        InputError: If a file is missing, has another size or hash than the published one, or cannot be copied.
    """
    source = path.parent if path.is_file() and [path.name] == [file.name for file in weights.files] else path
    if not source.is_dir():
        raise InputError(f"there is no folder {path}; give the one that holds {_named(weights)}")
    missing = weights.missing_in(source)
    if missing:
        raise InputError(f"{source} lacks {', '.join(missing)} of {weights.name}; get them from {weights.address}")
    target, folder = hub_folder(cache) / weights.name, hub_folder(cache) / f".importing-{weights.name}"
    if target.is_dir() and target.resolve() == source.resolve():
        raise InputError(f"{source} is where {weights.name} is kept already; there is nothing to import")
    for file in weights.files:
        _require_published(weights, file, source / file.name)
    with only_writer(folder):
        for file in weights.files:
            with writing_to(folder / file.name):
                (folder / file.name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source / file.name, folder / file.name)
        _put_in_place(folder, target)
    return target


def known_hub_weights(entries: tuple[HubWeights, ...], cache: Path | None = None) -> tuple[KnownHubWeights, ...]:
    """What there is and what is here.

    Args:
        entries: All weights that commands use.
        cache: Folder of all weights; the user's by default.

    Returns:
        One line of a list an entry.
    """
    places = ((weights, hub_folder(cache) / weights.name) for weights in entries)
    return tuple(KnownHubWeights(weights, None if weights.missing_in(place) else place) for weights, place in places)


def hub_weights_at(entries: tuple[HubWeights, ...], path: Path, name: str | None) -> HubWeights | None:
    """Which weights a user means.

    Args:
        entries: All weights that commands use.
        path: A folder, or the one file of weights that are one file.
        name: What the user calls them, or ``None`` to go by names of folder and files.

    Returns:
        The weights, or ``None`` if these are others than folders of published files.

    Raises:
        InputError: If the path is a folder and does not tell which weights it holds.
    """
    if name is not None:
        return next((entry for entry in entries if entry.name == name), None)
    if path.is_file():
        return next((entry for entry in entries if [file.name for file in entry.files] == [path.name]), None)
    if not path.is_dir():
        return None
    named = [entry for entry in entries if path.name in (entry.name, PurePosixPath(entry.repository).name)]
    if len(named) != 1:
        known = ", ".join(entry.name for entry in entries)
        raise InputError(f"say which weights {path} holds with --model, one of {known}")
    return named[0]


def content_hash(weights: HubWeights, folder: Path) -> str:
    """A hash for records that tells weights apart without reading gigabytes.

    Args:
        weights: Which.
        folder: Where they lie (`folder_of`).

    Returns:
        64 hexadecimal digits: of names, sizes, small files whole, and of large ones sixteen blocks of 256 KiB spread
        evenly from the first byte to the last.

    Raises:
        InputError: If a file cannot be read.
    """
    found = hashlib.sha256()
    for file in sorted(weights.files, key=lambda file: file.name):
        path = folder / file.name
        try:
            size = path.stat().st_size
            found.update(canonical_json([file.name, size]).encode())
            with path.open("rb") as stream:
                if size <= _READ_WHOLE_BYTES:
                    found.update(stream.read())
                    continue
                for block in range(_BLOCKS):
                    stream.seek((size - _BLOCK_BYTES) * block // (_BLOCKS - 1))
                    found.update(stream.read(_BLOCK_BYTES))
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    return found.hexdigest()


def _put_in_place(folder: Path, target: Path) -> None:
    """A folder becomes the kept one; the old one goes only when the new one is complete."""
    old = target.with_name(f".old-{target.name}")
    with writing_to(target):
        shutil.rmtree(old, ignore_errors=True)
        if target.exists():
            target.replace(old)
        folder.replace(target)
        shutil.rmtree(old, ignore_errors=True)


def _require_published(weights: HubWeights, file: HubFile, path: Path) -> None:
    size = path.stat().st_size
    if file.size_bytes not in (None, size):
        raise InputError(
            f"{path} has {size} bytes instead of {file.size_bytes}; get {file.name} from {weights.address} again"
        )
    if file.sha256 is not None and not file_sha256(path).startswith(file.sha256.lower()):
        raise InputError(
            f"{path} is not the published {file.name} (its SHA-256 differs); get it from {weights.address}"
        )


def _named(weights: HubWeights) -> str:
    return ", ".join(file.name for file in weights.files)
