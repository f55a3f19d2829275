"""Freezing a split: what a search found as a file from which it can be rebuilt."""

import functools
from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.datasets.roots import DataSet
from benchmark.geometry import Floats
from benchmark.machine.workers import Executor
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.numbering import SceneNumber
from generation.search.chains import AdversaryChain, SearchAttempt
from generation.search.definition import Search
from generation.search.threat_settings import EgoDriver
from generation.splits.format import (
    DRIVEN_SCHEMA,
    SCHEMA,
    FrozenAdversary,
    FrozenDrive,
    FrozenScene,
    FrozenSplit,
    FrozenTrack,
    RecordingsIdentity,
    SceneChoice,
    SearchMetadata,
)
from generation.splits.tracks import (
    add_frozen_adversaries,
    add_number,
    build_image_facts,
    compute_drawn_digest,
    compute_tables_digest,
    read_recorded_pose,
    round_pose,
)

_UNKNOWN: Final = "0" * 64
"""Stands for a hash until the scene is put together."""


def freeze_split(
    source: DataSet,
    plan: DataSetPlan,
    chains: Sequence[AdversaryChain],
    search: Search,
    chosen: SceneChoice,
    executor: Executor,
    numbers: Sequence[SceneNumber | None] = (),
) -> FrozenSplit:
    """Freeze scenes, best first; where images are drawn changes nothing: those of ``plan`` are compared later.

    ``numbers`` are those of the scenes in their root; without them they keep name and times of the recording.
    """
    assert plan.source is not None
    images = build_image_facts(plan, source.scene(chains[0].scene_name))
    order = sorted(range(len(chains)), key=lambda index: (chains[index].scene_name, index))

    def work() -> Iterator[tuple[Scene, FrozenScene]]:
        for index in order:
            recorded = source.scene(chains[index].scene_name)
            frozen = add_number(_freeze_scene(chains[index], recorded), numbers[index] if numbers else None)
            yield add_frozen_adversaries(frozen, recorded), frozen

    compared = functools.partial(_add_hashes, plan, images is not None)
    done = executor.map(compared, work(), total=len(chains), label="freezing")
    scenes = dict(zip(order, done, strict=True))
    return FrozenSplit.model_validate({
        "schema": SCHEMA if search.hyper.ego is EgoDriver.RECORDED else DRIVEN_SCHEMA,
        "recordings": RecordingsIdentity(name=plan.source.name, fingerprint=plan.source.fingerprint),
        "search": build_search_metadata(search),
        "chosen": chosen,
        "images": images,
        "scenes": tuple(scenes[index] for index in range(len(chains))),
    })  # fmt: skip


def build_search_metadata(search: Search) -> SearchMetadata:
    """Facts on the search, as frozen splits say them."""
    definition = search.as_json()
    return SearchMetadata(
        algorithm=definition["algorithm"],
        hyper=definition["hyper_fingerprint"],
        prior=definition["prior"],
        seed=definition["seed"],
        solvable=search.hyper.solvable,
        ego=None if search.hyper.ego is EgoDriver.RECORDED else search.hyper.ego.value,
    )


def _add_hashes(plan: DataSetPlan, with_images: bool, work: tuple[Scene, FrozenScene]) -> FrozenScene:
    """A frozen scene with its hashes; runs in a worker."""
    scene, frozen = work
    images = compute_drawn_digest(plan, scene) if with_images else None
    return frozen.model_copy(update={"tables": compute_tables_digest(plan, scene, frozen), "images": images})


def _freeze_scene(chain: AdversaryChain, scene: Scene) -> FrozenScene:
    adversaries = tuple(_freeze_adversary(link, scene) for link in chain.links)
    driven = _freeze_drive(chain)
    return FrozenScene(
        name=chain.name, source=chain.scene_name, adversaries=adversaries, tables=_UNKNOWN, driven=driven
    )


def _freeze_drive(chain: AdversaryChain) -> FrozenDrive | None:
    """Tracks of the ego, and of all who answered it in the last drive or before; those of the last count."""
    drives = [link.stored.driven.tracks for link in chain.links if link.stored.driven is not None]
    if not drives:
        return None
    adversaries, others = set(chain.agent_ids), dict[str, tuple[int, Floats]]()
    for drive in drives:
        others.update(drive.others)
    return FrozenDrive(
        ego=tuple(map(round_pose, drives[-1].ego)),
        others=tuple(
            FrozenTrack(instance=name, first_frame=first, track=tuple(map(round_pose, track)))
            for name, (first, track) in others.items()
            if name not in adversaries
        ),
    )


def _freeze_adversary(link: SearchAttempt, scene: Scene) -> FrozenAdversary:
    start = link.attempt.launch_frame
    assert start is not None, "attempts that are kept were launched"
    return FrozenAdversary(
        instance=link.agent_id,
        launch_frame=start,
        recorded=round_pose(read_recorded_pose(scene, link.unit.agent, start)),
        track=tuple(map(round_pose, link.stored.poses)),
    )
