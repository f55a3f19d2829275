"""Generated scenes that are written: most challenging, failed by the surrogate, not rejected, and varied."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.machine.extension import import_from_extension
from benchmark.records.review import REJECTED, StandingVerdict, read_review
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import SceneNames
from generation.pipeline.settings import BuildSettings
from generation.pipeline.surrogate import SurrogateResult, build_staging_plan, evaluate_surrogate, reuse_scenes
from generation.pipeline.writing import WritingJob, number_jobs, write_scenes
from generation.search.chains import AdversaryChain, DropReason, SearchAttempt, SearchResult
from generation.search.ranking import rank_scenes

FAR_M: Final = 10.0
"""Tracks this far apart are as different as any: another part of the traffic."""


def compute_distance(first: SearchAttempt, second: SearchAttempt) -> float:
    """Difference of two adversaries of one recording, 0 to 2.

    The mean distance of their centres at the frames at which both act, in units of 10 m and at most 1 at each (1 where
    they never act together), and 1 more where their primary manoeuvres are of different kinds.
    """
    tracks, starts = [], []
    for attempted in (first, second):
        tracks.append(np.array(attempted.stored.poses, dtype=np.float64).reshape(-1, 3)[:, :2])
        starts.append(attempted.attempt.launch_frame or 0)
    begin, end = max(starts), min(start + len(track) for start, track in zip(starts, tracks, strict=True))
    apart = 1.0
    if begin < end:
        first_track, second_track = (
            track[begin - start : end - start] for start, track in zip(starts, tracks, strict=True)
        )
        apart = float(np.minimum(np.linalg.norm(first_track - second_track, axis=1) / FAR_M, 1.0).mean())
    kinds = {
        None if attempted.attempt.labels is None else attempted.attempt.labels.manoeuvre
        for attempted in (first, second)
    }
    return apart + (len(kinds) - 1)


def select_differing(order: Sequence[AdversaryChain], most: int) -> list[AdversaryChain]:
    """At most ``most`` scenes of each recording, best first, that differ from one another.

    The most challenging one comes first; then, again and again, the one whose least `compute_distance` to those that
    are kept is largest. Scenes with several adversaries are compared link by link.
    """
    selected: set[str] = set()
    for scene in dict.fromkeys(chain.scene_name for chain in order):
        rest = [chain for chain in order if chain.scene_name == scene]
        chosen = [rest.pop(0)]
        while rest and len(chosen) < most:
            least = [min(_compute_chain_distance(chain, other) for other in chosen) for chain in rest]
            # The first of equals is the more challenging one.
            chosen.append(rest.pop(int(np.argmax(least))))
        selected.update(chain.name for chain in chosen)
    return [chain for chain in order if chain.name in selected]


def _compute_chain_distance(first: AdversaryChain, second: AdversaryChain) -> float:
    return float(np.mean([compute_distance(*links) for links in zip(first.links, second.links, strict=True)]))


def find_rejected_jobs(
    plan: DataSetPlan, jobs: Sequence[WritingJob], read: Callable[[str], Scene]
) -> dict[str, tuple[int, StandingVerdict]]:
    """Variant and verdict, by name of the job, of scenes that an inspector rejected while they had the same motion.

    ``read`` gives a recorded scene by name; asked for scenes with a rejection alone.
    """
    verdicts = read_review(plan.root)
    rejected = {}
    for job in jobs:
        name = job.name_in_data_set(plan)
        verdict = verdicts.get(name)
        if verdict is None or verdict.verdict != REJECTED:
            continue
        scene = job.make(read(job.source_scene))
        names = SceneNames.of(
            plan,
            scene,
            name=job.written_as,
            variant=job.variant,
            source_scene=job.source_scene,
            identity=job.identity,
        )
        token = names.token("scene")
        if token == verdict.token:
            rejected[job.name] = job.variant, StandingVerdict(name, token, REJECTED, verdict.reason)
    return rejected


@dataclass(frozen=True, slots=True)
class SceneSelection:
    """Scenes that are written, best first; ``left_out`` were rejected and have the numbers of their variants.

    ``panel`` says who ranked them, and by what, ``panel_s`` how many processor seconds that took. ``staging`` is the
    data set that the surrogate was judged on, ``staged`` has its content keys by name of the scene.
    """

    chains: list[AdversaryChain]
    jobs: list[WritingJob]
    judgement: SurrogateResult | None = None
    staging: DataSetPlan | None = None
    staged: dict[str, str] | None = None
    left_out: tuple[tuple[int, StandingVerdict], ...] = ()
    panel: dict[str, Any] | None = None
    panel_s: float = 0.0

    def reuse_pictures(self, plan: DataSetPlan) -> None:
        """Put pictures that were drawn for the surrogate where they belong."""
        if self.staging is not None and self.staged is not None and self.staging.renderer == plan.renderer:
            reuse_scenes(self.staging, plan, [self.staged[job.name] for job in self.jobs])


def select_scenes(source: DataSet, plan: DataSetPlan, found: SearchResult, settings: BuildSettings) -> SceneSelection:
    """Choose the scenes that are written, and note in ``found`` why the others are not."""
    order = rank_scenes(found.chains, per_scene=None, total=None)
    # Variants keep their numbers when scenes are left out, and so their tokens, which verdicts refer to.
    by_name = {job.name: job for job in build_writing_jobs(order, plan)}
    rejected = find_rejected_jobs(plan, list(by_name.values()), source.scene)
    for chain in order:
        if chain.name in rejected:
            found.drop(chain, DropReason.REJECTED)
    order = [chain for chain in order if chain.name not in rejected]
    left_out = tuple(rejected.values())
    panel, started = None, time.process_time()
    if settings.panel is not None and order:
        order, inert, panel = import_from_extension("search", "panel")(source, order, settings.panel)
        for chain in inert:
            found.drop(chain, DropReason.INERT)
    panel_s = time.process_time() - started
    if settings.surrogate is None or not order:
        selected = _select_most_challenging(found, order, settings)
        own = number_jobs(plan, [by_name[chain.name] for chain in selected], source)
        return SceneSelection(selected, own, left_out=left_out, panel=panel, panel_s=panel_s)
    staging, jobs = build_staging_plan(plan, settings.surrogate), [by_name[chain.name] for chain in order]
    keys = write_scenes(
        staging,
        jobs,
        source.scene,
        settings.where_rendered,
        timing=settings.timing / "rendering",
        label="rendering for the surrogate",
    )
    runs = staging.root.parent / "runs"
    judgement = evaluate_surrogate(staging, keys, settings.surrogate, runs, name=source.name, seed=settings.seed)
    failing = []
    for chain, job in zip(order, jobs, strict=True):
        if job.name_in_data_set(staging) in judgement.failed:
            failing.append(chain)
        else:
            found.drop(chain, DropReason.SURROGATE_COPES)
    selected = _select_most_challenging(found, failing, settings)
    staged = {job.name: key for job, key in zip(jobs, keys, strict=True)}
    own = number_jobs(plan, [by_name[chain.name] for chain in selected], source)
    return SceneSelection(selected, own, judgement, staging, staged, left_out, panel, panel_s)


def _select_most_challenging(
    result: SearchResult, chains: Sequence[AdversaryChain], settings: BuildSettings
) -> list[AdversaryChain]:
    apart = chains if settings.variants is None else select_differing(chains, settings.variants)
    if settings.panel is None:
        selected = rank_scenes(apart, per_scene=settings.per_scene, total=settings.total)
    else:
        selected = _select_first(apart, settings.per_scene or settings.panel.per_scene)[: settings.total]
    names = {chain.name for chain in selected}
    for chain in chains:
        if chain.name not in names:
            result.drop(chain, DropReason.BEYOND_LIMIT)
    return selected


def _select_first(chains: Sequence[AdversaryChain], per_scene: int) -> list[AdversaryChain]:
    """The first ones of each recording, in the order given; none in which the same adversaries do the same again."""
    taken: dict[str, set[tuple[str, ...]]] = {}
    selected = []
    for chain in chains:
        used = taken.setdefault(chain.scene_name, set())
        encounter = (chain.kind, *sorted(chain.agent_ids))
        if len(used) < per_scene and encounter not in used:
            used.add(encounter)
            selected.append(chain)
    return selected


def build_writing_jobs(chains: Sequence[AdversaryChain], plan: DataSetPlan) -> list[WritingJob]:
    """Jobs of generated scenes: names that do not depend on the rank, variant numbers that do."""
    next_variant: dict[str, int] = {}
    jobs = []
    for chain in chains:
        variant = next_variant.get(chain.scene_name, 0)
        next_variant[chain.scene_name] = variant + 1
        written_as = chain.scene_name if plan.layout == "per-variant" else chain.name
        jobs.append(
            WritingJob(
                chain.name,
                written_as,
                chain.scene_name,
                variant,
                chain.adversarial,
                chain.report(),
                last_attempt=(chain.links[-1].key, chain.last_rank),
                judgements=chain.judgements,
            )
        )
    return jobs
