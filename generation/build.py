"""Building a split: choose vehicles, plan adversaries, keep the most challenging, render and write nuScenes format.

Every step is resumable and gives the same bytes for any number of workers.
"""

import functools
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.storage import only_writer, token, write_json, write_json_lines
from benchmark.workers import map_ordered
from generation.attempts import Search, SourceReference, StoredAttempt, Unit, attempts, candidates_of, packaged_prior
from generation.hyperparameters import HyperParameters
from generation.nuscenes_writer import DataSetPlan, SourceInfo, finish_data_set, write_scene
from generation.ranking import ranked
from generation.rendering import Renderer

Split = Literal["adv", "val-r"]


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """What to build and where.

    Attributes:
        out: Root of the new data set.
        source_split: Split of the source that is used.
        scenes: Names of source scenes to use, ``None`` for all.
        limit: Use only this many source scenes.
        seed: Seed of the choice of vehicles and of the search.
        workers: Processes.
        hyper: Settings of the search.
        weights: Weights of the diffusion model, ``None`` for the packaged ones.
        per_scene: Most adversarial variants kept of one source scene, ``None`` for all.
        total: Most adversarial scenes kept, ``None`` for all.
        renderer: Draws the images, ``None`` for a data set without images.
        layout: One root with suffixed names, or one root per variant with original names.
        frames: Which frames get images and rows.
        version: Version folder that is written.
        jpeg_quality: 1 to 100.
        lossless: PNG instead of JPEG.
        dry_run: Only count the work.
    """

    out: Path
    source_split: str = "val"
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    seed: int = 0
    workers: int = 1
    hyper: HyperParameters = field(default_factory=HyperParameters)
    weights: Path | None = None
    per_scene: int | None = None
    total: int | None = None
    renderer: Renderer | None = None
    layout: Literal["suffixed", "per-variant"] = "suffixed"
    frames: Literal["all", "keyframes"] = "all"
    version: str = "v1.0-trainval"
    jpeg_quality: int = 92
    lossless: bool = False
    dry_run: bool = False


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What was done.

    Attributes:
        split: Split that was built.
        scenes: Source scenes looked at.
        tried: Attempts, one per chosen vehicle.
        finished_before: Attempts that were already on disk (dry run only).
        survived: Attempts that passed verification.
        discarded: Number of attempts by reason.
        written: Names of the scenes written, best first for ``adv``.
        dry_run: Whether the work was only counted.
    """

    split: str
    scenes: int
    tried: int
    finished_before: int
    survived: int
    discarded: dict[str, int]
    written: tuple[str, ...]
    dry_run: bool = False

    def as_json(self) -> dict[str, Any]:
        """The report as JSON values."""
        return {**asdict(self), "written": list(self.written)}

    def summary(self) -> str:
        """One sentence for people."""
        if self.dry_run:
            work = (
                "" if self.split == "val-r" else f", {self.tried} vehicles to try ({self.finished_before} of them done)"
            )
            return f"would build {self.split} from {self.scenes} scenes{work}; nothing was written"
        if self.split == "val-r":
            return f"{len(self.written)} scenes rendered again"
        reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(self.discarded.items())) or "none"
        return (
            f"{self.scenes} scenes, {self.tried} vehicles tried, {self.survived} passed verification "
            f"(discarded: {reasons}), {len(self.written)} scenes written"
        )


def build_split(source: DataSet, split: Split, settings: BuildSettings) -> BuildReport:
    """Build one split of a benchmark from recorded scenes.

    Args:
        source: Recorded scenes.
        split: ``adv`` (adversarial) or ``val-r`` (the originals, rendered again).
        settings: What and where.

    Returns:
        What was done; the same is in ``report.json``, and each attempt in ``attempts.jsonl``, in the output root.

    Raises:
        InputError: If a scene is unknown, nothing survives, another command is writing there, or the output cannot be
            written.
    """
    names = _source_scenes(source, settings)
    reference = SourceReference.of(source)
    if split == "val-r":
        return _build_originals(source, reference, names, settings)
    if split != "adv":
        raise InputError(f"cannot build split {split!r}, choose adv or val-r")
    without_map = [name for name in names if not source.has_map(name)]
    if without_map:
        raise InputError(
            f"{source.root} has no map expansion for {without_map[0]} ({len(without_map)} of {len(names)} scenes), and "
            "an adversary must know the road; put the map expansion's JSON files into maps/expansion"
        )
    units = candidates_of(reference, names, settings.hyper, settings.seed, workers=settings.workers)
    search = Search(
        source=reference,
        fingerprint=source.fingerprint(),
        hyper=settings.hyper,
        seed=settings.seed,
        weights=settings.weights,
        prior_fingerprint=packaged_prior(settings.weights).fingerprint,
        folder=settings.out / ".challenger" / "attempts",
    )
    if settings.dry_run:
        finished = sum(search.path(unit).exists() for unit in units)
        return BuildReport(split, len(names), len(units), finished, 0, {}, (), dry_run=True)
    with only_writer(settings.out):
        return _build_adversarial(source, search, names, units, settings)


def _build_adversarial(
    source: DataSet, search: Search, names: Sequence[str], units: Sequence[Unit], settings: BuildSettings
) -> BuildReport:
    results = list(attempts(search, units, workers=settings.workers))
    survivors = [result for result in results if result.kept]
    discarded = Counter(result.discard for result in results if result.discard is not None)
    kept = ranked(survivors, per_scene=settings.per_scene, total=settings.total)
    jobs = _adversarial_jobs(kept)
    report = BuildReport(
        "adv", len(names), len(units), 0, len(survivors), dict(discarded), tuple(job.name for job in jobs)
    )
    _write_reports(settings.out, report, results)
    if not jobs:
        raise InputError(
            f"no adversarial scene survived: {report.summary()}; try more scenes or another --seed "
            f"(details in {settings.out / 'attempts.jsonl'})"
        )
    _write(source, "adv", search.source, jobs, settings)
    return report


@dataclass(frozen=True, slots=True)
class _WritingJob:
    """One scene to write: the recording, or a variant of it."""

    name: str
    source_scene: str
    variant: int
    stored: StoredAttempt | None


def _source_scenes(source: DataSet, settings: BuildSettings) -> tuple[str, ...]:
    if settings.limit is not None and settings.limit < 1:
        raise InputError(f"--limit must be at least 1, got {settings.limit}")
    if settings.scenes is None:
        names = source.scene_names(settings.source_split)
    else:
        known = set(source.scene_names(None))
        unknown = [name for name in settings.scenes if name not in known]
        if unknown:
            raise InputError(
                f"{source.name} has no scene {', '.join(unknown)}; it has {', '.join(sorted(known)[:8])} ..."
            )
        names = tuple(dict.fromkeys(settings.scenes))
    if not names:
        raise InputError(f"{source.name} has no scenes in split {settings.source_split}")
    return names[: settings.limit]


def _build_originals(
    source: DataSet, reference: SourceReference, names: Sequence[str], settings: BuildSettings
) -> BuildReport:
    jobs = [_WritingJob(name.replace("/", "-"), name, 0, None) for name in names]
    written = () if settings.dry_run else tuple(job.name for job in jobs)
    report = BuildReport("val-r", len(names), 0, 0, 0, {}, written, dry_run=settings.dry_run)
    if not settings.dry_run:
        with only_writer(settings.out):
            _write_reports(settings.out, report, [])
            _write(source, "val-r", reference, jobs, settings)
    return report


def _adversarial_jobs(kept: Sequence[StoredAttempt]) -> list[_WritingJob]:
    """Names that do not depend on the rank, and variant numbers that do (best first)."""
    seen: Counter[str] = Counter()
    jobs = []
    for stored in kept:
        suffix = token("adversary", stored.scene_name, stored.agent_id)[:8]
        name = f"{stored.scene_name.replace('/', '-')}-{suffix}"
        jobs.append(_WritingJob(name, stored.scene_name, seen[stored.scene_name], stored))
        seen[stored.scene_name] += 1
    return jobs


def _write(
    source: DataSet, split: str, reference: SourceReference, jobs: Sequence[_WritingJob], settings: BuildSettings
) -> None:
    plan = DataSetPlan(
        root=settings.out,
        version=settings.version,
        split=split,
        layout=settings.layout,
        renderer=settings.renderer,
        frames=settings.frames,
        jpeg_quality=settings.jpeg_quality,
        lossless=settings.lossless,
        source=SourceInfo(name=source.name, fingerprint=source.fingerprint(), root=source.root, version=source.version),
    )
    job = functools.partial(_write_one, plan, reference)
    finish_data_set(plan, list(map_ordered(job, list(jobs), workers=settings.workers, label="rendering")))


def _write_one(plan: DataSetPlan, reference: SourceReference, job: _WritingJob) -> str:
    scene = reference.open().scene(job.source_scene)
    name = job.name
    report: dict[str, Any] = {}
    if job.stored is not None:
        scene = job.stored.adversarial(scene)
        report = {key: value for key, value in job.stored.report.items() if key != "plans"}
        if plan.layout == "per-variant":
            name = job.source_scene
    return write_scene(plan, scene, name=name, variant=job.variant, source_scene=job.source_scene, report=report)


def _write_reports(out: Path, report: BuildReport, results: Sequence[StoredAttempt]) -> None:
    write_json(out / "report.json", report.as_json())
    write_json_lines(out / "attempts.jsonl", [result.report for result in results])
