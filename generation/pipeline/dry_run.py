"""How much work a build is, counted and timed by small samples; nothing is written."""

from collections.abc import Sequence
from dataclasses import replace

from benchmark.datasets.roots import DataSet
from generation.pipeline.estimate import KEPT_SHARE, Estimate, planning_estimate, rendering_estimate, workers_of
from generation.pipeline.recordings import ready_to_build, search_of, unlabelled_scenes
from generation.pipeline.report import BuildReport
from generation.pipeline.settings import BuildSettings
from generation.search.attempts import kept_attempt
from generation.search.chains import first_units
from generation.search.definition import Search
from generation.search.eligibility import not_tried_together


def estimate_build(source: DataSet, split: str, settings: BuildSettings) -> BuildReport:
    """What `generation.pipeline.split.build_split` would do, with an estimate; arguments and errors as there."""
    names = ready_to_build(source, split, settings)
    if split != "val-r":
        search = search_of(source, names, settings)
        return replace(_search_estimate(source, search, names, settings), split=split)
    each, workers = _rendering_seconds(source, names, settings), workers_of(settings.where_rendered)
    about = Estimate(0, 0.0, len(names), each, workers, workers)
    skipped = unlabelled_scenes(source, settings)
    return BuildReport("val-r", len(names), estimate=about, dry_run=True, unlabelled=skipped)


def _search_estimate(source: DataSet, search: Search, names: Sequence[str], settings: BuildSettings) -> BuildReport:
    """Estimate of the work that there is to do."""
    chosen = first_units(search, source, names, keep=False)
    units = [unit for _, of_scene in chosen for unit in of_scene]
    with_rounds = settings.keep_rounds and settings.adversaries == 1
    left = [unit for unit in units if kept_attempt(search, unit, with_rounds=with_rounds) is None]
    count, each = planning_estimate(search, units, left, source.scene, settings.adversaries)
    expected = round(KEPT_SHARE * len(units))
    for most in (settings.per_scene, settings.variants):
        expected = expected if most is None else min(expected, most * len(names))
    if settings.total is not None:
        expected = min(expected, settings.total)
    scene_s = _rendering_seconds(source, names, settings)
    planners, renderers = workers_of(settings.executor), workers_of(settings.where_rendered)
    about = Estimate(count, each, expected, scene_s, planners, renderers)
    return BuildReport(
        "adv",
        len(names),
        len(units),
        len(units) - len(left),
        not_tried=not_tried_together([seen for seen, _ in chosen]),
        adversaries=settings.adversaries,
        estimate=about,
        dry_run=True,
        unlabelled=unlabelled_scenes(source, settings),
    )


def _rendering_seconds(source: DataSet, names: Sequence[str], settings: BuildSettings) -> float:
    timing = settings.timing / "rendering"
    return rendering_estimate(settings.renderer, source.scene(names[0]), settings.frames, timing)
