"""Attempts as resumable work: found by content key on disk, computed where missing, wherever an executor puts them.

Workers never open the data set: they are sent the scene that they work on.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from benchmark.dynamics.bicycle import MotionModel
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import canonical_json, content_key, read_kept_json, write_bytes, write_json
from benchmark.machine.workers import Executor
from benchmark.scene import Scene
from generation.diffusion.prior import SamplerSettings, TrajectoryPrior
from generation.search.adversary import ALGORITHM_VERSION, Attempt, attempts_together
from generation.search.eligibility import Survey, read_survey, survey
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Prior
from generation.search.verify import verify

PriorFactory = Callable[[], Prior]
"""Gives the same prior in any process. Must be picklable."""
_HASH: Final = "sha256"
"""Field of kept work that says what the others must hash to."""


@dataclass(frozen=True, slots=True)
class PackagedPrior:
    """The diffusion model, loaded once in each process.

    Attributes:
        weights: Its weights, ``None`` for those in the package.
        device: Where the network runs.
        sampler: How the network is asked.
    """

    weights: Path | None = None
    device: str = "cpu"
    sampler: SamplerSettings = field(default_factory=SamplerSettings)

    def __call__(self) -> Prior:
        """The model."""
        return _loaded(self.weights, self.device, self.sampler)


@functools.lru_cache(maxsize=2)
def _loaded(weights: Path | None, device: str, sampler: SamplerSettings) -> TrajectoryPrior:
    return TrajectoryPrior.load(weights, sampler, device=device)


@dataclass(frozen=True, slots=True)
class Earlier:
    """An adversary that a scene has already.

    Attributes:
        key: Content key of the attempt that made it.
        agent: Index of the vehicle.
        agent_id: Its instance identifier.
        start: Frame of its launch.
    """

    key: str
    agent: int
    agent_id: str
    start: int


@dataclass(frozen=True, slots=True)
class Unit:
    """One vehicle of one scene.

    Attributes:
        scene_name: Name in the source.
        agent: Index of the vehicle.
        agent_id: Its instance identifier.
        earlier: Adversaries that the scene has already, in the order in which they were planned.
    """

    scene_name: str
    agent: int
    agent_id: str
    earlier: tuple[Earlier, ...] = ()


@dataclass(frozen=True, slots=True)
class Search:
    """Everything that decides what an attempt gives.

    Attributes:
        fingerprint: Of the data set.
        hyper: Settings of the search.
        seed: User's seed.
        prior: Makes the diffusion model.
        prior_fingerprint: Of the diffusion model.
        state: Where finished work is kept.
    """

    fingerprint: str
    hyper: HyperParameters
    seed: int
    prior: PriorFactory
    prior_fingerprint: str
    state: Path

    def key(self, unit: Unit) -> str:
        """Content key of one attempt."""
        parts = (self.fingerprint, unit.scene_name, unit.agent_id, self.seed, self.hyper.fingerprint)
        chain = [[link.key for link in unit.earlier]] if unit.earlier else []
        return content_key("attempt", ALGORITHM_VERSION, *parts, self.prior_fingerprint, *chain)

    def path(self, unit: Unit) -> Path:
        """File of one finished attempt."""
        return self.state / "attempts" / f"{self.key(unit)}.json"

    def timing_path(self, unit: Unit) -> Path:
        """File that says how long an attempt took; no result depends on it."""
        return self.state / "timing" / "attempts" / f"{self.key(unit)}.timing.json"

    def survey_path(self, scene_name: str, earlier: tuple[Earlier, ...]) -> Path:
        """File of one finished choice of vehicles."""
        chain = [link.key for link in earlier]
        parts = ("survey", ALGORITHM_VERSION, self.fingerprint, scene_name, self.seed, self.hyper.fingerprint, chain)
        return self.state / "surveys" / f"{content_key(*parts)}.json"


class StoredAttempt(BaseModel):
    """A finished attempt on disk: its report and, where it was kept, its track."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = 1
    scene_name: str
    agent: int
    agent_id: str
    kept: bool
    discard: str | None
    start: int | None
    challenge: float
    report: dict[str, Any]
    poses: list[tuple[float, float, float]]

    @classmethod
    def of(cls, unit: Unit, result: Attempt) -> "StoredAttempt":
        """What is stored of an attempt."""
        return cls(
            scene_name=unit.scene_name,
            agent=unit.agent,
            agent_id=unit.agent_id,
            kept=result.kept,
            discard=None if result.discard is None else result.discard.value,
            start=result.start,
            challenge=result.challenge,
            report=result.report(),
            poses=[(float(x), float(y), float(yaw)) for x, y, yaw in result.poses] if result.kept else [],
        )

    def adversarial(self, scene: Scene) -> Scene:
        """The kept scene, from the one that the attempt started from.

        Args:
            scene: The recorded scene, with the earlier adversaries in it.

        Returns:
            The scene with the stored track.

        Raises:
            InputError: If the attempt was discarded or belongs to another scene.
        """
        known = self.agent < len(scene.agents) and scene.agents.ids[self.agent] == self.agent_id
        if not self.kept or self.start is None or not known:
            raise InputError(
                f"the stored attempt for {self.agent_id} in {self.scene_name} does not fit this scene; delete the "
                ".challenger folder of the output and run again"
            )
        poses: Floats = np.array(self.poses, dtype=np.float64)
        return scene.with_adversary(self.agent, slice(self.start, self.start + len(poses)), poses)


def surveyed(
    search: Search, scene_name: str, earlier: tuple[Earlier, ...], read: Callable[[], Scene], *, keep: bool
) -> Survey:
    """Which vehicles of a scene are tried; found on disk, or looked at and kept.

    Args:
        search: What decides the choice.
        scene_name: Name in the source.
        earlier: Adversaries that the scene has already.
        read: Gives the scene with these adversaries; called only where the survey is not there.
        keep: Whether the survey is written.

    Returns:
        The survey.
    """
    path = search.survey_path(scene_name, earlier)
    kept = read_survey(_kept_work(path), scene_name)
    if kept is not None:
        return kept
    found = survey(read(), search.hyper, search.seed)
    if keep:
        _keep_work(path, found.model_dump(mode="json"))
    return found


def kept_attempt(search: Search, unit: Unit) -> StoredAttempt | None:
    """A finished attempt, or ``None`` where there is none or it is damaged."""
    try:
        stored = StoredAttempt.model_validate(_kept_work(search.path(unit)))
    except ValidationError:
        # A damaged file is unfinished work: it is made again.
        return None
    same_unit = (stored.scene_name, stored.agent, stored.agent_id) == (unit.scene_name, unit.agent, unit.agent_id)
    return stored if same_unit else None


def attempts(
    search: Search,
    units: Sequence[Unit],
    scene_of: Callable[[Unit], Scene],
    executor: Executor,
    *,
    together: int = 1,
    label: str = "planning adversaries",
) -> list[StoredAttempt]:
    """Results of the units in their order; finished ones are read, missing ones are computed and kept.

    Args:
        search: What decides the results.
        units: Vehicles to try; those of one scene side by side.
        scene_of: Gives the scene of a unit, with the earlier adversaries in it; called here, for missing units only.
        executor: Where the missing ones are computed; the results do not depend on it.
        together: Units that a worker plans side by side, which pays on an accelerator; no result depends on it.
        label: Text beside the progress bar.

    Returns:
        One stored attempt per unit.

    Raises:
        InputError: If workers are lost, or results cannot be written.
    """
    found = [kept_attempt(search, unit) for unit in units]
    missing = [index for index, stored in enumerate(found) if stored is None]
    batches = [missing[first : first + together] for first in range(0, len(missing), together)]

    def work() -> Iterator[list[tuple[Scene, Unit]]]:
        for batch in batches:
            yield [(scene_of(units[index]), units[index]) for index in batch]

    done = executor.map(functools.partial(_attempted, search), work(), total=len(batches), label=label)
    for batch, results in zip(batches, done, strict=True):
        for index, stored in zip(batch, results, strict=True):
            found[index] = stored
    return [stored for stored in found if stored is not None]


def _attempted(search: Search, work: Sequence[tuple[Scene, Unit]]) -> list[StoredAttempt]:
    """Compute and keep a few attempts; runs in a worker."""
    vehicles = [(scene, unit.agent) for scene, unit in work]
    results = attempts_together(vehicles, search.seed, search.hyper, search.prior())
    kept = []
    for (_, unit), result in zip(work, results, strict=True):
        stored = StoredAttempt.of(unit, _undisturbed(result, unit, search.hyper))
        timing = {"scene": unit.scene_name, "agent": unit.agent_id, "seconds": result.stage_seconds}
        # Before the attempt: whoever finds the attempt finds its time as well.
        write_bytes(search.timing_path(unit), (canonical_json(timing) + "\n").encode(), durable=False)
        _keep_work(search.path(unit), stored.model_dump(mode="json"))
        kept.append(stored)
    return kept


def _keep_work(path: Path, value: dict[str, Any]) -> None:
    """Keep finished work with its own hash, by which damage of any kind is noticed."""
    write_json(path, {**value, _HASH: content_key(value)}, indent=None)


def _kept_work(path: Path) -> dict[str, Any] | None:
    """What `_keep_work` wrote, or ``None`` if it is absent or not exactly that."""
    value = read_kept_json(path)
    if not isinstance(value, dict):
        return None
    written = value.pop(_HASH, None)
    try:
        return value if content_key(value) == written else None
    except ValueError:
        # NaN and infinity are not JSON, although Python reads them: nothing here writes them.
        return None


def _undisturbed(result: Attempt, unit: Unit, hyper: HyperParameters) -> Attempt:
    """The attempt, discarded if an earlier adversary would no longer pass verification beside it."""
    limits = MotionModel.si().limits
    assert limits is not None
    for link in unit.earlier:
        finding = None if result.scene is None else verify(result.scene, link.agent, link.start, hyper, limits)
        if finding is not None:
            return replace(result, finding=finding, challenge=0.0, scene=None)
    return result
