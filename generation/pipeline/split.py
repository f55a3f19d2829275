"""Building a split: choose vehicles, plan adversaries, keep the most challenging, render and write nuScenes format.

Every step is resumable and gives the same bytes for any executor, on processors of one kind (docs/frozen-splits.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, lock_folder
from benchmark.records.attempts import ATTEMPTS_FILE
from benchmark.records.review import StandingVerdict
from benchmark.records.seed_splits import parse_seed, strip_ego
from benchmark.report.words import pluralise
from generation.nuscenes_writer import DataSetPlan, SourceInfo
from generation.pipeline.estimate import build_runtime_table
from generation.pipeline.recordings import build_search, list_unlabelled_scenes, require_buildable
from generation.pipeline.report import BuildReport, estimate_build
from generation.pipeline.selection import SceneSelection, select_scenes
from generation.pipeline.settings import BuildSettings
from generation.pipeline.writing import (
    WritingJob,
    WrittenScenes,
    publish,
    publish_reports,
    withdraw,
    write_scenes,
)
from generation.search.adversary import does_ego_already_collide, drive_ego
from generation.search.chains import AdversaryChain, SearchResult, search_chains
from generation.search.definition import Search
from generation.search.threat_settings import EgoDriver
from generation.splits.format import FrozenRejection, SceneChoice, write_frozen
from generation.splits.freezing import build_search_metadata, freeze_split
from generation.splits.packaged import compute_search_hash


class NothingSurvivedError(InputError):
    """No adversarial scene came out of a build; ``report`` says what was tried."""

    def __init__(self, sentence: str, report: BuildReport) -> None:
        super().__init__(sentence)
        self.report = report


def build_split(source: DataSet, split: str, settings: BuildSettings) -> BuildReport:
    """Build one split of a benchmark from recorded scenes.

    Args:
        source: Recorded scenes.
        split: ``adv`` (adversarial), the same with one of several seeds (``adv-seed-3``), or ``val-r`` (the originals,
            rendered again); ``adv-ego-idm`` and ``val-r-ego-idm`` with the ego of the settings of the search.
        settings: Settings of the build.

    Returns:
        The report. It is also in ``report.json``, each attempt in ``attempts.jsonl`` and each choice of vehicles in
        ``candidates.jsonl``, in the output root.

    Raises:
        InputError: If the split is another, a scene is unknown, nothing survives, another command is writing there, the
            output is built from a frozen split, or it cannot be written.
    """
    if settings.dry_run:
        return estimate_build(source, split, settings)
    names = require_buildable(source, split, settings)
    if strip_ego(split) == "val-r":
        return _build_originals(source, split, names, settings)
    search = build_search(source, names, settings)
    with lock_folder(settings.out):
        return _build_adversarial(source, split, search, names, settings)


@dataclass(frozen=True, slots=True)
class PreparedBuild:
    """Found scenes and those of them that are written; ``files`` has the report on both, by file name."""

    found: SearchResult
    chosen: SceneSelection
    plan: DataSetPlan
    report: BuildReport
    files: dict[str, bytes]


def run_search(
    source: DataSet, search: Search, names: Sequence[str], settings: BuildSettings, *, keep: bool = True
) -> SearchResult:
    """`search_chains` as the settings of a build say; arguments and errors as of `prepare_build`."""
    first, *further = (
        search_chains(
            family,
            source,
            names,
            settings.executor,
            adversaries=settings.adversaries,
            together=settings.together,
            keep_rounds=settings.keep_rounds,
            keep=keep,
        )
        for family in search.families
    )
    for found in further:
        first.add(found)
    return first


def prepare_build(
    source: DataSet,
    split: str,
    search: Search,
    names: Sequence[str],
    settings: BuildSettings,
    *,
    keep: bool = True,
) -> PreparedBuild:
    """Search, or find what was searched, and choose; nothing is published. ``keep`` writes choices of vehicles."""
    result = run_search(source, search, names, settings, keep=keep)
    plan = _build_plan(source, split, settings)
    chosen = select_scenes(source, plan, result, settings)
    surrogate = None if chosen.judgement is None else chosen.judgement.as_json(settings.out)
    report = BuildReport.of(len(names), result, chosen.chains, surrogate, settings.adversaries)
    report = replace(report, split=split, unlabelled=list_unlabelled_scenes(source, settings))
    report = replace(report, panel=chosen.panel, panel_s=chosen.panel_s)
    files = _build_report_files(report, result, chosen.chains)
    files["search.json"] = (canonical_json(search.as_json(), indent=1) + "\n").encode()
    plan = replace(plan, left_out=chosen.left_out, panel="" if settings.panel is None else settings.panel.sentence())
    if parse_seed(split) is not None:
        how = _build_choice(report, settings, plan.left_out)
        plan = replace(plan, search=compute_search_hash(build_search_metadata(search), how, settings.adversaries))
    return PreparedBuild(result, chosen, plan, report, files)


def _build_adversarial(
    source: DataSet, split: str, search: Search, names: Sequence[str], settings: BuildSettings
) -> BuildReport:
    prepared = prepare_build(source, split, search, names, settings)
    result, chosen, plan, report = prepared.found, prepared.chosen, prepared.plan, prepared.report
    publish_reports(settings.out, prepared.files)
    if not chosen.jobs:
        withdraw(settings.out)
        raise NothingSurvivedError(
            f"no adversarial scene survived: {report.sentence()}; {_format_advice(report, settings)}",
            report,
        )
    chosen.reuse_pictures(plan)
    notes = _write(source, plan, chosen.jobs, settings)
    if settings.freeze is not None:
        how = _build_choice(report, settings, plan.left_out)
        frozen = freeze_split(
            source, plan, chosen.chains, search, how, settings.where_rendered, [job.number for job in chosen.jobs]
        )
        write_frozen(settings.freeze, frozen)
    return replace(
        report, runtime=build_runtime_table([search.timing_path(attempted.key) for attempted in result.tried], notes)
    )


def _format_advice(report: BuildReport, settings: BuildSettings) -> str:
    if report.tried:
        return f"try more scenes or another --seed (details in {settings.out / ATTEMPTS_FILE})"
    reasons = sorted(report.not_tried.items(), key=lambda row: (-row[1], row[0]))
    exclusions = ", ".join(f"{count} {reason}" for reason, count in reasons) or "nothing is annotated"
    return (
        f"of {pluralise(sum(report.not_tried.values()), 'object')} none can be tried ({exclusions}): choose other "
        "scenes with --source-split or --scenes"
    )


def _build_choice(
    report: BuildReport, settings: BuildSettings, rejected: Sequence[tuple[int, StandingVerdict]]
) -> SceneChoice:
    return SceneChoice(
        scenes=report.scenes,
        tried=report.tried,
        survived=report.survived,
        per_scene=settings.per_scene,
        variants=settings.variants,
        asked=tuple(kind.value for kind in settings.asked) or None,
        total=settings.total,
        surrogate=None if report.surrogate is None else str(report.surrogate["planner"]),
        panel=None if settings.panel is None else settings.panel.sentence(),
        rejected=_build_frozen_rejections(rejected),
    )


def _build_frozen_rejections(rejected: Sequence[tuple[int, StandingVerdict]]) -> tuple[FrozenRejection, ...] | None:
    rejections = [FrozenRejection(name=scene.name, token=scene.token, reason=scene.reason) for _, scene in rejected]
    return tuple(rejections) or None


def prepare_originals(
    source: DataSet, split: str, names: Sequence[str], settings: BuildSettings
) -> tuple[DataSetPlan, list[WritingJob], BuildReport, dict[str, bytes]]:
    """Data set of recordings that are rendered again: its plan, its scenes, the report, and that by file name.

    Recordings in which a reference driver in the ego's place touches anything are left out, as the search does.
    """
    ego = settings.hyper.ego
    collided = [
        name
        for name in (names if ego is not EgoDriver.RECORDED else ())
        if does_ego_already_collide(drive_ego(source.scene(name), ego))
    ]
    kept, make = [name for name in names if name not in collided], partial(drive_ego, ego=ego)
    if not kept:
        raise InputError(
            f"the driven ego touches others in all of {pluralise(len(names), 'scene')}; choose another --ego"
        )
    jobs = [WritingJob(name.replace("/", "-"), name.replace("/", "-"), name, 0, make, {}) for name in kept]
    unlabelled = list_unlabelled_scenes(source, settings)
    written = tuple(job.name for job in jobs)
    report = BuildReport(split, len(jobs), written=written, unlabelled=unlabelled, collided=tuple(collided))
    return _build_plan(source, split, settings), jobs, report, _build_report_files(report, SearchResult(), [])


def _build_originals(source: DataSet, split: str, names: Sequence[str], settings: BuildSettings) -> BuildReport:
    plan, jobs, report, files = prepare_originals(source, split, names, settings)
    with lock_folder(settings.out):
        publish_reports(settings.out, files)
        notes = _write(source, plan, jobs, settings)
    return replace(report, runtime=build_runtime_table([], notes))


def _build_plan(source: DataSet, split: str, settings: BuildSettings) -> DataSetPlan:
    return DataSetPlan(
        root=settings.out,
        version=settings.version,
        split=split,
        layout=settings.layout,
        renderer=settings.renderer,
        frames=settings.frames,
        jpeg_quality=settings.jpeg_quality,
        lossless=settings.lossless,
        source=SourceInfo.of(source),
        ego=settings.hyper.ego.value,
    )


def _write(source: DataSet, plan: DataSetPlan, jobs: Sequence[WritingJob], settings: BuildSettings) -> list[Path]:
    timing = settings.timing / "rendering"
    keys = write_scenes(plan, jobs, source.scene, settings.where_rendered, timing=timing)
    publish(WrittenScenes(plan, jobs, keys, source))
    return [timing / f"{key}.timing.json" for key in keys]


def _build_report_files(
    report: BuildReport, result: SearchResult, written: Sequence[AdversaryChain]
) -> dict[str, bytes]:
    name_of = {link.unit: chain.name for chain in written for link in chain.links}
    attempts = []
    for attempted in result.tried:
        fate = {
            "earlier": tuple(link.agent_id for link in attempted.unit.earlier),
            "dropped": result.dropped.get(attempted.unit),
            "written": name_of.get(attempted.unit),
        }
        attempts.append(attempted.attempt.model_copy(update=fate).as_json())
    candidates = [vehicles.row(earlier) for earlier, vehicles in result.eligibility]
    files = {
        "report.json": (canonical_json(report.as_json(), indent=1) + "\n").encode(),
        ATTEMPTS_FILE: "".join(canonical_json(row) + "\n" for row in attempts).encode(),
    }
    if candidates:
        files["candidates.jsonl"] = "".join(canonical_json(row) + "\n" for row in candidates).encode()
    return files
