"""Scenes with one or more adversaries, each planned in the scene that the ones before it made.

Appendix "Extending to Multiple Adversarial Vehicles": the generated scene is fed in again with another vehicle.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

from benchmark.datasets.roots import DataSet
from benchmark.datasets.steps import require_two_hz
from benchmark.machine.progress import track_progress
from benchmark.machine.storage import make_token
from benchmark.machine.workers import Executor
from benchmark.records.attempts import Attempt
from benchmark.records.scene_assessment import SceneAssessment
from benchmark.scene import Scene
from generation.labels.manoeuvres import Manoeuvre
from generation.search.adversary import drive_ego
from generation.search.attempts import StoredAttempt, read_or_compute_eligibility, run_attempts
from generation.search.candidates import Eligibility, find_launch_frame
from generation.search.definition import EarlierAdversary, Search, SearchUnit
from generation.search.manoeuvre_requests import can_perform
from generation.search.ranking import rank_scenes


class DropReason(StrEnum):
    """Why an attempt that passed verification is not written."""

    TOO_FEW_ADVERSARIES = "too-few-adversaries"
    OUTRANKED = "another-vehicle-ranked-higher"
    SURROGATE_COPES = "surrogate-does-not-fail"
    BEYOND_LIMIT = "beyond-the-number-kept"
    REJECTED = "rejected-by-hand"
    INERT = "touches-no-member-of-the-panel"


@dataclass(frozen=True, slots=True)
class SearchAttempt:
    """One attempt, kept or not, with its content key; those that are kept are the links of chains."""

    unit: SearchUnit
    key: str
    stored: StoredAttempt

    @property
    def attempt(self) -> Attempt:
        """Report on it."""
        return self.stored.report

    @property
    def scene_name(self) -> str:
        """Name of the recorded scene."""
        return self.unit.scene_name

    @property
    def agent_id(self) -> str:
        """Instance identifier of the vehicle."""
        return self.unit.agent_id

    @property
    def challenge(self) -> float:
        """Its `ranking.compute_challenge_score`."""
        return self.attempt.challenge


@dataclass(frozen=True, slots=True)
class AdversaryChain:
    """A recorded scene and its adversaries in the order of their planning; none for the recording itself."""

    scene_name: str
    links: tuple[SearchAttempt, ...] = ()

    @property
    def agent_ids(self) -> tuple[str, ...]:
        """Instance identifiers of the adversaries, in order."""
        return tuple(link.agent_id for link in self.links)

    @property
    def agent_id(self) -> str:
        """The same as one text, for the order of equally challenging scenes."""
        return " ".join(self.agent_ids)

    @property
    def challenge(self) -> float:
        """Mean of the adversaries' scores; each of them is about its own vehicle and the ego alone."""
        return sum(link.challenge for link in self.links) / len(self.links)

    @property
    def earlier(self) -> tuple[EarlierAdversary, ...]:
        """Adversaries that the next one finds."""
        return tuple(
            EarlierAdversary(link.key, link.unit.agent, link.agent_id, link.attempt.launch_frame)
            for link in self.links
            if link.attempt.launch_frame is not None
        )

    @property
    def last_rank(self) -> int:
        """Place of the last adversary among all of them in the order of the scene's agents."""
        return sorted(link.unit.agent for link in self.links).index(self.links[-1].unit.agent)

    @property
    def name(self) -> str:
        """Name of the generated scene; it does not depend on the rank."""
        # Several manoeuvres may have been requested from the same vehicle.
        kinds = [link.unit.asked.value for link in self.links if link.unit.asked is not None]
        families = [link.unit.family for link in self.links if link.unit.family]
        suffix = make_token("adversary", self.scene_name, *self.agent_ids, *kinds, *families)[:8]
        return f"{self.scene_name.replace('/', '-')}-{suffix}"

    @property
    def kind(self) -> str:
        """Primary manoeuvre of the last adversary; ``none`` where it has no labels."""
        labels = self.links[-1].attempt.labels
        return "none" if labels is None else labels.manoeuvre

    @property
    def judgements(self) -> tuple[SceneAssessment, ...]:
        """Judgement on each adversary in the scene with all of them."""
        return self.links[-1].attempt.judgements

    def adversarial(self, scene: Scene) -> Scene:
        """The generated scene: the recorded one with all adversaries."""
        for link in self.links:
            scene = link.stored.adversarial(scene)
        return scene

    def report(self) -> dict[str, Any]:
        """Report for ``challenger.json`` on the scene: the adversary's report, or one for each of several.

        Judgements are elsewhere (`benchmark.datasets.scene_assessments`): better definitions make no other data set.
        """
        left_out = {"plans", "judgements"}
        reports = [link.attempt.model_dump(mode="json", exclude_unset=True, exclude=left_out) for link in self.links]
        if len(reports) == 1:
            return reports[0]
        return {"challenge": self.challenge, "adversaries": reports}


@dataclass(frozen=True, slots=True)
class RequestCounts:
    """Requests for one kind of manoeuvre; ``tried`` counts vehicles that drive in a direction that allows it."""

    vehicles: int = 0
    tried: int = 0


@dataclass(slots=True)
class SearchResult:
    """Outcome of a search; ``eligibility`` pairs each look at a scene's vehicles with the adversaries by then."""

    eligibility: list[tuple[tuple[str, ...], Eligibility]] = field(default_factory=list)
    tried: list[SearchAttempt] = field(default_factory=list)
    chains: list[AdversaryChain] = field(default_factory=list)
    dropped: dict[SearchUnit, DropReason] = field(default_factory=dict)
    requests: dict[Manoeuvre, RequestCounts] = field(default_factory=dict)

    def add(self, other: "SearchResult") -> None:
        """Add what a further search of the same recordings found."""
        self.eligibility += other.eligibility
        self.tried += other.tried
        self.chains += other.chains
        self.dropped |= other.dropped

    def drop(self, chain: AdversaryChain, reason: DropReason) -> None:
        """Note that the adversaries of a chain are not written."""
        self.dropped.update({link.unit: reason for link in chain.links})

    def count_requests(self, kinds: Sequence[Manoeuvre], vehicles: int, units: Sequence[SearchUnit]) -> None:
        """Count what the vehicles of one scene were asked for."""
        for kind in kinds:
            before = self.requests.get(kind, RequestCounts())
            unit_count = sum(unit.asked is kind for unit in units)
            self.requests[kind] = RequestCounts(before.vehicles + vehicles, before.tried + unit_count)


def find_first_units(
    search: Search, source: DataSet, names: Sequence[str], *, keep: bool
) -> list[tuple[Eligibility, list[SearchUnit]]]:
    """Vehicles that are tried first in each recorded scene, with the units of each; ``keep`` writes the choice."""
    scenes = _ChainScenes(source)
    return [_choose_vehicles(search, AdversaryChain(name), scenes, keep=keep) for name in names]


def search_chains(
    search: Search,
    source: DataSet,
    names: Sequence[str],
    executor: Executor,
    *,
    adversaries: int = 1,
    together: int = 1,
    keep_rounds: bool = False,
    keep: bool = True,
) -> SearchResult:
    """Search for scenes with a number of adversaries in each, with the same result on every executor.

    Every vehicle that is chosen in a recorded scene and passes verification begins a chain. In each chain, vehicles
    are chosen again and tried; the one that challenges most goes on, and a chain in which none passes is dropped.
    ``keep_rounds`` keeps rounds of the last adversary of each chain: the others are as they are shown.
    """
    result, scenes = SearchResult(), _ChainScenes(source)
    chains = [AdversaryChain(name) for name in names]
    for stage in range(adversaries):
        looking = (_choose_vehicles(search, chain, scenes, keep=keep) for chain in chains)
        chosen = list(track_progress(looking, total=len(chains), label="choosing vehicles"))
        result.eligibility += [(chain.agent_ids, vehicles) for chain, (vehicles, _) in zip(chains, chosen, strict=True)]
        owner = {unit: chain for chain, (_, units) in zip(chains, chosen, strict=True) for unit in units}
        scene_of = functools.partial(_read_scene, scenes, owner)
        label = "planning adversaries" if stage == 0 else f"planning adversary {stage + 1} of {adversaries}"
        results = run_attempts(
            search,
            list(owner),
            scene_of,
            executor,
            together=together,
            keep_rounds=keep_rounds and stage == adversaries - 1,
            label=label,
        )
        attempted = [SearchAttempt(unit, search.key(unit), stored) for unit, stored in zip(owner, results, strict=True)]
        result.tried += attempted
        for vehicles, units in chosen:
            result.count_requests(search.asked, len(vehicles.chosen), units)
        links = [attempt for attempt in attempted if attempt.attempt.kept]
        chains = _start_chains(links) if stage == 0 else _extend_chains(result, chains, links)
    result.chains = chains
    return result


def _start_chains(links: Sequence[SearchAttempt]) -> list[AdversaryChain]:
    return [AdversaryChain(link.scene_name, (link,)) for link in links]


def _extend_chains(
    result: SearchResult, chains: Sequence[AdversaryChain], links: Sequence[SearchAttempt]
) -> list[AdversaryChain]:
    """Each chain with the most challenging of its new adversaries; chains without any are dropped."""
    of_chain: dict[tuple[str, tuple[EarlierAdversary, ...]], list[SearchAttempt]] = {}
    for link in links:
        of_chain.setdefault((link.scene_name, link.unit.earlier), []).append(link)
    longer = []
    for chain in chains:
        new = of_chain.get((chain.scene_name, chain.earlier))
        if new is None:
            result.drop(chain, DropReason.TOO_FEW_ADVERSARIES)
            continue
        best, *others = rank_scenes(new, per_scene=None, total=None)
        result.dropped.update({link.unit: DropReason.OUTRANKED for link in others})
        longer.append(replace(chain, links=(*chain.links, best)))
    return longer


def _read_scene(scenes: "_ChainScenes", owner: Mapping[SearchUnit, AdversaryChain], unit: SearchUnit) -> Scene:
    return scenes.of(owner[unit])


def _choose_vehicles(
    search: Search, chain: AdversaryChain, scenes: "_ChainScenes", *, keep: bool
) -> tuple[Eligibility, list[SearchUnit]]:
    vehicles = read_or_compute_eligibility(search, chain.scene_name, chain.earlier, lambda: scenes.of(chain), keep=keep)
    units = [
        SearchUnit(chain.scene_name, vehicle.agent, vehicle.agent_id, chain.earlier, family=search.family)
        for vehicle in vehicles.chosen
    ]
    if not search.asked:
        return vehicles, units
    scene = drive_ego(scenes.of(chain), search.hyper.ego)
    starts = [find_launch_frame(scene, unit.agent, search.hyper) for unit in units]
    return vehicles, [
        replace(unit, asked=kind)
        for unit, start in zip(units, starts, strict=True)
        for kind in search.asked
        if start is not None and can_perform(kind, scene, unit.agent, start)
    ]


class _ChainScenes:
    """Scenes of chains; the one asked for last is kept, because its vehicles are tried one after the other."""

    def __init__(self, source: DataSet) -> None:
        self._source = source
        self._last: tuple[AdversaryChain, Scene] | None = None

    def of(self, chain: AdversaryChain) -> Scene:
        """The recorded scene with the chain's adversaries in it."""
        if self._last is None or self._last[0] is not chain:
            scene = self._source.scene(chain.scene_name)
            require_two_hz(scene, "the search")
            self._last = (chain, chain.adversarial(scene))
        return self._last[1]
