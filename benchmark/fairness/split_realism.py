"""The realism of a split: its adversaries against the recordings that its scenes were made from.

``docs/realism.md``. The reference of an adversary is every run of the agents of its category in the unchanged recording
of its scene; where the recordings are not at hand, the unchanged agents of the scene itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.fairness.ctg import Mask, Normalisation, SceneTracks, Version, deviations, histograms
from benchmark.fairness.data_sets import adversarial_scene, launches_of
from benchmark.fairness.features import Run, recorded_runs, runs_of
from benchmark.fairness.realism import realism_of
from benchmark.fairness.road_edge import RoadEdge
from benchmark.interactions.tracks import STEP_S, Tracks
from benchmark.machine.progress import progress
from benchmark.records.judgement import (
    FAULT_NAMES,
    CtgRow,
    FeatureRealism,
    SceneJudgement,
    SplitRealism,
    ValidityRow,
)
from benchmark.scene import Scene

OWN_TOWN: Final = "n000"
"""Vehicle of the embedded town's recordings (`generation.sources.town.scenes`)."""
OWN_TOWN_REASON: Final = (
    "the recordings are our own town, whose cars are simulated too: a comparison would say nothing about real ones"
)
NO_ADVERSARY: Final = "nobody is known to be an adversary"
TOO_SHORT: Final = "no adversary, or no recorded agent of its category, moves 5 m in 2 s or more of keyframes"
DIGITS: Final = 6


@dataclass(frozen=True, slots=True)
class _Compared:
    """What one scene gives: runs of its adversaries and their reference, and both versions as ``ctg`` sees them."""

    adversaries: list[Run]
    recorded: list[Run]
    scenes: tuple[SceneTracks, SceneTracks] | None


def split_realism(
    data: DataSet,
    judgements: Mapping[str, Sequence[SceneJudgement]],
    recordings: DataSet | None = None,
) -> SplitRealism:
    """Realism of the motion of adversaries in scenes of a data set.

    ``recordings`` is the data set that its scenes were made from, if at hand. Validity rates are there always, the
    comparison where there is something to compare with.
    """
    judged = [each for of_scene in judgements.values() for each in of_scene if each.adversary is not None]
    validity = validity_rows(judged)
    names = [name for name, said in judgements.items() if any(each.adversary is not None for each in said)]
    if not names:
        return SplitRealism(adversaries=0, validity=validity, not_compared=NO_ADVERSARY)
    if data.scene(names[0]).vehicle == OWN_TOWN:
        return SplitRealism(adversaries=len(judged), validity=validity, not_compared=OWN_TOWN_REASON)
    sources = {name: facts.source for name, facts in data.scene_facts(names).items()}
    if recordings is not None and not set(sources.values()) <= set(recordings.scene_names(None)):
        recordings = None
    adversaries: dict[str, list[Run]] = {}
    recorded: dict[str, list[Run]] = {}
    pairs: list[tuple[SceneTracks, SceneTracks]] = []
    seen: set[tuple[str, str]] = set()
    for name in progress(names, total=len(names), label="comparing with recordings"):
        found = _compared(data, name, sources[name], recordings, seen)
        adversaries.setdefault(sources[name], []).extend(found.adversaries)
        recorded.setdefault(sources[name], []).extend(found.recorded)
        pairs += [] if found.scenes is None else [found.scenes]
    realism = realism_of(adversaries, {name: recorded[name] for name in sorted(recorded)})
    if realism is None:
        return SplitRealism(adversaries=len(judged), validity=validity, not_compared=TOO_SHORT)
    which = "the unchanged agents of the same scenes" if recordings is None else f"the recordings {recordings.name}"
    return SplitRealism(
        adversaries=len(judged),
        validity=validity,
        reference=which,
        samples=realism.samples,
        features=tuple(map(_rounded, realism.features)),
        worst=realism.worst.name,
        ctg=_ctg(pairs) if pairs else None,
    )


def validity_rows(judged: Sequence[SceneJudgement]) -> tuple[ValidityRow, ...]:
    """Faults of adversaries, counted: one row for each kind."""
    tracks = [each.faults for each in judged if each.faults is not None]
    rows = []
    for name in FAULT_NAMES:
        asked = [value for value in (getattr(each, name) for each in tracks) if value is not None]
        unknown = sorted({each.unknown[name] for each in tracks if name in each.unknown})
        rows.append(ValidityRow(fault=name, count=sum(asked), of=len(asked), unknown=tuple(unknown)))
    return tuple(rows)


def _compared(
    data: DataSet, name: str, source: str, recordings: DataSet | None, seen: set[tuple[str, str]]
) -> _Compared:
    scene = adversarial_scene(data, name, recordings)
    base = scene if recordings is None else recordings.scene(source)
    agents = [scene.agents.ids.index(each) for each in scene.adversaries if each in scene.agents.ids]
    with_map = not scene.road_map.drivable_area.is_empty and not base.road_map.drivable_area.is_empty
    tracks, launches = Tracks.of_scene(scene), launches_of(data, scene)
    road, last = RoadEdge(scene.road_map.drivable_area) if with_map else None, float(scene.seconds[-1])
    mine = []
    for agent in agents:
        start = float(scene.seconds[launches.get(scene.agents.ids[agent], 0)])
        mine += runs_of(tracks, scene.keyframes, agent, between=(start, last), road=road)
    theirs: list[Run] = []
    for category in sorted({scene.agents.categories[agent] for agent in agents}):
        # Variants of one recording have one reference.
        if (source, category) not in seen:
            seen.add((source, category))
            theirs += recorded_runs(
                Tracks.of_scene(base),
                base.keyframes,
                category,
                without=agents if recordings is None else (),
                road=RoadEdge(base.road_map.drivable_area) if with_map else None,
            )
    scenes = None if recordings is None else (_ten_hz(scene), _ten_hz(base))
    return _Compared(mine, theirs, scenes)


def _ten_hz(scene: Scene) -> SceneTracks:
    """The ego and all vehicles at 10 Hz, as ``ctg-realism@code`` reads them."""
    chosen = [row for row, category in enumerate(scene.agents.categories) if category.startswith("vehicle.")]
    tracks = Tracks.of_scene(scene).only(chosen)
    times = STEP_S * np.arange(int(scene.seconds[-1] / STEP_S + 1e-9) + 1)
    boxes, present = tracks.agents_at(times)
    everybody = np.concatenate([tracks.ego_at(times)[None], np.where(present[..., None], boxes, np.nan)])
    return SceneTracks(everybody[..., :2], everybody[..., 4])


def _ctg(pairs: Sequence[tuple[SceneTracks, SceneTracks]]) -> CtgRow:
    version, normalisation, mask = Version.CTG, Normalisation.SCENE, Mask.CURRENT_SPEED
    ours, theirs = (histograms(scenes, version, normalisation, mask) for scenes in zip(*pairs, strict=True))
    found = deviations(ours, theirs)
    return CtgRow(
        version=version.value,
        normalisation=normalisation.value,
        mask=mask.value,
        mean_real_dev=round(found["mean_real_dev"], DIGITS),
        mean_real_dev_int=round(found["mean_real_dev_int"], DIGITS),
    )


def _rounded(feature: FeatureRealism) -> FeatureRealism:
    numbers: dict[str, Any] = {
        name: round(value, DIGITS) for name, value in asdict(feature).items() if isinstance(value, float)
    }
    if feature.interval is not None:
        low, high = feature.interval
        numbers["interval"] = round(low, DIGITS), round(high, DIGITS)
    return replace(feature, **numbers)
