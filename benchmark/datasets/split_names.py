"""Which scenes a split has, and the order in which readers go through exported infos: by scene, even at equal times."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.devkit_import import import_devkit_module
from benchmark.datasets.scene_names import read_names
from benchmark.datasets.tables import find_splits_file
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.storage import read_json
from benchmark.untrusted.files import to_one_line

_APART_US: Final = 2_000_000
"""Readers of SparseDrive's family keep their memory across no longer time than this."""
_SHIFTED_APART_US: Final = 10_000_000


def compute_shifts_us(scenes: Sequence[tuple[str, int, int]]) -> dict[str, int]:
    """Shifts by name, from name, first and last time of each scene, that keep scenes together and apart in time.

    Only scenes that begin before all earlier ones have ended for 2 s need one. Of scenes that begin together the first
    by name is the earlier one.
    """
    shifts: dict[str, int] = {}
    ended: int | None = None
    for name, first, last in sorted(scenes, key=lambda scene: (scene[1], scene[0])):
        shift = 0
        if ended is not None and first <= ended + _APART_US:
            shift = shifts[name] = ended + _SHIFTED_APART_US - first
        ended = last + shift
    return shifts


def sort_as_exported(scenes: Sequence[str], times_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """(S,) numbers of samples in dumps by official code of exported infos, which do not name them.

    From the scene of each of S samples and their (S,) times in the tables; readers sort by the moved times.
    """
    names = np.array(scenes)
    of_scene = {name: times_us[names == name] for name in dict.fromkeys(scenes)}
    shifts = compute_shifts_us([(name, int(times.min()), int(times.max())) for name, times in of_scene.items()])
    return np.argsort(times_us + np.array([shifts.get(name, 0) for name in scenes], np.int64), kind="stable")


BORROWED_NAMES: Final = "borrowed-names"
"""Split in ``challenger.json`` of a root whose scenes have names of nuScenes' own: no split of it is evaluated."""
_SUFFIXED = re.compile(r"scene-\d{4}-.+")


class NoSuchSplitError(InputError):
    """A data set is sound, but has no split of a name; ``available`` are those that it has."""

    def __init__(self, sentence: str, available: Sequence[str] = ()) -> None:
        super().__init__(sentence)
        self.available = tuple(available)


def read_splits(root: Path, version: str) -> dict[str, tuple[str, ...]]:
    """Scene names by custom split from ``<version>/splits.json``, else ``splits.json`` in the root, else none."""
    path, names = find_splits_file(root / version, root), read_names(root / version)
    listed = {} if path is None else _checked(read_json(path), path)
    return {split: tuple(names.get(name, name) for name in scenes) for split, scenes in listed.items()}


def _checked(value: Any, path: Path) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, dict) or not all(
        isinstance(names, list) and all(isinstance(name, str) for name in names) for names in value.values()
    ):
        raise InputError(f"{path} must map split names to lists of scene names; make it again")
    for split, names in value.items():
        if len(set(names)) < len(names):
            raise InputError(f"{path}: split {split!r} lists a scene twice; list each scene once")
    return {split: tuple(names) for split, names in value.items()}


def select_scenes(
    split: str,
    present: Sequence[str],
    custom: Mapping[str, Sequence[str]],
    *,
    where: str,
    built_as: str | None = None,
) -> tuple[str, ...]:
    """Scenes of a split.

    A data set that says which splits it has (``splits.json``, or ``challenger.json`` of a generated one) has these and
    no others: adversarial scenes are never taken for ``val``. Of one that says nothing the first rule counts that
    applies: 1. ``adv`` alone, of all scenes, where every scene is called like the published Adv-nuSc's
    (``scene-0001-suffix``). 2. nuScenes' official lists, of the scenes that are here. 3. ``val``, of all scenes, where
    no official list names any.

    A split that does not exist raises `NoSuchSplitError`, a scene in ``splits.json`` that is not here `InputError`, and
    so does any split of a root of `BORROWED_NAMES`. ``where`` names the data set in messages.
    """
    if built_as == BORROWED_NAMES:
        raise InputError(
            f"{where} was written by data export nuscenes: its scenes only have names of nuScenes' validation scenes, "
            "and are none of them; choose the data set that it was exported from"
        )
    if split in custom and not custom[split]:
        raise InputError(f"{where}: split {split!r} of splits.json is empty; correct it, or choose another split")
    if split in custom:
        absent = sorted(set(custom[split]) - set(present))
        if absent:
            raise InputError(
                f"{where}: splits.json lists {to_one_line(absent[0], 80)} in {split!r}, but there is no such scene; "
                "complete the data set or correct splits.json"
            )
        return tuple(sorted(custom[split]))
    known = _list_generated_splits(present, custom, built_as)
    if split in known:
        return known[split]
    available = list_split_names(present, custom, built_as)
    only = f"the only one is {available[0]}" if len(available) == 1 else f"it has {', '.join(available)}"
    raise NoSuchSplitError(f"{where} has no split {split!r}; {did_you_mean(split, available)}{only}", available)


def find_default_split(
    present: Sequence[str], custom: Mapping[str, Sequence[str]], *, where: str, built_as: str | None = None
) -> str:
    """The split that is meant where none is named: ``val`` where there is one, else the only one, else an error."""
    available = list_split_names(present, custom, built_as)
    if "val" in available:
        return "val"
    if len(available) != 1:
        raise InputError(f"{where} has the splits {', '.join(available)}; name one with --split")
    return available[0]


def list_split_names(
    present: Sequence[str], custom: Mapping[str, Sequence[str]], built_as: str | None = None
) -> tuple[str, ...]:
    """Sorted names of a data set's splits, whether `select_scenes` takes them or says what is wrong with them."""
    return tuple(sorted({*custom, *_list_generated_splits(present, custom, built_as)}))


def _list_generated_splits(
    present: Sequence[str], custom: Mapping[str, Sequence[str]], built_as: str | None
) -> dict[str, tuple[str, ...]]:
    """Splits beside those of ``splits.json``."""
    if custom or built_as is not None:
        return {} if built_as is None else {built_as: tuple(sorted(present))}
    return _guess_splits(present)


def _guess_splits(present: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Splits of a data set that does not say which it has."""
    everything = tuple(sorted(present))
    if present and all(_SUFFIXED.fullmatch(name) for name in present):
        return {"adv": everything}
    return _list_official_splits(present) or {"val": everything}


def _list_official_splits(present: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Official nuScenes splits, reduced to the scenes that are here; empty ones are left out."""
    present_names = set(present)
    create_splits_scenes = import_devkit_module("nuscenes.utils.splits").create_splits_scenes
    reduced = {name: tuple(sorted(present_names & set(scenes))) for name, scenes in create_splits_scenes().items()}
    return {name: scenes for name, scenes in reduced.items() if scenes}
