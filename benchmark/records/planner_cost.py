"""Cost of a planner: the latency of each sample and the memory of each scene, stored beside the records.

Costs are the clock's and the machine's: they lie in ``<out>/timings``, so that records of two machines are equal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from glob import escape
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, read_json, write_json, writing_to
from benchmark.records.run_schema import LABELS, PlannerFacts
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored
from benchmark.untrusted.files import RECORD

COLD_SAMPLES: Final = 2
"""The first samples of a scene are not counted: weights are fetched, memory of the past is filled."""

_Positive = Annotated[float, Field(ge=0.0)]


class SceneCost(Stored):
    """Time and memory that planning one scene took, while ``workers`` processes planned on the machine.

    ``planning_s`` is by the clock, with reading images and writing plans down. ``latency_s`` is from asking to the plan
    for each sample in time order, after the device is done; null where the planner failed. Peaks are of the process,
    the harness included (null where the system does not tell or the planner runs elsewhere), and on the GPU (null
    without one).

    Attributes:
        peak_memory_mb: Of the process.
        peak_device_mb: On the GPU.
        device: Where the network ran.
    """

    planning_s: _Positive
    latency_s: list[_Positive | None]
    peak_memory_mb: _Positive | None
    peak_device_mb: _Positive | None
    device: str
    workers: int = Field(default=1, ge=1)


class PlannerCost(Stored):
    """Time and memory that a planner took on a split, by scene; those of scenes planned before stay.

    ``planner`` is a content key: costs of another version are of another planner.

    Attributes:
        schema_version: Version of the format.
        scenes: Cost by scene.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    planner: str
    scenes: dict[str, SceneCost]

    def warm_s(self) -> list[float]:
        """Latencies of the samples that count, by scene and time."""
        warm_latencies = (
            latency for scene in sorted(self.scenes) for latency in self.scenes[scene].latency_s[COLD_SAMPLES:]
        )
        return [latency for latency in warm_latencies if latency is not None]


@dataclass(frozen=True, slots=True)
class CostSummary:
    """Numbers of a planner's cost; ``None`` where no latency counts, or no scene has the memory.

    ``samples`` is how many latencies count, ``workers`` the most processes at a time.
    """

    samples: int
    median_s: float | None
    p95_s: float | None
    peak_memory_mb: float | None
    peak_device_mb: float | None
    devices: tuple[str, ...]
    workers: int


def summarise_cost(cost: PlannerCost) -> CostSummary:
    """Put a cost of at least one scene into numbers."""
    warm, scenes = np.array(cost.warm_s()), list(cost.scenes.values())
    return CostSummary(
        len(warm),
        float(np.median(warm)) if warm.size else None,
        float(np.percentile(warm, 95)) if warm.size else None,
        _greatest([scene.peak_memory_mb for scene in scenes]),
        _greatest([scene.peak_device_mb for scene in scenes]),
        tuple(sorted({scene.device for scene in scenes})),
        max(scene.workers for scene in scenes),
    )


def _greatest(values: Sequence[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def cost_path(timings: Path, out: Path, directory: Path) -> Path:
    """File of the cost of a run: below ``timings``, since it is part of no record; run directories are in ``out``."""
    relative = directory.relative_to(out)
    return timings / relative.parent / f"{relative.name}.timing.json"


def shard_cost_path(whole: Path, number: int, of: int) -> Path:
    """File of the cost of one shard, counted from 1; no other process writes it. ``whole`` is from `cost_path`."""
    return whole.with_name(f"{whole.name.removesuffix('.timing.json')}.shard-{number}-of-{of}.timing.json")


def gather_costs(whole: Path, facts: PlannerFacts) -> None:
    """Put what the shards of a run noted into the note of the run, which is at ``whole``, from `cost_path`."""
    scenes: dict[str, SceneCost | None] = {}
    stem = escape(whole.name.removesuffix(".timing.json"))
    parts = sorted(whole.parent.glob(f"{stem}.shard-*-of-*.timing.json"))
    for part in parts:
        try:
            known = read_matching_cost(part, facts)
        except InputError:
            # Costs are optional; a damaged file counts as missing.
            continue
        scenes |= {} if known is None else known.scenes
    if scenes:
        note_cost(whole, facts, scenes)
    for part in parts:
        with writing_to(part):
            part.unlink(missing_ok=True)


def note_cost(path: Path, facts: PlannerFacts, scenes: Mapping[str, SceneCost | None]) -> None:
    """Note what a planner took in a file from `cost_path`; notes of scenes that are ``None`` stay."""
    who = _identify_version(facts)
    try:
        known = read_cost(path)
    except InputError:
        # Costs are optional; a damaged file is written again.
        known = None
    before = known.scenes if known is not None and known.planner == who else {}
    new_costs = {scene: cost for scene, cost in scenes.items() if cost is not None}
    merged = {scene: cost for scene, cost in {**before, **new_costs}.items() if scene in scenes}
    noted = PlannerCost(schema=1, planner=who, scenes=dict(sorted(merged.items())))
    write_json(path, noted.model_dump(mode="json", by_alias=True))


def read_cost(path: Path) -> PlannerCost | None:
    """Cost of a planner, or ``None`` where none was noted, or in a format of before."""
    if not path.is_file():
        return None
    stored = read_json(path, RECORD)
    if isinstance(stored, dict) and set(stored) == {"planning_s"}:
        return None
    return validate_stored(PlannerCost.model_validate, stored, partial(_format_damage, path))


def read_matching_cost(path: Path, facts: PlannerFacts) -> PlannerCost | None:
    """`read_cost` of a run; ``None`` also where it is that of another version of the planner, or of no scene."""
    cost = read_cost(path)
    return cost if cost is not None and cost.scenes and cost.planner == _identify_version(facts) else None


def _identify_version(facts: PlannerFacts) -> str:
    # The published name of a planner does not affect its cost.
    return content_key(facts.model_dump(mode="json", exclude=LABELS))


def _format_damage(path: Path, where: str, why: str) -> str:
    return f"{path} is not a valid planner cost file of eval: {where or 'the whole'}: {why}; delete it"
