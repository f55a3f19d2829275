"""A split judged: the ladder in sum, how severe its encounters are, how real its adversaries move."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.fairness.ctg import (
    CtgMask,
    CtgNormalisation,
    CtgVersion,
    SceneTracks,
    compute_deviations,
    compute_histograms,
)
from benchmark.fairness.data_set_assessment import assess_data_set, read_adversarial_scene, read_launches
from benchmark.fairness.features import FEATURES, ROAD_EDGE, FeatureRun, RoadEdge, extract_recorded_runs, extract_runs
from benchmark.fairness.realism import Histograms, quantile_bins, w1
from benchmark.geometry import Floats
from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.machine.progress import track_progress
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.records.scene_assessment import (
    DRIVER_NAMES,
    TRACK_DEFECT_NAMES,
    CtgRow,
    FeatureRealism,
    InteractionSeverity,
    ReferenceDriverRun,
    SceneAssessment,
    SplitRealism,
    ValidityRow,
    is_unsolvable,
)
from benchmark.records.statistics import Quantiles, ReferenceDriverSurvival, SeverityRow, SplitAssessment
from benchmark.scene import Scene

BOOTSTRAP_DRAWS: Final = 200
_INTERVAL: Final = (0.025, 0.975)

RunsOfScenes = Mapping[str, Sequence[FeatureRun]]
"""Runs by the name of their scene."""


@dataclass(frozen=True, slots=True)
class Realism:
    """Realism of all features, by the order of `FEATURES`, then `ROAD_EDGE` where all scenes have a map.

    ``samples`` counts those of adversaries, and of recordings.
    """

    features: tuple[FeatureRealism, ...]
    samples: tuple[int, int]

    @property
    def worst(self) -> FeatureRealism:
        """The headline: the feature whose divergence is largest."""
        return min(self.features, key=lambda feature: feature.realism)

    @property
    def mean(self) -> float:
        """Mean over features, which hides one bad feature; never printed alone."""
        return float(np.mean([feature.realism for feature in self.features]))


def measure_realism(adversaries: RunsOfScenes, recorded: RunsOfScenes, seed: int = 0) -> Realism | None:
    """Compare adversaries with recordings, both by scene; ``None`` if one side has no run that counts.

    The reference is in the order of the scenes; every second scene is one half.
    """
    scenes = list(recorded)
    if not any(map(len, adversaries.values())) or not any(map(len, recorded.values())):
        return None
    everything = [run for runs in (*adversaries.values(), *recorded.values()) for run in runs]
    names = (*FEATURES, *([ROAD_EDGE] if all(ROAD_EDGE in run.values for run in everything) else []))
    halves = ({name: recorded[name] for name in scenes[first::2]} for first in (0, 1))
    even, odd = (_pool_features(half, names) for half in halves)
    ours, reference = _pool_features(adversaries, names), _pool_features(recorded, names)
    apart = {name: w1(ours[name], reference[name]) for name in names}
    halves_apart = {name: _measure_both(w1, even[name], odd[name]) for name in names}
    features = tuple(
        FeatureRealism(
            name=name,
            w1=apart[name],
            w1_of_halves=halves_apart[name],
            w1_in_halves=_times(apart[name], halves_apart[name]),
            realism=_compute_realism(ours[name], reference[name]),
            realism_of_halves=_measure_both(_compute_realism, even[name], odd[name]),
            interval=_bootstrap_interval(adversaries, reference[name], name, seed),
        )
        for name in names
    )
    return Realism(features, (len(ours[FEATURES[0]]), len(reference[FEATURES[0]])))


def _compute_realism(sample: Floats, reference: Floats) -> float:
    return 1.0 - quantile_bins(sample, reference).divergence


def _times(value: float, unit: float | None) -> float | None:
    return value / unit if unit else None


def _measure_both(measure: Callable[[Floats, Floats], float], first: Floats, second: Floats) -> float | None:
    return measure(first, second) if len(first) and len(second) else None


def _pool_features(runs: RunsOfScenes, names: Sequence[str]) -> dict[str, Floats]:
    return {
        name: np.concatenate([np.empty(0), *(run.values[name] for some in runs.values() for run in some)])
        for name in names
    }


def _bootstrap_interval(
    adversaries: RunsOfScenes, reference: Floats, name: str, seed: int
) -> tuple[float, float] | None:
    """Scenes of the adversaries are drawn again and again; the recordings stay."""
    scenes = [np.concatenate([run.values[name] for run in runs]) for runs in adversaries.values() if runs]
    if len(scenes) < 2:
        return None
    bins = [quantile_bins(scene, reference) for scene in scenes]
    counts = np.array([histogram.counts for histogram in bins])
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(scenes), size=(BOOTSTRAP_DRAWS, len(scenes)))
    values = [1.0 - Histograms(bins[0].edges, counts[draw].sum(axis=0), bins[0].reference).divergence for draw in drawn]
    low, high = np.quantile(values, _INTERVAL).tolist()
    return low, high


OWN_TOWN: Final = "n000"
"""Vehicle of the embedded town's recordings (`generation.sources.town.scenes`)."""
OWN_TOWN_REASON: Final = (
    "the recordings are our own simulated town: a comparison would not say anything about real traffic"
)
NO_ADVERSARY: Final = "no adversary is known"
TOO_SHORT: Final = "no adversary, or no recorded agent of its category, moves 5 m in 2 s or more of keyframes"
DIGITS: Final = 6


@dataclass(frozen=True, slots=True)
class _SceneComparison:
    """Data of one scene: runs of its adversaries and their reference, and both versions as ``ctg`` sees them."""

    adversaries: list[FeatureRun]
    recorded: list[FeatureRun]
    scenes: tuple[SceneTracks, SceneTracks] | None


def measure_split_realism(
    data: DataSet,
    judgements: Mapping[str, Sequence[SceneAssessment]],
    recordings: DataSet | None = None,
) -> SplitRealism:
    """Realism of the motion of adversaries, compared with ``recordings`` that the scenes were made from, if at hand.

    Validity rates are there always, the comparison where there is something to compare with.
    """
    judged = [
        assessment for of_scene in judgements.values() for assessment in of_scene if assessment.adversary is not None
    ]
    validity = build_validity_rows(judged)
    names = [
        name
        for name, assessments in judgements.items()
        if any(assessment.adversary is not None for assessment in assessments)
    ]
    if not names:
        return SplitRealism(adversaries=0, validity=validity, not_compared=NO_ADVERSARY)
    if data.scene(names[0]).vehicle == OWN_TOWN:
        return SplitRealism(adversaries=len(judged), validity=validity, not_compared=OWN_TOWN_REASON)
    sources = {name: facts.source for name, facts in data.scene_facts(names).items()}
    if recordings is not None and not set(sources.values()) <= set(recordings.scene_names(None)):
        recordings = None
    adversaries: dict[str, list[FeatureRun]] = {}
    recorded: dict[str, list[FeatureRun]] = {}
    pairs: list[tuple[SceneTracks, SceneTracks]] = []
    used_references: set[tuple[str, str]] = set()
    for name in track_progress(names, total=len(names), label="comparing with recordings"):
        scene_comparison = _compare_scene(data, name, sources[name], recordings, used_references)
        adversaries.setdefault(sources[name], []).extend(scene_comparison.adversaries)
        recorded.setdefault(sources[name], []).extend(scene_comparison.recorded)
        pairs += [] if scene_comparison.scenes is None else [scene_comparison.scenes]
    realism = measure_realism(adversaries, {name: recorded[name] for name in sorted(recorded)})
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
        ctg=_compute_ctg_row(pairs) if pairs else None,
    )


def build_validity_rows(judged: Sequence[SceneAssessment]) -> tuple[ValidityRow, ...]:
    """Faults of adversaries, counted: one row for each kind."""
    tracks = [item.faults for item in judged if item.faults is not None]
    rows = []
    for name in TRACK_DEFECT_NAMES:
        known_values = [value for value in (getattr(item, name) for item in tracks) if value is not None]
        unknown = sorted({item.unknown[name] for item in tracks if name in item.unknown})
        rows.append(ValidityRow(fault=name, count=sum(known_values), of=len(known_values), unknown=tuple(unknown)))
    return tuple(rows)


def _compare_scene(
    data: DataSet, name: str, source: str, recordings: DataSet | None, used_references: set[tuple[str, str]]
) -> _SceneComparison:
    scene = read_adversarial_scene(data, name, recordings)
    base = scene if recordings is None else recordings.scene(source)
    agents = [scene.agents.ids.index(identifier) for identifier in scene.adversaries if identifier in scene.agents.ids]
    with_map = not scene.road_map.drivable_area.is_empty and not base.road_map.drivable_area.is_empty
    tracks, launches = ContinuousTracks.of_scene(scene), read_launches(data, scene)
    road, last = RoadEdge(scene.road_map.drivable_area) if with_map else None, float(scene.seconds[-1])
    mine = []
    for agent in agents:
        start = float(scene.seconds[launches.get(scene.agents.ids[agent], 0)])
        mine += extract_runs(tracks, scene.keyframes, agent, between=(start, last), road=road)
    theirs: list[FeatureRun] = []
    for category in sorted({scene.agents.categories[agent] for agent in agents}):
        # Variants of one recording have one reference.
        if (source, category) not in used_references:
            used_references.add((source, category))
            theirs += extract_recorded_runs(
                ContinuousTracks.of_scene(base),
                base.keyframes,
                category,
                without=agents if recordings is None else (),
                road=RoadEdge(base.road_map.drivable_area) if with_map else None,
            )
    scenes = None if recordings is None else (_resample_tracks(scene), _resample_tracks(base))
    return _SceneComparison(mine, theirs, scenes)


def _resample_tracks(scene: Scene) -> SceneTracks:
    """The ego and all vehicles at 10 Hz, as ``ctg-realism@code`` reads them."""
    chosen = [row for row, category in enumerate(scene.agents.categories) if category.startswith("vehicle.")]
    tracks = ContinuousTracks.of_scene(scene).only(chosen)
    times = STEP_S * np.arange(int(scene.seconds[-1] / STEP_S + 1e-9) + 1)
    boxes, present = tracks.agents_at(times)
    everybody = np.concatenate([tracks.ego_at(times)[None], np.where(present[..., None], boxes, np.nan)])
    return SceneTracks(everybody[..., :2], everybody[..., 4])


def _compute_ctg_row(pairs: Sequence[tuple[SceneTracks, SceneTracks]]) -> CtgRow:
    version, normalisation, mask = CtgVersion.CTG, CtgNormalisation.SCENE, CtgMask.CURRENT_SPEED
    ours, theirs = (compute_histograms(scenes, version, normalisation, mask) for scenes in zip(*pairs, strict=True))
    distances = compute_deviations(ours, theirs)
    return CtgRow(
        version=version.value,
        normalisation=normalisation.value,
        mask=mask.value,
        mean_real_dev=round(distances["mean_real_dev"], DIGITS),
        mean_real_dev_int=round(distances["mean_real_dev_int"], DIGITS),
    )


def _rounded(feature: FeatureRealism) -> FeatureRealism:
    numbers: dict[str, Any] = {
        name: round(value, DIGITS) for name, value in asdict(feature).items() if isinstance(value, float)
    }
    if feature.interval is not None:
        low, high = feature.interval
        numbers["interval"] = round(low, DIGITS), round(high, DIGITS)
    return replace(feature, **numbers)


_LEVELS: Final = {"least": 0.0, "tenth": 0.1, "median": 0.5, "ninetieth": 0.9, "most": 1.0}
_STRUCK: Final = ("rear", "stopped_ego")
"""Kinds of contact in which another drives into the ego."""
_BEFORE_CONTACT: Final = {"least_ttc_s": "least time to contact, s", "tet_s": "TET, s", "tit_s2": "TIT, s^2"}
"""In a run that ends in contact they are what they are by construction."""
_ALWAYS: Final = {
    "least_gap_m": "least gap, m",
    "pet_s": "PET, s",
    "max_btn": "largest BTN",
}


def find_adversarial_names(data: DataSet, names: Sequence[str]) -> tuple[str, ...]:
    """Scenes of a data set with adversaries, and those of which it is not said how many they have."""
    facts = data.scene_facts(names)
    return tuple(name for name in names if facts[name].adversaries != 0)


def judge_split(
    data: DataSet, names: Sequence[str], executor: Executor | None = None, recordings: DataSet | None = None
) -> SplitAssessment:
    """Judge scenes of a data set together.

    Args:
        data: The data set.
        names: Scenes of it.
        executor: Where scenes without a judgement are judged; this process by default.
        recordings: The data set that its scenes were made from, if at hand.

    Returns:
        The judgement of the split.

    Raises:
        InputError: If a scene is broken, or workers are lost.
    """
    executor = executor or LocalProcesses()
    judged = assess_data_set(data, names, executor, recordings)
    ordinary: dict[str, tuple[SceneAssessment, ...]] = {}
    if recordings is not None:
        sources = {facts.source for facts in data.scene_facts(names).values()}
        ordinary = assess_data_set(recordings, sorted(sources & set(recordings.scene_names(None))), executor)
    encounters = [
        item.encounter for assessments in judged.values() for item in assessments if item.encounter is not None
    ]
    free = [item for item in encounters if item.contact is None]
    return SplitAssessment(
        scenes=dict(judged),
        ladder=summarise_reference_drivers([assessments for assessments in judged.values() if assessments]),
        ladder_of_recordings=summarise_reference_drivers(
            [assessments for assessments in ordinary.values() if assessments]
        )
        if ordinary
        else (),
        unsolvable=tuple(name for name, assessments in judged.items() if is_unsolvable(assessments)),
        severity=(
            *(_summarise_severity(label, name, encounters) for name, label in _ALWAYS.items()),
            *(_summarise_severity(label, name, free) for name, label in _BEFORE_CONTACT.items()),
        ),
        contacts=len(encounters) - len(free),
        realism=measure_split_realism(data, judged, recordings),
    )


def summarise_reference_drivers(scenes: Sequence[Sequence[SceneAssessment]]) -> tuple[ReferenceDriverSurvival, ...]:
    """How many scenes, of at least one, each driver survives."""
    rows = []
    for name in DRIVER_NAMES:
        runs = [assessments[0].drivers[name] for assessments in scenes]
        rows.append(
            ReferenceDriverSurvival(
                driver=name,
                survives=sum(run.survives for run in runs),
                of=len(runs),
                hit_adversary=sum(_hits_adversary(run) for run in runs),
                hit_from_behind=sum(run.contact is not None and run.contact.kind in _STRUCK for run in runs),
                beyond_end=sum(run.beyond_end for run in runs),
            )
        )
    return tuple(rows)


def _hits_adversary(run: ReferenceDriverRun) -> bool:
    return run.contact is not None and run.contact.party != "other"


def _summarise_severity(label: str, name: str, met: Sequence[InteractionSeverity]) -> SeverityRow:
    values = [value for value in (getattr(severity, name) for severity in met) if value is not None]
    quantiles = {level: float(np.quantile(values, at)) for level, at in _LEVELS.items()} if values else None
    return SeverityRow(
        name=label, of=len(values), quantiles=None if quantiles is None else Quantiles.model_validate(quantiles)
    )
