"""Attempts as resumable work: found by content key on disk, computed where missing, on any number of processes."""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.scene import Scene
from benchmark.storage import content_key, read_kept_json, write_json
from benchmark.workers import map_ordered
from generation.adversary import ALGORITHM_VERSION, Attempt, attempt
from generation.candidates import choose
from generation.diffusion.prior import TrajectoryPrior
from generation.hyperparameters import HyperParameters


@dataclass(frozen=True, slots=True)
class SourceReference:
    """How a worker process finds the data set again.

    Attributes:
        root: Folder.
        version: Version folder.
        name: Name of the data set.
    """

    root: Path
    version: str
    name: str

    @classmethod
    def of(cls, source: DataSet) -> "SourceReference":
        """Refer to an open data set; this process goes on with the open one."""
        reference = cls(source.root, source.version, source.name)
        _opened[reference] = source
        return reference

    def open(self) -> DataSet:
        """The data set, opened once in each process."""
        if self not in _opened:
            _opened[self] = open_data(self.root, version=self.version, name=self.name)
        return _opened[self]


_opened: dict[SourceReference, DataSet] = {}


@dataclass(frozen=True, slots=True)
class Search:
    """Everything that decides what an attempt gives.

    Attributes:
        source: Where the scenes are.
        fingerprint: Of the data set.
        hyper: Settings of the search.
        seed: User's seed.
        weights: Weights of the prior, ``None`` for the packaged ones.
        prior_fingerprint: Of the prior.
        folder: Where finished attempts are kept.
    """

    source: SourceReference
    fingerprint: str
    hyper: HyperParameters
    seed: int
    weights: Path | None
    prior_fingerprint: str
    folder: Path

    def key(self, unit: "Unit") -> str:
        """Content key of one attempt."""
        return content_key(
            "attempt",
            ALGORITHM_VERSION,
            self.fingerprint,
            unit.scene_name,
            unit.agent_id,
            self.seed,
            self.hyper.fingerprint,
            self.prior_fingerprint,
        )

    def path(self, unit: "Unit") -> Path:
        """File of one finished attempt."""
        return self.folder / f"{self.key(unit)}.json"


@dataclass(frozen=True, slots=True)
class Unit:
    """One vehicle of one scene.

    Attributes:
        scene_name: Name in the source.
        agent: Index of the vehicle.
        agent_id: Its instance identifier.
    """

    scene_name: str
    agent: int
    agent_id: str


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
        """The kept scene, from the recorded one.

        Args:
            scene: The recorded scene.

        Returns:
            The scene with the stored track.

        Raises:
            InputError: If the attempt was discarded or belongs to another scene.
        """
        if not self.kept or self.start is None or scene.agents.ids[self.agent] != self.agent_id:
            raise InputError(
                f"the stored attempt for {self.agent_id} in {self.scene_name} does not fit this scene; delete the "
                ".challenger folder of the output and run again"
            )
        poses: Floats = np.array(self.poses, dtype=np.float64)
        return scene.with_adversary(self.agent, slice(self.start, self.start + len(poses)), poses)


def candidates_of(
    source: SourceReference, scene_names: Sequence[str], hyper: HyperParameters, seed: int, *, workers: int
) -> list[Unit]:
    """Vehicles to try, in the order of the scenes.

    Args:
        source: Where the scenes are.
        scene_names: Which scenes.
        hyper: Limits of the choice.
        seed: Which choice.
        workers: Processes.

    Returns:
        The units of work.
    """
    job = functools.partial(_candidates_of_scene, source, hyper, seed)
    found = map_ordered(job, list(scene_names), workers=workers, label="choosing vehicles")
    return [unit for units in found for unit in units]


def _candidates_of_scene(source: SourceReference, hyper: HyperParameters, seed: int, scene_name: str) -> list[Unit]:
    scene = source.open().scene(scene_name)
    return [Unit(scene_name, agent, scene.agents.ids[agent]) for agent in choose(scene, hyper, seed)]


def attempts(search: Search, units: Sequence[Unit], *, workers: int) -> Iterator[StoredAttempt]:
    """Results of the units in their order; finished ones are read, missing ones are computed and kept.

    Args:
        search: What decides the results.
        units: Vehicles to try.
        workers: Processes; the results do not depend on it.

    Yields:
        One stored attempt per unit.
    """
    yield from map_ordered(
        functools.partial(_finished_attempt, search), list(units), workers=workers, label="planning adversaries"
    )


def _finished_attempt(search: Search, unit: Unit) -> StoredAttempt:
    path = search.path(unit)
    kept = _kept_attempt(path, unit)
    if kept is not None:
        return kept
    scene = search.source.open().scene(unit.scene_name)
    result = attempt(scene, unit.agent, search.seed, search.hyper, packaged_prior(search.weights))
    stored = StoredAttempt.of(unit, result)
    write_json(path, stored.model_dump(mode="json"), indent=None)
    return stored


def _kept_attempt(path: Path, unit: Unit) -> StoredAttempt | None:
    try:
        stored = StoredAttempt.model_validate(read_kept_json(path))
    except ValidationError:
        # A damaged file is unfinished work: it is made again.
        return None
    same_unit = (stored.scene_name, stored.agent, stored.agent_id) == (unit.scene_name, unit.agent, unit.agent_id)
    return stored if same_unit else None


@functools.lru_cache(maxsize=2)
def packaged_prior(weights: Path | None) -> TrajectoryPrior:
    """The diffusion model, loaded once in each process."""
    return TrajectoryPrior.load(weights)
