"""Generated scenes that an inspector rejected: they are not written again."""

from collections.abc import Callable, Sequence

from benchmark.records.review import REJECTED, Judged, read_review
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import SceneNames
from generation.pipeline.writing import WritingJob


def rejected_jobs(
    plan: DataSetPlan, jobs: Sequence[WritingJob], read: Callable[[str], Scene]
) -> dict[str, tuple[int, Judged]]:
    """Scenes of a build that an inspector rejected: verdicts beside the root stand on the same motion alone.

    Args:
        read: Gives a recorded scene by name; asked for scenes with a rejection alone.

    Returns:
        By name of the job: the variant, and what was said, under the name in the data set.
    """
    verdicts = read_review(plan.root)
    found = {}
    for job in jobs:
        name = job.name_read(plan)
        said = verdicts.get(name)
        if said is None or said.verdict != REJECTED:
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
        if token == said.token:
            found[job.name] = job.variant, Judged(name, token, REJECTED, said.reason)
    return found
