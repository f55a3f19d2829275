"""Data sets, splits and scenes before any is opened or built: what is known of them, and what would be built first."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benchmark import api
from benchmark.cli.preflight_places import gigabytes, require_place, require_room
from benchmark.errors import InputError, did_you_mean
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.machine.workspace import Workspace
    from benchmark.records.review import SplitReview
    from generation.splits.packaged import NamedSplit

_BYTES_OF_A_PIXEL: Final = 0.22
"""Of the embedded town's images, with their rows in the tables: 0.36 GB for 10 scenes at 448 x 256."""
_IMAGES_OF_A_SCENE: Final = {"all": 241 * 6, "keyframes": 41 * 6}
"""Of 20 s, six cameras."""


@dataclass(frozen=True, slots=True)
class Ahead:
    """What a command will work on.

    Attributes:
        scenes: Names of the scenes that it will take.
        builds: What has to be built first, for people: what, where, how long, how large.
    """

    scenes: tuple[str, ...]
    builds: tuple[str, ...] = ()

    def plan(self, then: str) -> tuple[str, ...]:
        """What ``--dry-run`` says where something has to be built first."""
        return (*(f"would first build {each}" for each in self.builds), f"would then {then}")

    def counted(self) -> str:
        """How many scenes, for people."""
        return counted(len(self.scenes), "scene")


def town_bytes(scenes: int, size: tuple[int, int] = api.DEFAULT_IMAGE_SIZE, frames: str = "all") -> int:
    """How much of a disk scenes take with schematic images of a size (width, height), about."""
    return round(scenes * _IMAGES_OF_A_SCENE[frames] * size[0] * size[1] * _BYTES_OF_A_PIXEL)


def require_room_to_draw(
    space: "Workspace", data: str, split: str, *, scenes: int, size: tuple[int, int], frames: str
) -> None:
    """Refuse a split that the disk has no room for, where none of it has been made yet.

    Args:
        space: Where it would lie.
        data: What ``--data`` names.
        split: The split.
        scenes: How many there will be, at least.
        size: Width and height of their images, pixels.
        frames: ``all`` or ``keyframes``.

    Raises:
        InputError: If less is free.
    """
    folder = space.split_root(Path(data).resolve().name, split)
    if not folder.exists():
        require_room(folder, town_bytes(scenes, size, frames), f"split {split}", "--out")


def require_data(
    data: str,
    tables: str | None,
    split: str,
    out: Path,
    *,
    scenes: Sequence[str] | None = None,
    limit: int | None = None,
) -> Ahead:
    """Refuse a data set, a split or scenes that there are not and that will not be built.

    Args:
        data: What ``--data`` names.
        tables: Version folder.
        split: The split that the command works on; generated ones of the embedded data are built where they are absent.
        out: Folder below which generated splits lie.
        scenes: Only these scenes.
        limit: Only the first so many.

    Returns:
        What is known of the scenes, and what would be built.

    Raises:
        InputError: If there is no such data set, split or scene, or no room or right to build what is absent.
    """
    from benchmark.datasets.listing import listed_review, listed_scenes
    from benchmark.datasets.split_names import NoSuchSplit
    from benchmark.machine.workspace import DEMONSTRATED, EMBEDDED, how_generated, is_finished, is_generated

    space, name = api.workspace(out), Path(data).resolve().name
    made = space.split_root(name, split)
    if data == EMBEDDED:
        return _embedded(split, out, scenes, limit)
    root = space.demonstrated("val") if data == DEMONSTRATED else Path(data)
    if is_generated(split) and is_finished(made):
        _require_not_rejected(scenes, listed_review(made, split), made)
        return Ahead(_chosen(listed_scenes(made, split), split, scenes, limit))
    every = listed_scenes(root, version=tables)
    try:
        of_split = listed_scenes(root, split, version=tables)
        _require_not_rejected(scenes, listed_review(root, split, version=tables), root)
    except NoSuchSplit as error:
        if not is_generated(split) or not every:
            raise
        raise InputError(
            f"split {split!r} of {name} is not at {made}; make it with: challenger-bench generate --data {data} "
            f"{how_generated(split)} --out {out}"
        ) from error
    return Ahead(_chosen(of_split, split, scenes, limit))


def require_source(
    data: str, tables: str | None, split: str, out: Path, *, scenes: Sequence[str] | None, limit: int | None
) -> Ahead:
    """Refuse what nothing can be generated from, as `require_data`; ``scenes`` may be any of the data set."""
    from benchmark.datasets.listing import listed_scenes
    from benchmark.machine.workspace import DEMONSTRATED, EMBEDDED

    if data == EMBEDDED:
        if split != "val":
            raise InputError(f"the embedded data set mini has no split {split!r} of its own; the only one is val")
        return _embedded("val", out, scenes, limit)
    root = api.workspace(out).demonstrated("val") if data == DEMONSTRATED else Path(data)
    of_split = listed_scenes(root, split, version=tables)
    known = of_split if scenes is None else listed_scenes(root, version=tables)
    return Ahead(_chosen(known, split, scenes, limit))


def require_root(root: str, tables: str | None, out: Path, scenes: Sequence[str] | None = None) -> Ahead:
    """Refuse a data set that there is not, or scenes that are not in it, whatever the split; as `require_data`."""
    from benchmark.datasets.listing import listed_scenes
    from benchmark.machine.workspace import DEMONSTRATED, EMBEDDED

    if root == EMBEDDED:
        return _embedded("val", out, scenes, None)
    folder = api.workspace(out).demonstrated("val") if root == DEMONSTRATED else Path(root)
    return Ahead(_chosen(listed_scenes(folder, version=tables), None, scenes, None))


def unchanged_name(root: str | None, out: Path) -> str | None:
    """Name of the data set of ``--unchanged``, in records; refused where there is none."""
    from benchmark.machine.workspace import DEMONSTRATED, EMBEDDED

    if root is None:
        return None
    require_root(root, None, out)
    return root if root in (EMBEDDED, DEMONSTRATED) else Path(root).resolve().name


def _embedded(split: str, out: Path, scenes: Sequence[str] | None, limit: int | None) -> Ahead:
    """The embedded data set, of which everything is known before it is built."""
    from benchmark.datasets.listing import listed_scenes
    from benchmark.machine.workspace import EMBEDDED, GENERATED_SPLITS, cache_root, how_generated, is_finished
    from benchmark.records.seed_splits import seed_of
    from generation.sources.mini import TownSettings
    from generation.sources.town.scenes import town_scene_names
    from generation.splits.packaged import newest_split

    splits = ("val", *GENERATED_SPLITS)
    if seed_of(split) is not None and not is_finished(made_by_seed := api.workspace(out).split_root(EMBEDDED, split)):
        raise InputError(
            f"split {split!r} of {EMBEDDED} is not at {made_by_seed}; make it with: challenger-bench generate "
            f"{how_generated(split)} --out {out}"
        )
    if seed_of(split) is None and split not in splits:
        raise InputError(
            f"the embedded data set mini has no split {split!r}; {did_you_mean(split, splits)}it has "
            f"{', '.join(splits)}"
        )
    settings, made = TownSettings(), api.workspace(out).split_root(EMBEDDED, split)
    root, recorded = cache_root() / settings.folder_name(EMBEDDED), town_scene_names("val", settings.val_scenes)
    builds = []
    if not is_finished(root):
        needed = town_bytes(settings.val_scenes, frames="keyframes")
        require_place(root, "CHALLENGER_BENCH_CACHE")
        require_room(root, needed, "the embedded data set", "CHALLENGER_BENCH_CACHE")
        builds.append(f"the embedded data set in {root} (once, about a minute, {gigabytes(needed)})")
    if split == "val":
        return Ahead(_chosen(recorded, split, scenes, limit), tuple(builds))
    if is_finished(made):
        return Ahead(_chosen(listed_scenes(made, split), split, scenes, limit), tuple(builds))
    if split == "adv":
        frozen = newest_split(EMBEDDED)
        builds += _frozen_ahead(frozen)
        made_names = tuple(sorted(scene.name for scene in frozen.frozen.scenes))
        return Ahead(_chosen(made_names, split, scenes, limit), tuple(builds))
    needed = town_bytes(len(recorded))
    require_place(made, "--out")
    require_room(made, needed, f"split {split} of the embedded data set", "--out")
    builds.append(f"split {split} of it in {made} (once, some minutes, {gigabytes(needed)})")
    return Ahead(_chosen(recorded, split, scenes, limit), tuple(builds))


def _frozen_ahead(newest: "NamedSplit") -> list[str]:
    """A frozen split of the embedded data set, where it is not built yet."""
    from benchmark.machine.workspace import cache_root, is_finished

    # What else its folder's name is made of is known once the recordings are there.
    if any(is_finished(root) for root in cache_root().glob(f"{newest.name}-*")):
        return []
    needed = town_bytes(len(newest.frozen.scenes), frames="keyframes")
    require_place(cache_root(), "CHALLENGER_BENCH_CACHE")
    require_room(cache_root(), needed, f"the frozen split {newest.name}", "CHALLENGER_BENCH_CACHE")
    return [f"the frozen split {newest.name} in {cache_root()} (once, about two minutes, {gigabytes(needed)})"]


def _require_not_rejected(scenes: Sequence[str] | None, review: "SplitReview", where: Path) -> None:
    from benchmark.records.review import require_not_rejected

    require_not_rejected(scenes or (), review.rejected, str(where))


def _chosen(
    known: tuple[str, ...], split: str | None, scenes: Sequence[str] | None, limit: int | None
) -> tuple[str, ...]:
    unknown = sorted(set(scenes or ()) - set(known))
    if unknown:
        where = "there is" if split is None else f"split {split!r} has"
        raise InputError(
            f"{where} no scene {', '.join(unknown[:3])}{' ...' if len(unknown) > 3 else ''}; "
            f"{did_you_mean(unknown[0], known)}it has {counted(len(known), 'scene')}, among them {', '.join(known[:3])}"
        )
    if not known:
        raise InputError(f"split {split!r} has no scene that could be used: inspectors rejected all, or it has none")
    wanted = known if scenes is None else tuple(name for name in known if name in set(scenes))
    if not wanted:
        raise InputError("--scenes names no scene; leave it out or name one")
    return wanted[:limit]
