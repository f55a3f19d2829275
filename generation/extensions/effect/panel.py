"""Choice of scenes by effect: how often planners of a panel would touch the adversary, and which kinds are new."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.roots import DataSet
from benchmark.datasets.sample_truth import compute_truth
from benchmark.geometry import Floats
from benchmark.interactions.driver_outcomes import CollisionChecker
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.planning import PrivilegedPlanner, SceneInfo
from benchmark.protocols import find_protocol
from benchmark.protocols.contract import CollisionProtocol
from benchmark.protocols.raster import HIT_ADVERSARY
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from generation.pipeline.panel import PlannerPanel
from generation.search.chains import AdversaryChain

DISTRACTED: Final = "distracted"
LATE_S: Final = 1.0
"""How much later than a careful human the distracted driver answers."""
HORIZONS_S: Final = (1.0, 2.0, 3.0)
DIGITS: Final = 6
ALIKE: Final = 0.15
"""How many times its probability a scene is worth less for each kept one of its kind: p / (1 + this x kept)."""


@dataclass(frozen=True, slots=True)
class SceneEffect:
    """Share of the samples of a scene in which each run of the panel touches the adversary, by member.

    The mean of those within 1, 2 and 3 s, as in every table.
    """

    name: str
    kind: str
    adversaries: tuple[str, ...]
    runs: Mapping[str, tuple[float, ...]]

    @property
    def encounter(self) -> tuple[str, ...]:
        """Who does what: in a recording once is enough."""
        return (self.kind, *self.adversaries)

    @property
    def members(self) -> dict[str, float]:
        """Means over the seeds of each member."""
        return {name: round(float(np.mean(rates)), DIGITS) for name, rates in self.runs.items()}

    @property
    def probability(self) -> float:
        """Of the members together: their mean, weighted by the root of their seeds."""
        weights = [len(rates) ** 0.5 for rates in self.runs.values()]
        return round(float(np.average(list(self.members.values()), weights=weights)), DIGITS)


def rank_by_effect(
    source: DataSet, chains: Sequence[AdversaryChain], panel: PlannerPanel
) -> tuple[list[AdversaryChain], list[AdversaryChain], dict[str, Any]]:
    """Scenes in the order in which they should be kept, inert ones, and what is said of both.

    The next one is that with the largest probability that a member of the panel touches the adversary, divided by
    1 + `ALIKE` times the earlier ones of the same primary manoeuvre. In inert scenes none ever does.
    """
    effects = {
        chain.name: effect
        for scene in dict.fromkeys(chain.scene_name for chain in chains)
        for chain, effect in _measure_recording(source, scene, chains, panel)
    }
    by_name = {chain.name: chain for chain in chains}
    recordings = {chain.name: chain.scene_name for chain in chains}
    order = order_scenes(effects, recordings, panel.per_scene)
    inert = [chain for chain in chains if chain.name not in set(order)]
    said = {
        **panel.as_json(),
        "distracted_late_s": LATE_S,
        "inert": len(inert),
        "scenes": {name: {"probability": effects[name].probability, **effects[name].members} for name in order},
    }
    return [by_name[name] for name in order], inert, said


def order_scenes(effects: Mapping[str, SceneEffect], recordings: Mapping[str, str], per_scene: int) -> list[str]:
    """Names of scenes that are not inert, in the order in which they should be kept.

    Args:
        effects: Effect of each scene, by name.
        recordings: Recording of each.
        per_scene: Scenes of a recording that are kept, of which the same adversary does something else in each; further
            ones come last and count for no kind.

    Returns:
        The names.
    """
    rest = sorted(name for name, effect in effects.items() if effect.probability > 0.0)
    order: list[str] = []
    kinds: Counter[str] = Counter()
    taken: Counter[str] = Counter()
    used: set[tuple[str, ...]] = set()

    def worth(name: str) -> tuple[bool, float, float]:
        effect = effects[name]
        value = effect.probability / (1.0 + ALIKE * kinds[effect.kind])
        fits = taken[recordings[name]] < per_scene and effect.encounter not in used
        return fits, value, effect.probability

    while rest:
        best = max(rest, key=worth)
        rest.remove(best)
        order.append(best)
        counts = worth(best)[0]
        kinds[effects[best].kind] += counts
        taken[recordings[best]] += counts
        used.add(effects[best].encounter)
    return order


def _measure_recording(
    source: DataSet, name: str, chains: Sequence[AdversaryChain], panel: PlannerPanel
) -> list[tuple[AdversaryChain, SceneEffect]]:
    """Effect of each chain of one recording; the ego drives as recorded, and so all have the same plans."""
    scene = source.scene(name)
    plans = {member: _plan(source, scene, member, seeds, panel) for member, seeds in panel.members}
    return [
        (chain, measure_effect(chain.name, chain.adversarial(scene), chain.kind, plans))
        for chain in chains
        if chain.scene_name == name
    ]


def measure_effect(name: str, scene: Scene, kind: str, plans: Mapping[str, Sequence[Floats]]) -> SceneEffect:
    """Effect of an adversarial scene: (K, 6, 2) plans of each seed of each member, lidar frame, NaN for no plan.

    A member touches the adversary in a sample if the first contact of its plan under ``exact`` is with it; the
    distracted driver in those whose 3 s hold its contact.
    """
    truths, exact = compute_truth(scene, [""] * len(scene.keyframes)), find_protocol("exact")
    runs = {
        member: tuple(_measure_plans(exact, truths, waypoints) for waypoints in seeds)
        for member, seeds in plans.items()
    }
    late = (_measure_distracted(scene),)
    return SceneEffect(name, kind, tuple(sorted(scene.adversaries)), {**runs, DISTRACTED: late})


def _measure_plans(exact: CollisionProtocol, truths: Sequence[SampleTruth], waypoints: Floats) -> float:
    """Share of the samples in which a plan first touches an adversary, mean over the horizons."""
    known = np.flatnonzero(np.isfinite(waypoints).all(axis=(1, 2)))
    outcomes = exact.evaluate([truths[index] for index in known.tolist()], waypoints[known])
    hit = np.array([value is True for value in outcomes.facts[HIT_ADVERSARY]], np.bool_) & outcomes.counted
    steps = np.rint(np.array(HORIZONS_S) / PLAN_STEP_S).astype(np.int64) - 1
    touched = np.maximum.accumulate(outcomes.collision, axis=1)[:, steps] & hit[:, None]
    return float(touched.mean(axis=1).sum() / max(outcomes.counted.sum(), 1))


def _measure_distracted(scene: Scene) -> float:
    """Share of the samples from which the distracted driver soon touches an adversary, mean over the horizons."""
    situation = DrivingSituation.of(ContinuousTracks.of_scene(scene))
    late = ReferenceDriver(Driver.CC, late_steps=round(LATE_S / STEP_S))
    (motion,) = simulate_drivers(situation, [late])
    contact = CollisionChecker.of(situation).find_outcome(motion).contact
    if contact is None or scene.agents.ids[contact.agent] not in scene.adversaries:
        return 0.0
    left = contact.time - scene.seconds[scene.keyframes][:, None]
    soon = (left > 0.0) & (left <= np.array(HORIZONS_S))
    return float(soon.mean(axis=1).sum() / max(len(left) - PLAN_STEPS, 1))


def _plan(source: DataSet, scene: Scene, member: str, seeds: int, panel: PlannerPanel) -> list[Floats]:
    """(K, 6, 2) plans of each seed of a member in a recorded scene, lidar frame; NaN where it has none."""
    truths, observations = source.truth(scene.name), list(source.observations(scene.name))
    planned = []
    for seed in range(seeds):
        planner = panel.make(member, seed=seed)
        planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        if isinstance(planner, PrivilegedPlanner):
            planner.reveal(scene)
        planned.append(
            np.array([
                planner.plan(seen).judged.waypoints_in_lidar(truth.lidar_ahead_m)
                for seen, truth in zip(observations, truths, strict=True)
            ])
        )  # fmt: skip
    return planned
