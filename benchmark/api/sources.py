"""Data sets by name: what is known of one before it is opened or built, and the data set itself when it is needed."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.api.opening import DEFAULT_IMAGE_SIZE, OUT, open_data, open_split, worker_count, workspace
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.path_checks import format_gigabytes, require_place, require_room
from benchmark.report.words import format_options, pluralise

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.datasets.schema import FaultList
    from generation.splits.packaged import NamedSplit


class NoSuchSceneError(InputError):
    """A split has no scene of a name."""


def select_matching_options(target: type, options: Any) -> dict[str, Any]:
    """Values of those options that are called as fields of a dataclass."""
    return {field.name: getattr(options, field.name) for field in fields(target) if hasattr(options, field.name)}


_BYTES_OF_A_PIXEL: Final = 0.22
"""Of the embedded town's images, with their rows in the tables: 0.36 GB for 10 scenes at 448 x 256."""
_IMAGES_OF_A_SCENE: Final = {"all": 241 * 6, "keyframes": 41 * 6}
"""Of 20 s, six cameras."""


@dataclass(frozen=True, slots=True)
class SourcePreview:
    """Scenes that a command will take, and what has to be built first, for people: what, where, how long, how large."""

    scenes: tuple[str, ...]
    builds: tuple[str, ...] = ()

    def plan(self, then: str) -> tuple[str, ...]:
        """Text of ``--dry-run`` where something has to be built first."""
        return (*(f"would first build {build}" for build in self.builds), f"would then {then}")

    def counted(self) -> str:
        """How many scenes, for people."""
        return pluralise(len(self.scenes), "scene")


@dataclass(frozen=True, slots=True)
class DataSource:
    """A data set (``mini``, ``demo`` or a root) that is checked at once and opened, or built, when it is needed.

    ``workers`` processes build what is absent, 0 takes all processors. ``categories`` says what those mean that are not
    nuScenes', ``driving_side`` to which side traffic keeps, ``left`` or ``right``, ``cameras`` which of these is which
    view.
    """

    data: str
    tables: str | None = None
    out: Path = OUT
    workers: int = 0
    categories: str | None = None
    driving_side: str | None = None
    cameras: str | None = None

    def __post_init__(self) -> None:
        worker_count(self.workers)
        if (self.categories, self.cameras) != (None, None):
            from benchmark.datasets.categories import read_names

            read_names(self.categories, self.cameras)

    @classmethod
    def of(cls, options: Any, **others: Any) -> "DataSource":
        """Data set that options of a command name, as ``data`` or ``root``; ``others`` take the place of options."""
        root = {"data": options.root} if hasattr(options, "root") else {}
        return cls(**{**root, **select_matching_options(cls, options), **others})

    def open(self, *, sweeps: bool = False, rates: "FaultList | None" = None) -> "DataSet":
        """Open it; arguments and errors as in `benchmark.api.open_data`."""
        opened = open_data(
            self.data,
            tables=self.tables,
            workers=self.workers,
            out=self.out,
            rates=rates,
            sweeps=sweeps,
            categories=self.categories,
            cameras=self.cameras,
        )
        return self._with_side(opened)

    def _with_side(self, data: "DataSet") -> "DataSet":
        if self.driving_side is None:
            return data
        from benchmark.road_map import Handedness

        return data.with_driving_side(Handedness(self.driving_side))

    def open_split(self, split: str, source: "DataSet | None" = None) -> "DataSet":
        """Open a split of it, whose data set may be open already; errors as in `benchmark.api.open_split`."""
        return self._with_side(open_split(source or self.open(), split, self.out, workers=self.workers))

    def require(self, scenes: Sequence[str] | None = None) -> SourcePreview:
        """Refuse an unknown data set, or scenes that are not in it; as `require_split` for any split."""
        if self._is_mini:
            return _preview_embedded(self.name, "val", self.out, scenes, None)
        return SourcePreview(_choose_scenes(self._listed(None), None, self.name_scenes(scenes), None))

    def require_source(
        self, split: str, scenes: Sequence[str] | None = None, limit: int | None = None
    ) -> SourcePreview:
        """Refuse what nothing can be generated from; as `require_split`, with scenes that may be of any split."""
        if self._is_mini:
            if split != "val":
                raise InputError(f"the embedded data set {self.name} has no split {split!r}; its only split is val")
            return _preview_embedded(self.name, "val", self.out, scenes, limit)
        of_split, scenes = self._listed(split), self.name_scenes(scenes)
        return SourcePreview(_choose_scenes(of_split if scenes is None else self._listed(None), split, scenes, limit))

    def require_split(self, split: str, scenes: Sequence[str] | None = None, limit: int | None = None) -> SourcePreview:
        """Scenes of a split that is there or will be built (generated ones of the embedded data), and the builds.

        A missing data set, split or scene is refused, and a build without room or right.
        """
        from benchmark.datasets.tables import find_variant_folders, find_version
        from benchmark.machine.workspace import format_generate_options, is_finished, is_generated

        if self._is_mini:
            return _preview_embedded(self.name, split, self.out, scenes, limit)
        name = Path(self.data).resolve().name
        split_folder = workspace(self.out).split_root(name, split)
        is_built = is_generated(split) and is_finished(split_folder)
        if not is_built and not find_variant_folders(self._root):
            find_version(self._root, self.tables)
        # Slow to import; what is no data set is refused before.
        from benchmark.datasets.scene_names import resolve_names_below
        from benchmark.datasets.split_names import NoSuchSplitError
        from benchmark.datasets.statistics import list_scenes

        scenes = resolve_names_below(split_folder if is_built else self._root, scenes)
        if is_built:
            _require_not_rejected(scenes, split_folder, split)
            return SourcePreview(_choose_scenes(list_scenes(split_folder, split), split, scenes, limit))
        all_scenes = self._listed(None)
        try:
            of_split = self._listed(split)
            _require_not_rejected(scenes, self._root, split, self.tables)
        except NoSuchSplitError as error:
            if is_generated(split.lower()) and split != split.lower():
                raise InputError(f"{name} has no split {split!r}; did you mean {split.lower()}?") from error
            if not is_generated(split) or not all_scenes:
                raise
            names = {"categories": self.categories, "cameras": self.cameras}
            given = format_options(data=self.data, tables=self.tables, **names)
            raise NoSuchSplitError(
                f"split {split!r} of {name} is missing at {split_folder}; build it with: challenger-bench generate"
                f"{given} {format_generate_options(split)}{format_options(out=self.out)}",
                error.available,
            ) from error
        return SourcePreview(_choose_scenes(of_split, split, scenes, limit))

    def require_room_to_draw(self, split: str, *, scenes: int, size: tuple[int, int], frames: str) -> None:
        """Refuse a split of ``scenes`` or more that the disk has no room for, where none of it has been made yet."""
        folder = workspace(self.out).split_root(Path(self.data).resolve().name, split)
        if not folder.exists():
            require_room(folder, estimate_town_bytes(scenes, size, frames), f"split {split}", "--out")

    @property
    def name(self) -> str:
        """Its name in records."""
        if self._is_mini:
            from generation.sources.embedded import find_town

            return find_town(self.data).name
        return self.data if self.is_embedded else Path(self.data).resolve().name

    @property
    def is_embedded(self) -> bool:
        """Whether it is made here: ``mini``, ``mini@1`` or ``demo``."""
        from benchmark.machine.workspace import is_embedded_name

        return is_embedded_name(self.data)

    @property
    def _is_mini(self) -> bool:
        from benchmark.machine.workspace import read_embedded_version

        return read_embedded_version(self.data) is not None

    @property
    def _root(self) -> Path:
        from benchmark.machine.workspace import DEMONSTRATED

        return workspace(self.out).demonstrated("val") if self.data == DEMONSTRATED else Path(self.data)

    def name_scenes(self, scenes: Sequence[str] | None, split: str | None = None) -> tuple[str, ...] | None:
        """Scenes by their names, given by these or by those in the tables, of a generated split if it is built."""
        from benchmark.datasets.scene_names import resolve_names_below

        named = resolve_names_below(self._root, scenes)
        return named if split is None else resolve_names_below(workspace(self.out).split_root(self.name, split), named)

    def _listed(self, split: str | None) -> tuple[str, ...]:
        """Names of scenes as the tables have them, without opening the data set."""
        from benchmark.datasets.statistics import list_scenes

        return list_scenes(self._root, split, version=self.tables)


def estimate_town_bytes(scenes: int, size: tuple[int, int] = DEFAULT_IMAGE_SIZE, frames: str = "all") -> int:
    """How much of a disk scenes take with schematic images of a size (width, height), about."""
    return round(scenes * _IMAGES_OF_A_SCENE[frames] * size[0] * size[1] * _BYTES_OF_A_PIXEL)


def _preview_embedded(
    name: str, split: str, out: Path, scenes: Sequence[str] | None, limit: int | None
) -> SourcePreview:
    """The embedded data set, of which everything is known before it is built."""
    from benchmark.machine.workspace import GENERATED_SPLITS, cache_root, format_generate_options, is_finished
    from benchmark.records.seed_splits import RECORDED_EGO, parse_ego, parse_seed

    splits = ("val", *GENERATED_SPLITS)
    is_searched = parse_seed(split) is not None or parse_ego(split) != RECORDED_EGO
    if is_searched and not is_finished(made := workspace(out).split_root(name, split)):
        raise InputError(
            f"split {split!r} of {name} is missing at {made}; build it with: challenger-bench generate "
            f"{format_generate_options(split)}{format_options(out=out)}"
        )
    if not is_searched and split not in splits:
        raise InputError(
            f"the embedded data set {name} has no split {split!r}; {did_you_mean(split, splits)}it has "
            f"{', '.join(splits)}"
        )
    # Slow to import; a split of another name is refused before.
    from benchmark.datasets.scene_names import resolve_names_below
    from benchmark.datasets.statistics import list_scenes
    from generation.sources.embedded import find_town
    from generation.splits.packaged import read_newest_split

    town, split_folder = find_town(name), workspace(out).split_root(name, split)
    root, recorded = cache_root() / town.folder_name(), town.scene_names()
    builds = []
    if not is_finished(root):
        needed = estimate_town_bytes(len(recorded), frames="keyframes")
        require_place(root, "CHALLENGER_BENCH_CACHE")
        require_room(root, needed, "the embedded data set", "CHALLENGER_BENCH_CACHE")
        builds.append(f"the embedded data set in {root} (once, about a minute, {format_gigabytes(needed)})")
    if split == "val":
        return SourcePreview(_choose_scenes(recorded, split, scenes, limit), tuple(builds))
    if is_finished(split_folder):
        scenes = resolve_names_below(split_folder, scenes)
        return SourcePreview(_choose_scenes(list_scenes(split_folder, split), split, scenes, limit), tuple(builds))
    if split == "adv":
        frozen = read_newest_split(name)
        builds += _list_frozen_builds(frozen)
        made_names = tuple(sorted(scene.name for scene in frozen.frozen.scenes))
        return SourcePreview(_choose_scenes(made_names, split, scenes, limit), tuple(builds))
    needed = estimate_town_bytes(len(recorded))
    require_place(split_folder, "--out")
    require_room(split_folder, needed, f"split {split} of the embedded data set", "--out")
    builds.append(f"split {split} of it in {split_folder} (once, takes a few minutes, {format_gigabytes(needed)})")
    return SourcePreview(_choose_scenes(recorded, split, scenes, limit), tuple(builds))


def _list_frozen_builds(newest: "NamedSplit") -> list[str]:
    """A frozen split of the embedded data set, where it is not built yet."""
    from benchmark.machine.workspace import cache_root, is_finished

    # The rest of its folder's name is known only once the recordings exist.
    if any(is_finished(root) for root in cache_root().glob(f"{newest.name}-*")):
        return []
    needed = estimate_town_bytes(len(newest.frozen.scenes), frames="keyframes")
    require_place(cache_root(), "CHALLENGER_BENCH_CACHE")
    require_room(cache_root(), needed, f"the frozen split {newest.name}", "CHALLENGER_BENCH_CACHE")
    return [f"the frozen split {newest.name} in {cache_root()} (once, about two minutes, {format_gigabytes(needed)})"]


def _require_not_rejected(scenes: Sequence[str] | None, where: Path, split: str, version: str | None = None) -> None:
    from benchmark.datasets.statistics import read_split_review
    from benchmark.records.review import require_not_rejected

    require_not_rejected(scenes or (), read_split_review(where, split, version=version).rejected, str(where))


def _choose_scenes(
    known: tuple[str, ...], split: str | None, scenes: Sequence[str] | None, limit: int | None
) -> tuple[str, ...]:
    unknown = sorted(set(scenes or ()) - set(known))
    if unknown:
        where = "there is" if split is None else f"split {split!r} has"
        raise NoSuchSceneError(
            f"{where} no scene {', '.join(unknown[:3])}{' ...' if len(unknown) > 3 else ''}; "
            f"{did_you_mean(unknown[0], known)}it has {pluralise(len(known), 'scene')}, among them "
            f"{', '.join(known[:3])}"
        )
    if not known:
        raise InputError(f"split {split!r} has no usable scenes: it is empty, or inspectors rejected all of them")
    wanted = known if scenes is None else tuple(name for name in known if name in set(scenes))
    if not wanted:
        raise InputError("--scenes is empty; leave it out or name at least one scene")
    return wanted[:limit]
