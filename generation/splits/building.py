"""Building a frozen split from the recordings: no search, no diffusion model, the same split on every machine."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, lock_folder, read_cached_json, write_json
from benchmark.records.review import REJECTED, StandingVerdict
from benchmark.records.scene_assessment import SceneAssessment, is_unsolvable
from benchmark.records.seed_splits import RECORDED_EGO, parse_seed
from benchmark.report.words import pluralise, spell_name
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, SourceInfo
from generation.nuscenes_writer.plan import STATE_FOLDER
from generation.nuscenes_writer.scenes import read_stored_fragment
from generation.pipeline.estimate import WorkEstimate, count_workers, estimate_rendering
from generation.pipeline.settings import BuildSettings
from generation.pipeline.writing import WritingJob, WrittenScenes, publish, publish_reports, write_scenes
from generation.search.adversary import ALGORITHM_VERSION
from generation.search.verify import count_masked_steps, format_masked_steps, sum_masked_steps
from generation.splits.format import EDITED, FrozenScene, ImageMetadata
from generation.splits.packaged import NamedSplit, compute_search_hash, require_seed, require_town
from generation.splits.tracks import (
    add_frozen_adversaries,
    build_scene_report,
    build_tracks,
    compute_tables_digest,
    compute_written_digest,
    find_number,
    parse_image_facts,
)

_MARK: Final = "frozen.json"
"""In the writer's own folder: which frozen split a root is built from."""


@dataclass(frozen=True, slots=True)
class FrozenBuildReport:
    """Report of a built frozen split; the scenes are ``written`` most challenging first.

    ``other_tables`` and ``other_images`` are scenes that differ from the frozen ones; ``images`` is the renderer of the
    frozen hashes, if the images here could be compared. Scenes are not verified anew: ``verified_by`` is the version of
    the search that did. ``unsolvable`` ones (``docs/severity.md``) are kept as frozen; ``masked_steps`` is as in
    `BuildReport`; ``faults`` in the motion of adversaries are of edited scenes, which are not verified.
    """

    name: str
    content: str
    scenes: int
    written: tuple[str, ...]
    other_tables: tuple[str, ...] = ()
    images: ImageMetadata | None = None
    other_images: tuple[str, ...] = ()
    verified_by: str = ALGORITHM_VERSION
    unsolvable: tuple[str, ...] = ()
    masked_steps: dict[str, dict[str, int]] = field(default_factory=dict)
    estimate: WorkEstimate | None = None
    split: str = "adv"
    faults: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The report as JSON values."""
        compared = self.images is not None
        return {
            **self.kept(),
            "other_tables": list(self.other_tables),
            "other_images": list(self.other_images) if compared else None,
            "verified_by": self.verified_by,
            "unsolvable": list(self.unsolvable),
            "masked_steps": self.masked_steps,
            "dry_run": self.estimate is not None,
            **({"faults": {name: list(names) for name, names in self.faults.items()}} if self.edited else {}),
        }

    @property
    def edited(self) -> bool:
        """Whether the scenes come from edited files, and not from a search."""
        return self.verified_by == EDITED

    def kept(self) -> dict[str, Any]:
        """Content of ``report.json``: all that does not depend on the machine."""
        return {
            "split": self.split,
            "frozen": {"name": self.name, "content": self.content},
            "scenes": self.scenes,
            "written": list(self.written),
        }

    def summary(self, *, verbose: bool = False) -> str:
        """A few lines for people; if ``verbose`` masked steps, too."""
        count = len(self.written)
        if self.estimate is not None:
            return (
                f"would build {pluralise(count, 'scene')} of frozen split {self.name} from "
                f"{pluralise(self.scenes, 'recorded scene')}; {self.estimate.sentence()}; nothing was written"
            )
        tables = (
            "equal to the frozen ones"
            if not self.other_tables
            else f"differ in {len(self.other_tables)} of {pluralise(count, 'scene')}, "
            "because the recordings here differ"
        )
        masked = f"  {format_masked_steps(self.masked_steps)}\n" if verbose else ""
        return (
            f"{pluralise(count, 'scene')} built from {'the edited' if self.edited else 'frozen split'} {self.name}, "
            f"{pluralise(self.scenes, 'recorded scene')}\n"
            f"  tables: {tables}\n  images: {self._images(count)}\n{masked}"
            f"  unavoidable scenes: {len(self.unsolvable)}, kept as frozen" + self._format_verification()
        )

    def _format_verification(self) -> str:
        """Remark where a search would verify by other rules today."""
        if self.verified_by == ALGORITHM_VERSION:
            return ""
        if self.edited:
            wrong = "; ".join(f"{name}: {spell_name(', '.join(names))}" for name, names in self.faults.items() if names)
            return f"\n  edited and not verified; faults of motion (docs/realism.md): {wrong or 'none'}"
        return (
            f"\n  verified by version {self.verified_by} of the search, as frozen; today's search verifies by version "
            f"{ALGORITHM_VERSION} (docs/frozen-splits.md)"
        )

    def _images(self, count: int) -> str:
        if self.images is None:
            return "not compared, because the frozen split has no hashes of such images"
        if not self.other_images:
            return "equal to the frozen ones"
        why = "the recordings here differ" if self.other_tables else "the renderer rounds differently here"
        return f"differ in {len(self.other_images)} of {count} scenes, because {why}"


def build_frozen(
    source: DataSet, split: NamedSplit, settings: BuildSettings, *, as_split: str = "adv"
) -> FrozenBuildReport:
    """Build a frozen split from its recordings; the same command resumes.

    Args:
        source: The recordings.
        split: The frozen split (`generation.splits.packaged.read_frozen_split`).
        settings: Settings of the build; those of the search are ignored.
        as_split: Name of the split that is written: ``adv``, or that of the seed with which it was searched.

    Returns:
        Report of the build, with differences from the frozen scenes.

    Raises:
        InputError: If these are other recordings, a scene is unknown, the output holds a split that was searched or is
            of another frozen one, another command is writing there, or it cannot be written.
    """
    plan, chosen, report = require_rebuildable(source, split, settings, as_split)
    if settings.dry_run:
        recorded = min(frozen.source for frozen, _ in chosen)
        scene_s = estimate_rendering(plan.renderer, source.scene(recorded), plan.frames, settings.timing / "rendering")
        workers = count_workers(settings.where_rendered)
        return replace(report, estimate=WorkEstimate(0, 0.0, len(chosen), scene_s, workers, workers))
    # Everything is checked before anything is written.
    jobs, tables, masked = build_frozen_jobs(source, plan, chosen, split)
    with lock_folder(settings.out):
        write_json(plan.state / _MARK, {"name": split.name, "content": report.content})
        publish_reports(settings.out, build_report_files(report))
        keys = write_scenes(
            plan,
            jobs,
            source.scene,
            settings.where_rendered,
            timing=settings.timing / "rendering",
            label="rendering",
        )
        written = WrittenScenes(plan, jobs, keys, source)
        publish(written)
        judged = written.judged
        images, other_images = _find_other_images(plan, split.frozen.images, chosen, keys)
    other = tuple(frozen.name for (frozen, _), digest in zip(chosen, tables, strict=True) if digest != frozen.tables)
    return replace(
        report,
        other_tables=other,
        images=images,
        other_images=other_images,
        verified_by=split.frozen.search.algorithm,
        masked_steps=masked,
        unsolvable=tuple(job.name for job, assessments in zip(jobs, judged, strict=True) if is_unsolvable(assessments)),
        faults=_list_faults(jobs, judged) if split.frozen.search.algorithm == EDITED else {},
    )


def require_rebuildable(
    source: DataSet, split: NamedSplit, settings: BuildSettings, as_split: str
) -> tuple[DataSetPlan, list[tuple[FrozenScene, int]], FrozenBuildReport]:
    """Refuse as `build_frozen`; gives the data set to write, scenes with numbers of their variants, and the report."""
    require_seed(as_split, split.frozen.search.seed, f"frozen split {split.name}")
    require_town(split, source.name)
    chosen = split.chosen(settings.scenes, settings.limit)
    content = split.frozen.content_id
    recorded = sorted({frozen.source for frozen, _ in chosen})
    _require_recorded(source, recorded)
    _require_free_root(settings.out, split.name, content)
    report = FrozenBuildReport(
        split.name, content, len(recorded), tuple(frozen.name for frozen, _ in chosen), split=as_split
    )
    return _build_plan(source, split, as_split, settings), chosen, report


def build_report_files(report: FrozenBuildReport) -> dict[str, bytes]:
    """Reports of a build from a frozen split, by file name."""
    return {"report.json": (canonical_json(report.kept(), indent=1) + "\n").encode()}


def _list_faults(jobs: Sequence[WritingJob], judged: Sequence[Sequence[SceneAssessment]]) -> dict[str, tuple[str, ...]]:
    faults: dict[str, tuple[str, ...]] = {}
    for job, assessments in zip(jobs, judged, strict=True):
        names = {
            name for assessment in assessments if assessment.faults is not None for name in assessment.faults.found
        }
        faults[job.name] = tuple(sorted(names))
    return faults


def require_not_frozen(root: Path) -> None:
    """Refuse to search in a root that is built from a frozen split."""
    mark = root / STATE_FOLDER / _MARK
    if mark.exists():
        stored = read_cached_json(mark)
        name = stored.get("name") if isinstance(stored, dict) else None
        raise InputError(
            f"{root} was built from the frozen split {name}; search into another --out, nothing was changed"
        )


def _require_free_root(root: Path, name: str, content: str) -> None:
    """Refuse a root that was searched in, or that is built from another frozen split."""
    state = root / STATE_FOLDER
    if (root / "search.json").exists() or (state / "attempts").exists() or (state / "surveys").exists():
        raise InputError(f"{root} holds the results of a search; build {name} in another --out, nothing was changed")
    stored = read_cached_json(state / _MARK)
    if isinstance(stored, dict) and stored.get("content") != content:
        raise InputError(
            f"{root} was built from another frozen split ({stored.get('name')}); build {name} in another --out, "
            "nothing was changed"
        )


def _require_recorded(source: DataSet, recorded: Sequence[str]) -> None:
    missing = sorted(set(recorded) - set(source.scene_names(None)))
    if missing:
        raise InputError(
            f"{source.name} lacks {len(missing)} of the {len(recorded)} recorded scenes that the frozen split needs, "
            f"the first is {missing[0]}; choose the recordings that it was made from with --data, or fewer scenes with "
            "--scenes"
        )


def _build_plan(source: DataSet, split: NamedSplit, as_split: str, settings: BuildSettings) -> DataSetPlan:
    name, content, frozen = split.name, split.frozen.content_id, split.frozen
    adversaries = max(len(scene.adversaries) for scene in frozen.scenes)
    of_seed = parse_seed(as_split) is not None
    return DataSetPlan(
        root=settings.out,
        version=settings.version,
        split=as_split,
        layout=settings.layout,
        renderer=settings.renderer,
        frames=settings.frames,
        jpeg_quality=settings.jpeg_quality,
        lossless=settings.lossless,
        source=SourceInfo.of(source),
        frozen=(name, content),
        search=compute_search_hash(frozen.search, frozen.chosen, adversaries) if of_seed else None,
        panel=frozen.chosen.panel or "",
        ego=frozen.search.ego or RECORDED_EGO,
        left_out=tuple(
            (0, StandingVerdict(rejection.name, rejection.token, REJECTED, rejection.reason))
            for rejection in split.frozen.chosen.rejected or ()
        ),
    )


def build_frozen_jobs(
    source: DataSet, plan: DataSetPlan, chosen: Sequence[tuple[FrozenScene, int]], split: NamedSplit
) -> tuple[list[WritingJob], list[str], dict[str, dict[str, int]]]:
    """Jobs of scenes with the numbers of their variants, hashes of their tables, and masked steps of all scenes."""
    built: dict[int, tuple[WritingJob, str]] = {}
    masked = []
    for index in sorted(range(len(chosen)), key=lambda index: (chosen[index][0].source, index)):
        frozen, variant = chosen[index]
        try:
            scene: Scene = add_frozen_adversaries(frozen, source.scene(frozen.source))
        except InputError as error:
            raise InputError(f"frozen split {split.path or split.name}: {error}") from error
        job = WritingJob(
            name=frozen.name,
            written_as=frozen.source if plan.layout == "per-variant" else frozen.name,
            source_scene=frozen.source,
            variant=variant,
            make=partial(add_frozen_adversaries, frozen),
            report=build_scene_report(frozen, scene, split.frozen.search.seed),
            identity=frozen.identity,
            tracks=build_tracks(frozen),
            number=None if plan.layout == "per-variant" else find_number(frozen),
        )
        built[index] = job, compute_tables_digest(plan, scene, frozen)
        masked.append(count_masked_steps(scene))
    order = range(len(chosen))
    return [built[index][0] for index in order], [built[index][1] for index in order], sum_masked_steps(masked)


def _find_other_images(
    plan: DataSetPlan, frozen: ImageMetadata | None, chosen: Sequence[tuple[FrozenScene, int]], keys: Sequence[str]
) -> tuple[ImageMetadata | None, tuple[str, ...]]:
    """The compared images, and the scenes whose images are not those that were frozen."""
    other = []
    for (scene, _), key in zip(chosen, keys, strict=True):
        fragment = read_stored_fragment(plan, key)
        assert fragment is not None, "finishing read it"
        row = fragment["renderer"]
        if frozen is None or row is None or parse_image_facts(row, plan.jpeg_quality) != frozen:
            return None, ()
        if scene.images is None or compute_written_digest(plan, fragment) != scene.images:
            other.append(scene.name)
    return frozen, tuple(other)
