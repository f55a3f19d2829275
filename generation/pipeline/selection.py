"""Which generated scenes are written: the most challenging that no inspector rejected and the surrogate fails."""

from collections.abc import Sequence
from dataclasses import dataclass

from benchmark.datasets.roots import DataSet
from benchmark.records.review import Judged
from generation.nuscenes_writer import DataSetPlan
from generation.pipeline.inspection import rejected_jobs
from generation.pipeline.settings import BuildSettings
from generation.pipeline.surrogate import Judgement, judge, staging_plan, take_over
from generation.pipeline.variants import differing
from generation.pipeline.writing import WritingJob, write_scenes
from generation.search.chains import Chain, Dropped, SearchResult
from generation.search.ranking import ranked


@dataclass(frozen=True, slots=True)
class Selection:
    """Scenes that are written, best first.

    Attributes:
        staging: The data set that the surrogate was judged on.
        staged: Content keys in it by name of the scene.
        left_out: Scenes that an inspector rejected, each with the number of its variant.
    """

    chains: list[Chain]
    jobs: list[WritingJob]
    judgement: Judgement | None = None
    staging: DataSetPlan | None = None
    staged: dict[str, str] | None = None
    left_out: tuple[tuple[int, Judged], ...] = ()

    def take_over(self, plan: DataSetPlan) -> None:
        """Put pictures that were drawn for the surrogate where they belong."""
        if self.staging is not None and self.staged is not None and self.staging.renderer == plan.renderer:
            take_over(self.staging, plan, [self.staged[job.name] for job in self.jobs])


def select(source: DataSet, plan: DataSetPlan, found: SearchResult, settings: BuildSettings) -> Selection:
    """Choose the scenes that are written, and note in ``found`` why the others are not."""
    order = ranked(found.chains, per_scene=None, total=None)
    # Variants keep their numbers whoever is left out, and with them their tokens, to which verdicts belong.
    by_name = {job.name: job for job in writing_jobs(order, plan)}
    rejected = rejected_jobs(plan, list(by_name.values()), source.scene)
    for chain in order:
        if chain.name in rejected:
            found.drop(chain, Dropped.REJECTED)
    order = [chain for chain in order if chain.name not in rejected]
    left_out = tuple(rejected.values())
    if settings.surrogate is None or not order:
        kept = _most_challenging(found, order, settings)
        return Selection(kept, [by_name[chain.name] for chain in kept], left_out=left_out)
    staging, jobs = staging_plan(plan, settings.surrogate), [by_name[chain.name] for chain in order]
    keys = write_scenes(
        staging,
        jobs,
        source.scene,
        settings.where_rendered,
        timing=settings.timing / "rendering",
        label="rendering for the surrogate",
    )
    runs = staging.root.parent / "runs"
    judgement = judge(staging, keys, settings.surrogate, runs, name=source.name, seed=settings.seed)
    failing = []
    for chain, job in zip(order, jobs, strict=True):
        if job.name_read(staging) in judgement.failed:
            failing.append(chain)
        else:
            found.drop(chain, Dropped.SURROGATE_COPES)
    kept = _most_challenging(found, failing, settings)
    staged = {job.name: key for job, key in zip(jobs, keys, strict=True)}
    return Selection(kept, [by_name[chain.name] for chain in kept], judgement, staging, staged, left_out)


def _most_challenging(found: SearchResult, chains: Sequence[Chain], settings: BuildSettings) -> list[Chain]:
    apart = chains if settings.variants is None else differing(chains, settings.variants)
    kept = ranked(apart, per_scene=settings.per_scene, total=settings.total)
    names = {chain.name for chain in kept}
    for chain in chains:
        if chain.name not in names:
            found.drop(chain, Dropped.BEYOND_LIMIT)
    return kept


def writing_jobs(chains: Sequence[Chain], plan: DataSetPlan) -> list[WritingJob]:
    """Jobs of generated scenes: names that do not depend on the rank, variant numbers that do."""
    seen: dict[str, int] = {}
    jobs = []
    for chain in chains:
        variant = seen.get(chain.scene_name, 0)
        seen[chain.scene_name] = variant + 1
        written_as = chain.scene_name if plan.layout == "per-variant" else chain.name
        jobs.append(
            WritingJob(
                chain.name,
                written_as,
                chain.scene_name,
                variant,
                chain.adversarial,
                chain.report(),
                last_attempt=(chain.links[-1].key, chain.last_place),
                judgements=chain.judgements,
            )
        )
    return jobs
