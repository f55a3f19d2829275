"""Planners by name, whichever package or machine they are of."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.api.driving import looks_at_images
from benchmark.api.opening import worker_count
from benchmark.api.saying import say_once

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from adapters.registry import NamedPlanner
    from benchmark.sandbox.limits import Supervision
    from generation.pipeline.surrogate import PlannerUnderTest


def load_planner(
    name: str,
    checkpoint: Path | None = None,
    *,
    data: str | Path = "mini",
    seed: int = 0,
    device: str | None = None,
    precision: str | None = None,
    as_published: "Sequence[str]" = (),
    over_http: "Mapping[str, Any] | None" = None,
    supervision: "Supervision | None" = None,
) -> "NamedPlanner":
    """A planner by name, for `benchmark.evaluate`.

    Args:
        name: Planner name, ``package.module:Class``, or the address of a model server (docs/extensions/http.md).
        checkpoint: Its weights, if not its own.
        data: What it will drive on: on ``mini`` a miniature runs where the full model has no weights, and says so.
        seed: For planners that take one.
        device: Where a network runs: cpu, cuda, cuda:1; the first GPU by default, if there is one.
        precision: Of a network: float32 or bfloat16.
        as_published: What a network does as in its published runs: ``memory``, ``can-once``, ``can-after``, or ``all``
            that it knows of these (docs/models.md).
        over_http: How a model server is asked: ``image_format``, ``deadline_s``, and the ``frame`` of its answers.
        supervision: Limits of a planner of another package, which runs in a process of its own (docs/planners.md).

    Returns:
        What builds it in any process.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from adapters.registry import planner_factory

    chosen = model_that_runs(name, checkpoint, data=data)
    if chosen != name:
        say_once(f"there are no weights for {name}: {chosen} runs in its place (docs/miniatures.md)")
    return planner_factory(
        chosen,
        checkpoint=checkpoint,
        seed=seed,
        device=device,
        precision=precision,
        as_published=as_published,
        over_http=over_http,
        supervision=supervision,
    )


def model_that_runs(name: str, checkpoint: Path | None = None, *, data: str | Path = "mini") -> str:
    """What `load_planner` builds: a miniature on embedded data where the full model has no weights.

    Args:
        name: Planner name or ``package.module:Class``.
        checkpoint: Its weights, if not its own.
        data: What it will drive on.

    Returns:
        The planner's name.

    Raises:
        InputError: If there is no such planner, or it is a network that has no weights; nothing is loaded.
    """
    from adapters.checkpoints.stand_in import require_weights, stand_in
    from adapters.registry import require_known

    require_known(name)
    chosen = stand_in(name, checkpoint, str(data))
    require_weights(chosen, checkpoint)
    return chosen


def planner_under_test(
    name: str,
    checkpoint: Path | None = None,
    *,
    data: str | Path = "mini",
    seed: int = 0,
    workers: int = 0,
    supervision: "Supervision | None" = None,
) -> "PlannerUnderTest":
    """A planner that decides about generated scenes: the surrogate of a build, or who drives in an ablation.

    Args:
        name: Planner name or ``package.module:Class``.
        checkpoint: Its weights, if not its own.
        data: The data set that scenes are generated from.
        seed: For planners that take one.
        workers: Processes that run it; 0 takes all processors.
        supervision: As in `load_planner`.

    Returns:
        The planner, and whether it looks at images.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from generation.pipeline.surrogate import PlannerUnderTest

    factory = load_planner(name, checkpoint, data=data, seed=seed, supervision=supervision)
    return PlannerUnderTest(factory, images=looks_at_images(name) is not False, workers=worker_count(workers))
