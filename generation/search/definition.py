"""Definition of an attempt: recordings, settings, diffusion model and vehicle; its content keys."""

import functools
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.machine.several_devices import find_device_in_turn
from benchmark.machine.storage import content_key
from benchmark.records.scene_assessment import DEFINITION
from generation.diffusion.prior import SamplerSettings, TrajectoryPrior
from generation.labels.manoeuvres import Manoeuvre
from generation.search.adversary import ALGORITHM_VERSION
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Prior
from generation.search.refinement import SHOWN_CANDIDATES

PriorFactory = Callable[[], Prior]
"""Gives the same prior in any process. Must be picklable."""
TRACE_VERSION: Final = "1"
"""Changes when the rounds of the same search would be written in another way."""


@dataclass(frozen=True, slots=True)
class PackagedPrior:
    """The diffusion model, loaded once in each process; ``weights`` of ``None`` are those in the package.

    Of several ``device`` names, between commas, each worker takes one in turns.
    """

    weights: Path | None = None
    device: str = "cpu"
    sampler: SamplerSettings = field(default_factory=SamplerSettings)

    def __call__(self) -> Prior:
        """The model."""
        return _load_prior(self.weights, find_device_in_turn(self.device), self.sampler)


@functools.lru_cache(maxsize=2)
def _load_prior(weights: Path | None, device: str, sampler: SamplerSettings) -> TrajectoryPrior:
    return TrajectoryPrior.load(weights, sampler, device=device)


@dataclass(frozen=True, slots=True)
class EarlierAdversary:
    """An adversary of a scene: content ``key`` of the attempt that made it, and frame ``start`` of its launch."""

    key: str
    agent: int
    agent_id: str
    start: int


@dataclass(frozen=True, slots=True)
class SearchUnit:
    """One vehicle of one scene of the source; ``earlier`` adversaries are in the order of their planning."""

    scene_name: str
    agent: int
    agent_id: str
    earlier: tuple[EarlierAdversary, ...] = ()
    asked: Manoeuvre | None = None
    family: str = ""


@dataclass(frozen=True, slots=True)
class Search:
    """Everything that decides what an attempt gives.

    ``asked`` are kinds of manoeuvre that every vehicle is asked for, one attempt each; none for one free attempt.
    ``further`` searches of the same recordings have these settings; ``family`` tells their attempts from the first's.
    """

    fingerprint: str
    hyper: HyperParameters
    seed: int
    prior: PriorFactory
    prior_fingerprint: str
    state: Path
    timings: Path
    asked: tuple[Manoeuvre, ...] = ()
    further: tuple[HyperParameters, ...] = ()
    family: str = ""

    @property
    def hyper_fingerprint(self) -> str:
        """Content key of the settings, of further searches too."""
        own = self.hyper.fingerprint
        return content_key(own, *(hyper.fingerprint for hyper in self.further)) if self.further else own

    @property
    def families(self) -> "tuple[Search, ...]":
        """Itself without the further searches, and each of those; settings that occur again draw by the next seed."""
        found = [replace(self, further=())]
        for hyper in self.further:
            again = sum(one.hyper == hyper for one in found)
            name = hyper.fingerprint[:8] + (f"-{again}" if again else "")
            found.append(replace(self, hyper=hyper, further=(), family=name, seed=self.seed + again))
        return tuple(found)

    def key(self, unit: SearchUnit) -> str:
        """Content key of one attempt."""
        parts = (self.fingerprint, unit.scene_name, unit.agent_id, self.seed, self.hyper.fingerprint)
        chain = [[link.key for link in unit.earlier]] if unit.earlier else []
        verdict = {"judged": DEFINITION, "solvable": self.hyper.solvable}
        request = [] if unit.asked is None else [{"asked": unit.asked.value}]
        return content_key("attempt", ALGORITHM_VERSION, *parts, self.prior_fingerprint, *chain, verdict, *request)

    def rounds_path(self, unit: SearchUnit) -> Path:
        """File of the rounds of one kept attempt."""
        return self.state / "rounds" / f"{self.key(unit)}.json"

    def timing_path(self, key: str) -> Path:
        """File that says how long an attempt took, by its content key; no result depends on it."""
        return self.timings / "attempts" / f"{key}.timing.json"

    def compute_eligibility_key(self, scene_name: str, earlier: tuple[EarlierAdversary, ...]) -> str:
        """Content key of one choice of vehicles."""
        chain = [link.key for link in earlier]
        parts = (self.fingerprint, scene_name, self.seed, self.hyper.fingerprint, chain)
        return content_key("survey", ALGORITHM_VERSION, *parts)

    def as_json(self) -> dict[str, Any]:
        """Everything that decided the attempts of a build, for ``search.json``."""
        return {
            "algorithm": ALGORITHM_VERSION,
            "source": self.fingerprint,
            "seed": self.seed,
            "prior": self.prior_fingerprint,
            "sampler": asdict(self.prior.sampler) if isinstance(self.prior, PackagedPrior) else None,
            "hyper": asdict(self.hyper),
            "hyper_fingerprint": self.hyper_fingerprint,
            **({"further": [asdict(hyper) for hyper in self.further]} if self.further else {}),
            **({"asked": [kind.value for kind in self.asked]} if self.asked else {}),
        }

    def rounds_metadata(self, unit: SearchUnit) -> dict[str, Any]:
        """Facts on the search that the rounds of an attempt keep."""
        return {
            "trace": TRACE_VERSION,
            "algorithm": ALGORITHM_VERSION,
            "source": self.fingerprint,
            "seed": self.seed,
            "hyper": self.hyper.fingerprint,
            "prior": self.prior_fingerprint,
            "candidates": self.hyper.candidates,
            "shown": min(SHOWN_CANDIDATES, self.hyper.candidates),
            "step_s": FRAMES_PER_KEYFRAME / FRAME_HZ,
            "executed_s": self.hyper.executed_frames / FRAME_HZ,
            "scored_s": self.hyper.scored_frames[-1] / FRAME_HZ,
            "attempt": self.key(unit),
        }
