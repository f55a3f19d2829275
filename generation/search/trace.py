"""Traces of searches as files: ``rounds.json`` beside the sheet of each generated scene."""

import functools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, read_kept_json, write_bytes
from benchmark.machine.workers import LocalProcesses
from benchmark.records.scenes import (
    ROUNDS_FILE,
    SCHEMA,
    SHEET_FILE,
    RefinementTrace,
    Sheet,
    scene_folder,
)
from generation.search.adversary import ALGORITHM_VERSION
from generation.search.attempts import Earlier, PriorFactory, Search, Unit, kept_attempt
from generation.search.rounds import SHOWN_CANDIDATES, Searched, trace
from generation.search.search_file import read_search

TRACE_VERSION: Final = "1"
"""Changes when the same search would be written in another way."""
INDEX_UNKNOWN: Final = -1


def write_traces(
    data: DataSet,
    source: DataSet,
    split: str,
    sheet_root: Path,
    scenes: Sequence[str],
    *,
    workers: int = 1,
    prior: PriorFactory | None = None,
    say: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write ``rounds.json`` beside the sheets of generated scenes; those that are there and current are left alone.

    Of a scene with several adversaries the last one's search is traced: the others are as they are shown.

    Args:
        data: The generated data set.
        source: The recorded scenes that it was made from.
        split: Split of ``data``.
        sheet_root: Folder of all sheets; those of the scenes must be there.
        scenes: Names of the scenes.
        workers: Number of processes; no byte depends on it.
        prior: Makes the diffusion model; by default the package's, asked as the build asked.
        say: Is told, in a sentence, of each scene that could not be traced; by default standard error is.

    Returns:
        The files of the scenes that are traced now, in the order of the scenes.

    Raises:
        InputError: If none of the scenes can be traced, because the data set was not generated here, from another
            source, by another version of the search or with another trajectory model.
    """
    say = say or _to_standard_error
    entries = _generated(data, source, scenes)
    search = read_search(data.root, prior)
    found: dict[str, Path] = {}
    open_work: list[_Plan] = []
    for name in scenes:
        folder = scene_folder(sheet_root, data.name, split, name)
        try:
            plan = _planned(search, name, entries[name], folder)
        except InputError as problem:
            say(str(problem))
            continue
        if _is_current(plan):
            found[name] = plan.path
        else:
            open_work.append(plan)

    def searches() -> Iterator[Searched | str]:
        for plan in open_work:
            yield _searched(search, source, plan)

    work = functools.partial(_traced, search.prior)
    results = LocalProcesses(workers).map(work, searches(), total=len(open_work), label="tracing searches")
    for plan, made in zip(open_work, results, strict=True):
        if isinstance(made, str):
            say(made)
            continue
        write_bytes(plan.path, made)
        found[plan.name] = plan.path
    return [found[name] for name in scenes if name in found]


@dataclass(frozen=True, slots=True)
class _Plan:
    """A scene to trace; ``chain`` holds its adversaries' identifiers in the source, in the order of planning."""

    name: str
    path: Path
    origin_m: tuple[float, float]
    source_scene: str
    chain: tuple[str, ...]
    instances: tuple[str, ...]
    facts: dict[str, Any]


def _generated(data: DataSet, source: DataSet, scenes: Sequence[str]) -> dict[str, Any]:
    """What the data set says of the scenes, if it can be traced at all."""
    made = data.provenance()
    entries = {} if made is None else {name: made["scenes"].get(name) or {} for name in scenes}
    if made is None or not any(entry.get("adversaries") for entry in entries.values()):
        raise InputError(
            f"{data.root} does not say that its scenes have adversaries, so there is no search to trace; rounds are "
            "for splits that challenger-bench generate --split adv made"
        )
    if made.get("source", {}).get("fingerprint") != source.fingerprint():
        raise InputError(
            f"{data.root} was generated from other recordings than {source.root} now has; give the --data that it was "
            "generated from, or generate it again"
        )
    return entries


def _planned(search: Search, name: str, entry: dict[str, Any], folder: Path) -> _Plan:
    """What is to be done for one scene, from its sheet and its provenance."""
    if not entry.get("adversaries"):
        raise InputError(f"{name} has no adversary, so there is no search to trace; leave it out")
    report = entry.get("report") or {}
    reports = report.get("adversaries", [report])
    try:
        chain = tuple(str(each["agent"]) for each in reports)
        source_scene, seed = str(entry["source_scene"]), int(reports[-1]["seed"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the challenger.json of {name} does not say which vehicle was searched; generate it again"
        ) from error
    if seed != search.seed or len(chain) != len(entry["adversaries"]):
        raise InputError(f"{name} was not made by the search that {search.state.parent} names; generate it again")
    origin_m = _origin_m(name, folder)
    key, facts = _chain_keys(search, source_scene, chain)[-1], _facts(search)
    instances = tuple(entry["adversaries"])
    return _Plan(name, folder / ROUNDS_FILE, origin_m, source_scene, chain, instances, {**facts, "attempt": key})


def _origin_m(name: str, folder: Path) -> tuple[float, float]:
    """Origin of a scene's sheet, without the check of its pictures that reading it whole would make."""
    try:
        return Sheet.model_validate(read_kept_json(folder / SHEET_FILE)).origin_m
    except ValidationError as error:
        raise InputError(
            f"{name} has no sheet in {folder}, or a damaged one; run challenger-bench sheets for it first"
        ) from error


def _chain_keys(search: Search, source_scene: str, chain: Sequence[str]) -> list[str]:
    """Content keys of the attempts of a chain; the index of a vehicle is no part of them."""
    earlier: tuple[Earlier, ...] = ()
    for agent_id in chain:
        key = search.key(Unit(source_scene, INDEX_UNKNOWN, agent_id, earlier))
        earlier = (*earlier, Earlier(key, INDEX_UNKNOWN, agent_id, INDEX_UNKNOWN))
    return [link.key for link in earlier]


def _facts(search: Search) -> dict[str, Any]:
    return {
        "trace": TRACE_VERSION,
        "algorithm": ALGORITHM_VERSION,
        "source": search.fingerprint,
        "seed": search.seed,
        "hyper": search.hyper.fingerprint,
        "prior": search.prior_fingerprint,
        "candidates": search.hyper.candidates,
        "shown": min(SHOWN_CANDIDATES, search.hyper.candidates),
        "step_s": FRAMES_PER_KEYFRAME / FRAME_HZ,
        "executed_s": search.hyper.horizon / FRAME_HZ,
        "scored_s": search.hyper.scored_frames[-1] / FRAME_HZ,
    }


def _is_current(plan: _Plan) -> bool:
    try:
        there = RefinementTrace.model_validate(read_kept_json(plan.path))
    except ValidationError:
        # Absent or damaged: it is made again.
        return False
    said = (there.schema_version, there.scene, there.origin_m, there.search)
    return said == (SCHEMA, plan.name, plan.origin_m, plan.facts) and there.agent in plan.instances


def _searched(search: Search, source: DataSet, plan: _Plan) -> Searched | str:
    """The scene as it was when its last adversary was searched, or why it cannot be had."""
    scene = source.scene(plan.source_scene)
    ids = scene.agents.ids
    if missing := [agent_id for agent_id in plan.chain if agent_id not in ids]:
        return f"{plan.name} cannot be traced: {plan.source_scene} has no vehicle {missing[0]}; generate it again"
    instance = plan.instances[sorted(plan.chain, key=ids.index).index(plan.chain[-1])]
    earlier: tuple[Earlier, ...] = ()
    for place, agent_id in enumerate(plan.chain, 1):
        index = ids.index(agent_id)
        unit = Unit(plan.source_scene, index, agent_id, earlier)
        stored = kept_attempt(search, unit)
        if stored is None or not stored.kept or stored.start is None:
            break
        if place == len(plan.chain):
            return Searched(
                name=plan.name,
                scene=scene,
                agent_index=index,
                instance=instance,
                origin_m=plan.origin_m,
                seed=search.seed,
                hyper=search.hyper,
                stored=stored,
                facts=plan.facts,
            )
        scene = stored.adversarial(scene)
        earlier = (*earlier, Earlier(search.key(unit), index, agent_id, stored.start))
    return (
        f"{plan.name} cannot be traced: the finished search for {agent_id} is not in {search.state}; run the same "
        "challenger-bench generate again"
    )


def _traced(prior: PriorFactory, searched: Searched | str) -> bytes | str:
    """Content of ``rounds.json``, or why there is none; runs in a worker."""
    if isinstance(searched, str):
        return searched
    try:
        made = trace(searched, prior())
    except InputError as problem:
        return str(problem)
    return (canonical_json(made.model_dump(mode="json", by_alias=True)) + "\n").encode()


def _to_standard_error(sentence: str) -> None:
    print(sentence, file=sys.stderr)
