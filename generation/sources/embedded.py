"""All versions of the embedded town, and to which of them a frozen split belongs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from benchmark.errors import InputError
from benchmark.machine.workspace import EMBEDDED, EMBEDDED_VERSION, read_embedded_version, strip_version

Pictures = Literal["all", "keyframes"]


@dataclass(frozen=True, slots=True)
class EmbeddedTown:
    """One version of the embedded town.

    Attributes:
        name: Of the data set, in records too: ``mini`` for the current one, ``mini@1`` for the first.
        scene_names: Gives the names of its recordings, without building any.
        folder_name: Gives its folder in the user's cache.
        build: Writes it, or what is left of it: root, which frames get images now, number of processes; gives the root.
        fingerprints: Of the recordings, as the frozen splits of an earlier version name them.
    """

    name: str
    scene_names: Callable[[], tuple[str, ...]]
    folder_name: Callable[[], str]
    build: Callable[[Path, Pictures, int], Path]
    fingerprints: tuple[str, ...] = ()


def find_town(data: str) -> EmbeddedTown:
    """The town that ``mini`` or ``mini@1`` names; raises `InputError` if there is no such version."""
    version = read_embedded_version(data)
    town = CURRENT if data == EMBEDDED else EARLIER.get(version or 0, CURRENT if version == EMBEDDED_VERSION else None)
    if town is None:
        known = [EMBEDDED, *(earlier.name for earlier in EARLIER.values())]
        raise InputError(f"there is no embedded data set {data}; choose {' or '.join(known)}, or ./{data} for a folder")
    return town


def find_version(recordings: str, fingerprint: str, *, packaged: bool) -> int | None:
    """Version of the town that a frozen split was made from, if its recordings are of any that is known.

    A ``packaged`` split of no earlier town is of the current one.
    """
    if strip_version(recordings) != EMBEDDED:
        return None
    known = (version for version, town in EARLIER.items() if fingerprint in town.fingerprints)
    return next(known, EMBEDDED_VERSION if packaged else None)


def format_town(version: int) -> str:
    """Value of ``--data`` for a version."""
    return EMBEDDED if version == EMBEDDED_VERSION else EARLIER[version].name


def _list_scenes() -> tuple[str, ...]:
    from generation.sources.mini import TownSettings
    from generation.sources.town.scenes import list_town_scene_names

    return list_town_scene_names("val", TownSettings().val_scenes)


def _format_folder() -> str:
    from generation.sources.mini import TownSettings

    return TownSettings().folder_name(EMBEDDED)


def _build(root: Path, pictures: Pictures, workers: int) -> Path:
    from generation.sources.mini import TownSettings, build_town_data_set

    return build_town_data_set(root, TownSettings(pictures=pictures), workers=workers)


def _list_first_scenes() -> tuple[str, ...]:
    return tuple(f"scene-{8000 + index}" for index in range(10))


def _format_first_folder() -> str:
    from generation.sources.first_town import format_first_folder

    return format_first_folder()


def _build_first(root: Path, pictures: Pictures, workers: int) -> Path:
    from generation.sources.first_town import build_first_town

    return build_first_town(root, pictures, workers=workers)


CURRENT: Final = EmbeddedTown(EMBEDDED, _list_scenes, _format_folder, _build)
"""What the town's code makes now: version `EMBEDDED_VERSION`."""
EARLIER: Final[Mapping[int, EmbeddedTown]] = {
    1: EmbeddedTown(
        f"{EMBEDDED}@1",
        _list_first_scenes,
        _format_first_folder,
        _build_first,
        (
            "93513133c4f373c13bcea9e699e199a7a6c5fed130e1982855deac05fc1184fe",  # mini-adv-1, mini-adv-2
            "c98053b3a9f2a7b236baa5860989f0300af0dcebc8e018e7eb1af45bed03eb42",  # mini-adv-3
            "97c86f1388dea5a7ba19ed66512835cfdde040174ede8336d4e01b184df49c7b",  # as written now
        ),
    ),
}
