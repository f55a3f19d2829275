"""Which vehicle of a scene becomes the adversary of a drive, from when on, and its policy."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.agent_policy import AgentPolicy
from benchmark.closed_loop.default_engine import PRIMING_STEPS
from benchmark.errors import InputError
from benchmark.machine.identity_cache import IdentityCache
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.ego_prediction import hide_future
from generation.extensions.reactive_adversary.policy import ReactiveAdversary
from generation.extensions.reactive_adversary.settings import AdversarySettings, EgoPrediction
from generation.search.candidates import compute_eligibility, compute_nearness, find_launch_frame
from generation.search.definition import PackagedPrior, PriorFactory
from generation.search.hyperparameters import HyperParameters


@dataclass(frozen=True, slots=True)
class ReactiveAdversaryMaker:
    """Maker of adversaries that are planned while a planner drives (`AdversaryFactory`)."""

    settings: AdversarySettings
    prior: PriorFactory = field(default_factory=PackagedPrior)
    prior_fingerprint: str = ""

    @classmethod
    def of(cls, settings: AdversarySettings, prior: PriorFactory | None = None) -> "ReactiveAdversaryMaker":
        """The maker; the packaged model by default."""
        factory = prior or PackagedPrior()
        return cls(settings, factory, factory().fingerprint)

    @property
    def others(self) -> str:
        """Policy of the others."""
        return self.settings.others

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts on the adversary that is measured."""
        return self.settings.facts(self.prior_fingerprint)

    def possible(self, scene: Scene) -> bool:
        """Whether a scene has an adversary, or a vehicle that the search would try."""
        start_us = int(scene.timestamps_us[scene.keyframes[min(PRIMING_STEPS, len(scene.keyframes) - 1)]])
        return bool(get_vehicles(self._know(scene, start_us), self.settings.hyper))

    def _know(self, scene: Scene, start_us: int) -> Scene:
        """The scene as far as the adversary knows it when a drive starts."""
        return get_known(scene, start_us) if self.settings.knows is EgoPrediction.MOTION_ONLY else scene

    def policy(
        self, scene: Scene, run: int, start_us: int, others: Callable[[int], AgentPolicy[Any]]
    ) -> AgentPolicy[Any]:
        """The policy of a scene; raises `InputError` where no vehicle can become an adversary."""
        scene = self._know(scene, start_us)
        vehicles = get_vehicles(scene, self.settings.hyper)
        if not vehicles:
            raise InputError(f"no vehicle of {scene.name} can become an adversary; leave the scene out with --scenes")
        # A run of who knows motion only has another seed, not another vehicle: that is chosen by what it can do.
        chosen = 0 if self.settings.knows is EgoPrediction.MOTION_ONLY else run % len(vehicles)
        agent = vehicles[chosen]
        start = find_handover_frame(scene, agent, start_us, self.settings.hyper)
        # Imported late: it brings torch, which nothing else in this module needs.
        from generation.diffusion.prior import diversify

        return ReactiveAdversary(scene, agent, start, run, self.settings, others(agent), self.prior(), diversify)


def build_reactive_adversary_maker(**settings: Any) -> ReactiveAdversaryMaker:
    """Maker of the agent of ``drive --agents adversary``; arguments and errors as of `AdversarySettings.of`."""
    return ReactiveAdversaryMaker.of(AdversarySettings.of(**settings))


def _list_vehicles(scene: Scene, hyper: HyperParameters) -> tuple[int, ...]:
    known = [agent for agent, name in enumerate(scene.agents.ids) if name in scene.adversaries]
    if known:
        return tuple(known)
    chosen = [vehicle.agent for vehicle in compute_eligibility(scene, hyper, 0).chosen]
    return tuple(sorted(chosen, key=lambda agent: (-compute_nearness(scene, agent, hyper), agent)))


get_known: Final = IdentityCache[Scene, Scene](hide_future, kept=4)
get_vehicles: Final = IdentityCache[Scene, tuple[int, ...]](_list_vehicles, kept=4)
"""Vehicles that runs take in turn: the adversaries of an adversarial scene, else those that open loop would try, by
how soon they can be in the ego's way."""


def find_handover_frame(scene: Scene, agent: int, start_us: int, hyper: HyperParameters) -> int:
    """Frame at which a vehicle leaves its recording, never before the drive starts, when it has to be there.

    A vehicle of a recording does when open loop would launch it; a known adversary at once, since the ego that it has
    to meet is not where the recording was.
    """
    first_frame = int(np.searchsorted(scene.timestamps_us, start_us))
    launch = 0 if scene.agents.ids[agent] in scene.adversaries else find_launch_frame(scene, agent, hyper)
    valid_frames = np.flatnonzero(scene.agents.valid[agent])
    after = valid_frames[valid_frames >= max(first_frame, launch or 0)]
    if not len(after):
        after = valid_frames[valid_frames >= first_frame]
    if not len(after):
        raise InputError(f"the vehicle {scene.agents.ids[agent]} of {scene.name} leaves before the drive starts")
    return int(after[0])
