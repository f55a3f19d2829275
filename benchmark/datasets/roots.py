"""Interface of a data set, and data sets that lie in several roots.

Official model code accepts only original scene names, so several adversarial variants of one scene need several
complete nuScenes roots side by side, ``v0/``, ``v1/``, ...: one data set whose scenes are ``v0/scene-0061``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, Self

from benchmark.datasets.annotated_objects import AnnotationCount
from benchmark.datasets.categories import CategoryNames
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.schema import FaultList
from benchmark.datasets.split_reviews import join_reviews, scene_tokens
from benchmark.datasets.tables import find_variant_folders
from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.planning import CameraView, Observation
from benchmark.records.review import SplitReview, read_review
from benchmark.records.run_schema import SceneFacts
from benchmark.road_map import Handedness
from benchmark.scene import Scene
from benchmark.truth import SampleTruth


class DataSet(Protocol):
    """Scenes, observations and truth by scene name; `NuScenesData` says what each method promises.

    Attributes:
        root: Root folder.
        version: Version folder.
        name: Shown in tables.
    """

    root: Path
    version: str
    name: str

    @property
    def categories(self) -> CategoryNames:
        """Names of categories that were replaced, and what by."""

    def with_categories(self, categories: CategoryNames) -> "DataSet":
        """The same with other names of categories replaced."""

    @property
    def driving_side(self) -> Handedness | None:
        """Side that traffic keeps to, as the user stated."""

    def with_driving_side(self, side: Handedness | None) -> "DataSet":
        """The same where traffic keeps to a side."""

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        """Number of annotations of scenes, and of those of no category of nuScenes, by name."""

    def splits(self) -> dict[str, tuple[str, ...]]:
        """Custom splits."""

    def split_names(self) -> tuple[str, ...]:
        """Names of all splits, whether `scene_names` takes them or says what is wrong with them."""

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        """Sorted names of the scenes of a split, less those that inspectors rejected, or of all."""

    def review(self, split: str | None = None) -> SplitReview:
        """Verdicts of inspectors on a split, or on all scenes."""

    def scene(self, name: str) -> Scene:
        """One scene."""

    def observations(self, name: str) -> Iterator[Observation]:
        """One observation a sample, in time order."""

    def videos(self, name: str, *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
        """Camera images by camera name, in time order."""

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        """One truth a sample, in time order."""

    def keyframe_rows(self, name: str) -> dict[str, str]:
        """Sample tokens of a scene by the tokens of their keyframe rows in ``sample_data.json``."""

    def has_map(self, name: str) -> bool:
        """Whether the scene's location has a vector map."""

    def has_lidar(self, name: str) -> bool:
        """Whether the tables say where the scene's lidar sits."""

    def fingerprint(self) -> str:
        """Content hash."""

    def provenance(self) -> dict[str, Any] | None:
        """Report on how the data set was made, if it has one."""

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        """Source of scenes, their manoeuvres and judgements, by name."""


class VariantRoots:
    """Several roots ``v0/``, ``v1/``, ... presented as one data set; ``version`` is that of the first root."""

    def __init__(self, root: Path, name: str, variants: dict[str, NuScenesData]) -> None:
        self.root = root
        self.name = name
        self.version = next(iter(variants.values())).version
        self.categories = tuple(sorted({pair for data in variants.values() for pair in data.categories}))
        self.driving_side = next(iter(variants.values())).driving_side
        self._variants = variants
        self._verdicts = read_review(root)

    @classmethod
    def open(
        cls,
        root: Path,
        *,
        version: str | None = None,
        name: str | None = None,
        rates: FaultList | None = None,
        categories: Mapping[str, str] | None = None,
    ) -> Self:
        """Open every variant; the settings are those of `NuScenesData.open`, the name the folder's by default."""
        variants = {
            folder: NuScenesData.open(root / folder, version=version, rates=rates, categories=categories)
            for folder in find_variant_folders(root)
        }
        if not variants:
            raise InputError(f"{root} holds no variants (v0/, v1/, ...); give the folder that contains them")
        return cls(root, name or root.resolve().name, variants)

    def with_categories(self, categories: CategoryNames) -> Self:
        """The same roots with other names of categories replaced."""
        variants = {folder: data.with_categories(categories) for folder, data in self._variants.items()}
        return type(self)(self.root, self.name, variants)

    def with_driving_side(self, side: Handedness | None) -> Self:
        """The same roots where traffic keeps to a side."""
        variants = {folder: data.with_driving_side(side) for folder, data in self._variants.items()}
        return type(self)(self.root, self.name, variants)

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        """Number of annotations of scenes, and of those of no category of nuScenes, by name."""
        counts = {}
        for name in names:
            data, inner = self._find(name)
            counts[name] = data.annotation_counts([inner])[inner]
        return counts

    def splits(self) -> dict[str, tuple[str, ...]]:
        """Custom splits of all variants together, scene names by split."""
        merged: dict[str, tuple[str, ...]] = {}
        for folder, data in self._variants.items():
            for split, names in data.splits().items():
                merged[split] = (*merged.get(split, ()), *(f"{folder}/{name}" for name in names))
        return merged

    def split_names(self) -> tuple[str, ...]:
        """Names of the splits of any variant."""
        return tuple(sorted({name for data in self._variants.values() for name in data.split_names()}))

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        """Names of the scenes of a split, or of all; variants in order, sorted within each."""
        names = tuple(f"{folder}/{name}" for folder, data in self._variants.items() for name in data.scene_names(split))
        return names if split is None or not self._verdicts else self.review(split).kept(names)

    def review(self, split: str | None = None) -> SplitReview:
        """Verdicts on a split, or on all scenes, beside the variants and beside all of them together."""
        parts = {folder: data.review(split) for folder, data in self._variants.items()}
        of_split = {name for folder, part in parts.items() for name in part.under(folder).named}
        tokens = {name: token for name, token in self._tokens().items() if name in of_split}
        return join_reviews(parts, self._verdicts, tokens)

    def _tokens(self) -> dict[str, str]:
        tokens_of_variants = {folder: scene_tokens(data.root, data.version) for folder, data in self._variants.items()}
        return {
            f"{folder}/{name}": token for folder, part in tokens_of_variants.items() for name, token in part.items()
        }

    def scene(self, name: str) -> Scene:
        """One scene, called by its prefixed name."""
        data, inner = self._find(name)
        return replace(data.scene(inner), name=name)

    def observations(self, name: str) -> Iterator[Observation]:
        """One observation a sample, in time order."""
        data, inner = self._find(name)
        return (replace(observation, scene=name) for observation in data.observations(inner))

    def videos(self, name: str, *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
        """Camera images by camera name, in time order."""
        data, inner = self._find(name)
        return data.videos(inner, sweeps=sweeps)

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        """One truth a sample, in time order."""
        data, inner = self._find(name)
        return tuple(replace(truth, scene=name) for truth in data.truth(inner))

    def keyframe_rows(self, name: str) -> dict[str, str]:
        """Sample tokens of a scene by the tokens of their keyframe rows in ``sample_data.json``."""
        data, inner = self._find(name)
        return data.keyframe_rows(inner)

    def has_map(self, name: str) -> bool:
        """Whether the scene's location has a vector map."""
        data, inner = self._find(name)
        return data.has_map(inner)

    def has_lidar(self, name: str) -> bool:
        """Whether the tables say where the scene's lidar sits."""
        data, inner = self._find(name)
        return data.has_lidar(inner)

    def fingerprint(self) -> str:
        """Content hash of all variants, 64 hexadecimal digits."""
        return content_key("variants", {folder: data.fingerprint() for folder, data in self._variants.items()})

    def provenance(self) -> dict[str, Any] | None:
        """Provenance of the first variant with the scenes of all, or ``None`` if any variant does not say."""
        reports = {folder: data.provenance() for folder, data in self._variants.items()}
        known = {folder: value for folder, value in reports.items() if value is not None}
        if len(known) < len(reports):
            return None
        scenes = {
            f"{folder}/{name}": scene_report
            for folder, value in known.items()
            for name, scene_report in value["scenes"].items()
        }
        return {**next(iter(known.values())), "scenes": scenes}

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        """Source of scenes, their manoeuvres and judgements; the source has no prefix, so that variants share it."""
        facts = {}
        for name in names:
            data, inner = self._find(name)
            facts[name] = data.scene_facts([inner])[inner]
        return facts

    def _find(self, name: str) -> tuple[NuScenesData, str]:
        folder, _, inner = name.partition("/")
        if folder not in self._variants or not inner:
            raise InputError(
                f"{self.root} has no scene {name!r}; its scenes have names such as {next(iter(self.scene_names()))!r}"
            )
        return self._variants[folder], inner


def open_data(
    root: Path,
    *,
    version: str | None = None,
    name: str | None = None,
    rates: FaultList | None = None,
    categories: Mapping[str, str] | None = None,
) -> DataSet:
    """Open a nuScenes-format root, or a folder of variant roots; settings as in `NuScenesData.open`."""
    root = Path(root)
    if find_variant_folders(root):
        return VariantRoots.open(root, version=version, name=name, rates=rates, categories=categories)
    return NuScenesData.open(root, version=version, name=name, rates=rates, categories=categories)
