"""Freezing a split: what a search found as a file from which it can be rebuilt."""

import functools
from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.datasets.roots import DataSet
from benchmark.machine.workers import Executor
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan
from generation.search.chains import Chain, Tried
from generation.search.definition import Search
from generation.splits.format import (
    Choice,
    FrozenAdversary,
    FrozenScene,
    FrozenSplit,
    Recordings,
    SearchFacts,
)
from generation.splits.tracks import adversarial, drawn_digest, image_facts, recorded_pose, rounded_pose, tables_digest

_UNKNOWN: Final = "0" * 64
"""Stands for a hash until the scene is put together."""


def freeze(
    source: DataSet, plan: DataSetPlan, chains: Sequence[Chain], search: Search, chosen: Choice, executor: Executor
) -> FrozenSplit:
    """Freeze scenes, best first; nothing depends on where images are drawn.

    The images of the data set of ``plan``, which was built, are compared later.
    """
    assert plan.source is not None
    images = image_facts(plan, source.scene(chains[0].scene_name))
    order = sorted(range(len(chains)), key=lambda index: (chains[index].scene_name, index))

    def work() -> Iterator[tuple[Scene, FrozenScene]]:
        for index in order:
            recorded = source.scene(chains[index].scene_name)
            frozen = _frozen_scene(chains[index], recorded)
            yield adversarial(frozen, recorded), frozen

    compared = functools.partial(_compared, plan, images is not None)
    done = executor.map(compared, work(), total=len(chains), label="freezing")
    scenes = dict(zip(order, done, strict=True))
    return FrozenSplit(
        recordings=Recordings(name=plan.source.name, fingerprint=plan.source.fingerprint),
        search=search_facts(search),
        chosen=chosen,
        images=images,
        scenes=tuple(scenes[index] for index in range(len(chains))),
    )


def search_facts(search: Search) -> SearchFacts:
    """Facts on the search, as frozen splits say them."""
    definition = search.as_json()
    return SearchFacts(
        algorithm=definition["algorithm"],
        hyper=definition["hyper_fingerprint"],
        prior=definition["prior"],
        seed=definition["seed"],
        solvable=search.hyper.solvable,
    )


def _compared(plan: DataSetPlan, with_images: bool, work: tuple[Scene, FrozenScene]) -> FrozenScene:
    """A frozen scene with its hashes; runs in a worker."""
    scene, frozen = work
    images = drawn_digest(plan, scene) if with_images else None
    return frozen.model_copy(update={"tables": tables_digest(plan, scene, frozen), "images": images})


def _frozen_scene(chain: Chain, scene: Scene) -> FrozenScene:
    adversaries = tuple(_frozen_adversary(link, scene) for link in chain.links)
    return FrozenScene(name=chain.name, source=chain.scene_name, adversaries=adversaries, tables=_UNKNOWN)


def _frozen_adversary(link: Tried, scene: Scene) -> FrozenAdversary:
    start = link.attempt.launch_frame
    assert start is not None, "attempts that are kept were launched"
    return FrozenAdversary(
        instance=link.agent_id,
        launch_frame=start,
        recorded=rounded_pose(recorded_pose(scene, link.unit.agent, start)),
        track=tuple(map(rounded_pose, link.stored.poses)),
    )
