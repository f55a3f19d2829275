"""All versions of the embedded town, and to which of them a frozen split belongs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from benchmark.errors import InputError
from benchmark.machine.workspace import EMBEDDED, EMBEDDED_VERSION, read_embedded_version, strip_version

if TYPE_CHECKING:
    from generation.sources.mini import TownSettings

Pictures = Literal["all", "keyframes"]


@dataclass(frozen=True, slots=True)
class EmbeddedTown:
    """One version of the embedded town.

    Attributes:
        name: Of the data set, in records too: ``mini`` for the current one, ``mini@1`` for the first by its version.
        scene_names: Gives the names of its recordings, without building any.
        folder_name: Gives its folder in the user's cache.
        build: Writes it, or what is left of it: root, which frames get images now, number of processes; gives the root.
        takes: How long that is, in words.
        drawn_name: A name for what happens in the scenes and how they look: all that a measured number depends on.
        fingerprints: Of the recordings, as the frozen splits of an earlier version name them.
    """

    name: str
    scene_names: Callable[[], tuple[str, ...]]
    folder_name: Callable[[], str]
    build: Callable[[Path, Pictures, int], Path]
    takes: Mapping[Pictures, str]
    drawn_name: Callable[[], str]
    fingerprints: tuple[str, ...] = ()


def find_town(data: str) -> EmbeddedTown:
    """The town that ``mini`` or ``mini@1`` names; raises `InputError` if there is no such version."""
    version = read_embedded_version(data)
    town = TOWNS.get(EMBEDDED_VERSION if data == EMBEDDED else version or 0)
    if town is None:
        known = [EMBEDDED, *(each.name for each in TOWNS.values())]
        raise InputError(f"there is no embedded data set {data}; choose {', '.join(known)}, or ./{data} for a folder")
    is_current = data == EMBEDDED or (version == EMBEDDED_VERSION and version == max(TOWNS))
    return replace(town, name=EMBEDDED) if is_current else town


def find_version(recordings: str, fingerprint: str, *, packaged: bool) -> int | None:
    """Version of the town that a frozen split was made from, if its recordings are of any that is known.

    A ``packaged`` split without a known fingerprint is of the current one.
    """
    if strip_version(recordings) != EMBEDDED:
        return None
    known = (version for version, town in TOWNS.items() if fingerprint in town.fingerprints)
    return next(known, EMBEDDED_VERSION if packaged else None)


def format_town(version: int) -> str:
    """Value of ``--data`` for a version."""
    return EMBEDDED if version == EMBEDDED_VERSION else TOWNS[version].name


def _settle(version: int) -> "TownSettings":
    from generation.sources.mini import TownSettings
    from generation.sources.town import DEFAULT_VAL_SCENES

    if version == 1:
        return TownSettings(version=1)
    return TownSettings(val_scenes=DEFAULT_VAL_SCENES, pictures="asked", version=version)


def _list_scenes(version: int) -> tuple[str, ...]:
    from generation.sources.town.scenes import list_town_scene_names

    return list_town_scene_names("val", _settle(version).val_scenes)


def _build(version: int, root: Path, pictures: Pictures, workers: int) -> Path:
    from generation.sources.mini import build_town_data_set

    settings = _settle(version)
    settings = settings if settings.pictures == "asked" else replace(settings, pictures=pictures)
    return build_town_data_set(root, settings, workers=workers)


def _make_town(version: int, takes: Mapping[Pictures, str], fingerprints: tuple[str, ...] = ()) -> EmbeddedTown:
    return EmbeddedTown(
        f"{EMBEDDED}@{version}",
        partial(_list_scenes, version),
        lambda: _settle(version).folder_name(EMBEDDED),
        partial(_build, version),
        takes,
        lambda: _settle(version).drawn_name(EMBEDDED),
        fingerprints,
    )


TOWNS: Final[Mapping[int, EmbeddedTown]] = {
    1: _make_town(
        1,
        {"keyframes": "a minute", "all": "five minutes"},
        (
            "93513133c4f373c13bcea9e699e199a7a6c5fed130e1982855deac05fc1184fe",  # mini-adv-1, mini-adv-2
            "c98053b3a9f2a7b236baa5860989f0300af0dcebc8e018e7eb1af45bed03eb42",  # mini-adv-3
            "97c86f1388dea5a7ba19ed66512835cfdde040174ede8336d4e01b184df49c7b",  # as written now
        ),
    ),
    2: _make_town(
        2,
        dict.fromkeys(("keyframes", "all"), "half a minute; images are drawn when they are looked at"),
        ("dfe35d5219082661b5c286c8627a7e326ec0a08620bf917db71f29924b295fea",),  # mini-adv-4
    ),
}
"""By version: the first is packaged as tracks and maps, the second is what the town's code makes. `EMBEDDED_VERSION` is
``mini``."""
