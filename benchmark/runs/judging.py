"""Stored plans against what really happened: the part of a run that never needs the planner, for `eval` and `rescore`.

`judge_plans` asks each judge of `ROW_JUDGES` about all plans of a scene; each fills one field of the rows. The verdict
on a sample depends on that sample alone, so a scene judged today gives the bytes that it gave in the run.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmark.constants import LONGER_HORIZON_STEPS, PLAN_STEPS
from benchmark.datasets.scene_assessments import collect_realism
from benchmark.datasets.scene_facts import find_frozen_split
from benchmark.errors import InputError
from benchmark.fairness.data_set_assessment import collect_scene_facts
from benchmark.fairness.plan_severity import measure_plan_severities
from benchmark.geometry import Floats
from benchmark.machine.environment import read_machine_metadata as environment_facts
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.metrics.diagnosis import diagnose
from benchmark.metrics.disagreement import EXACT, explain_disagreements
from benchmark.metrics.places import SampleContext
from benchmark.pdm.definition import PDM
from benchmark.pdm.plan_scoring import score_planners as judge_driving
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.protocols import CollisionProtocol, ProtocolOutcomes, find_protocol
from benchmark.protocols.exact import evaluate_longer_plans
from benchmark.records.attempts import read_generated_facts
from benchmark.records.row_schema import SampleRow
from benchmark.truth import SampleTruth
from benchmark.waypoints import waypoints_in_lidar

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.runs.scene_reading import SceneReading


@dataclass(frozen=True, slots=True)
class JudgedScenes:
    """Scenes of a data set that are judged.

    Judgements of encounters are kept in the folder of runs ``kept`` and found again; ``None`` asks for none. Others are
    judged by ``executor``, on which nothing depends.
    """

    data: "DataSet"
    split: str
    scenes: tuple[str, ...]
    kept: Path | None = None
    executor: Executor = field(default_factory=LocalProcesses)


def _scene_facts(of: JudgedScenes) -> Any:
    """Facts of the scenes, with whether an encounter could have been survived where judgements are kept."""
    if of.kept is None:
        return of.data.scene_facts(of.scenes)
    return collect_scene_facts(of.data, of.scenes, of.kept, of.executor)


JUDGES: Final[Mapping[str, Callable[[JudgedScenes], Any]]] = {
    "scene_facts": _scene_facts,
    "realism": lambda of: collect_realism(of.data.root, of.data.version),
    "frozen_split": lambda of: find_frozen_split(of.data.provenance()),
    "review": lambda of: of.data.review(of.split).facts,
    "generated": lambda of: read_generated_facts(of.data.provenance()),
}
"""By field of a record: fairness, realism, provenance and review."""


def describe_data(of: JudgedScenes, *fields: str) -> dict[str, Any]:
    """Fields of a record about its data and the machine, those named of `JUDGES` or all."""
    data = of.data
    return {
        "data": {"name": data.name, "version": data.version, "fingerprint": data.fingerprint()},
        "split": of.split,
        "scenes": list(of.scenes),
        "scenes_in_split": len(data.scene_names(of.split)),
        **{field: JUDGES[field](of) for field in fields or JUDGES},
        "environment": environment_facts(),
    }


def describe_given_names(data: "DataSet") -> dict[str, Any]:
    """What a user said of a data set, for the record: names of categories, side of traffic; nothing where nothing."""
    side = data.driving_side
    return {
        **({"categories": dict(data.categories)} if data.categories else {}),
        **({"driving_side": side.value} if side else {}),
    }


LONGEST_JUDGED: Final = max(LONGER_HORIZON_STEPS.values())
"""Steps of a plan that anything is said about."""
PLANNERS_AT_ONCE: Final = 10
"""Planners whose plans of a scene are judged together: bounds the memory."""


@dataclass(frozen=True, slots=True)
class PlannedSamples:
    """Samples of a scene that planners have a plan for, P in all: what judges are asked about.

    Attributes:
        places: (P) planner and sample of each plan.
        whole: (P) plans as they were given.
        plans: (P) their first 3 s.
        in_lidar: (P, 6, 2) waypoints of the lidar origin.
        outcomes: Verdicts of each protocol on all P.
        unjudged: Protocols, and perhaps ``pdm``, that cannot tell whom a plan could touch because the data have other
            categories than they know (`benchmark.runs.rescoring`).
    """

    scene: "SceneReading"
    planners: int
    places: Sequence[tuple[int, int]]
    whole: Sequence[Plan]
    plans: Sequence[Plan]
    in_lidar: Floats
    truths: Sequence[SampleTruth]
    outcomes: Mapping[str, ProtocolOutcomes]
    unjudged: Collection[str]

    def by_planner(self, plans: Sequence[Plan]) -> list[dict[int, Plan]]:
        """P plans of each planner by number of the sample."""
        plans_of: list[dict[int, Plan]] = [{} for _ in range(self.planners)]
        for (which, at), plan in zip(self.places, plans, strict=True):
            plans_of[which][at] = plan
        return plans_of


def judge_plans(
    rows_of: Sequence[Sequence[Mapping[str, Any]]],
    scene: "SceneReading",
    protocols: Sequence[str],
    unjudged: Collection[str] = (),
) -> list[list[SampleRow]]:
    """Put what really happened and the verdicts beside the plans of a scene; of each planner one row for each sample.

    A sample without a plan has no outcome, no diagnosis and no disagreement. Nothing is diagnosed or compared without
    ``exact`` among the protocols. Where objects were not labelled there is L2 alone.
    """
    if len(rows_of) > PLANNERS_AT_ONCE:
        first, rest = rows_of[:PLANNERS_AT_ONCE], rows_of[PLANNERS_AT_ONCE:]
        return judge_plans(first, scene, protocols, unjudged) + judge_plans(rest, scene, protocols, unjudged)
    samples = _planned_samples(rows_of, scene, protocols, unjudged)
    verdicts = {name: judge(samples) for name, judge in ROW_JUDGES.items()}
    judged: dict[tuple[int, int], dict[str, Any]] = {}
    for number, (place, truth) in enumerate(zip(samples.places, samples.truths, strict=True)):
        judges = ROW_JUDGES if truth.labelled else WITHOUT_LABELS
        judged[place] = {name: verdicts[name][number] for name in judges}
    happened = [_list_recorded_members(truth, at) for truth, at in zip(scene.truth, scene.around, strict=True)]
    return [
        [
            SampleRow(**row, **recorded, **judged.get((which, at), {"outcomes": {}}))
            for at, (row, recorded) in enumerate(zip(rows, happened, strict=True))
        ]
        for which, rows in enumerate(rows_of)
    ]


def _planned_samples(
    rows_of: Sequence[Sequence[Mapping[str, Any]]],
    scene: "SceneReading",
    protocols: Sequence[str],
    unjudged: Collection[str],
) -> PlannedSamples:
    tokens = [truth.sample_token for truth in scene.truth]
    for rows in rows_of:
        if [row["sample_token"] for row in rows] != tokens:
            raise ValueError(
                f"plans and truth of {rows[0]['scene'] if rows else 'a scene'} do not have the same samples"
            )
    places = [
        (which, at) for which, rows in enumerate(rows_of) for at, row in enumerate(rows) if row["plan"] is not None
    ]
    truths, full_plans = (
        [scene.truth[at] for _, at in places],
        [parse_plan(rows_of[which][at]["plan"]) for which, at in places],
    )
    plans = [plan.judged for plan in full_plans]
    in_lidar = _in_lidar(plans, truths)
    outcomes = {
        name: mask_unknown(
            _mask_other_rates(find_protocol(name), find_protocol(name).evaluate(truths, in_lidar), truths),
            truths,
            told=name not in unjudged,
        )
        for name in dict.fromkeys(protocols)
    }
    return PlannedSamples(scene, len(rows_of), places, full_plans, plans, in_lidar, truths, outcomes, unjudged)


def _judge_collisions(samples: PlannedSamples) -> Sequence[Any]:
    verdicts = {name: outcome.as_rows() for name, outcome in samples.outcomes.items()}
    return [{name: of[place] for name, of in verdicts.items()} for place in range(len(samples.places))]


def _judge_driving(samples: PlannedSamples) -> Sequence[Any]:
    scene, count = samples.scene, len(samples.scene.truth)
    if scene.mapped is None or PDM in samples.unjudged:
        return [None] * len(samples.places)
    plans = [
        [plans_by_sample.get(index) for index in range(count)] for plans_by_sample in samples.by_planner(samples.plans)
    ]
    verdicts = judge_driving(scene.mapped, plans, scene.recorded)
    scores = (verdicts[which][at] for which, at in samples.places)
    return [None if verdict is None else asdict(verdict) for verdict in scores]


def _diagnose_collisions(samples: PlannedSamples) -> Sequence[Any]:
    if EXACT not in samples.outcomes or not samples.truths:
        return [None] * len(samples.truths)
    return diagnose([truth.by_clock for truth in samples.truths], samples.plans, samples.outcomes[EXACT])


def _find_disagreements(samples: PlannedSamples) -> Sequence[Any]:
    if EXACT not in samples.outcomes or not samples.truths:
        return [{} for _ in samples.truths]
    return explain_disagreements(samples.truths, samples.in_lidar, samples.outcomes)


def _measure_severity(samples: PlannedSamples) -> Sequence[Any]:
    recorded = samples.scene.recorded
    # With a map without roads or lanes the ego would be at fault in every lateral contact by nuPlan's rule.
    known = recorded is not None and recorded.road.drivable and recorded.road.lanes
    road = recorded.road if recorded is not None and known else None
    truths = [truth.by_clock for truth in samples.truths]
    return measure_plan_severities(truths, samples.in_lidar, road, samples.scene.recording)


def _judge_longer(samples: PlannedSamples) -> Sequence[Any]:
    """Verdicts of ``exact`` on plans that go on beyond 3 s, up to 6 s: `judge_longer_plans` of each planner."""
    if EXACT not in samples.outcomes:
        return [None] * len(samples.places)
    longer = [
        judge_longer_plans(plans_by_sample, samples.scene.longer)
        for plans_by_sample in samples.by_planner(samples.whole)
    ]
    return [longer[which].get(at) for which, at in samples.places]


ROW_JUDGES: Final[Mapping[str, Callable[[PlannedSamples], Sequence[Any]]]] = {
    "longer": _judge_longer,
    "outcomes": _judge_collisions,
    "driving": _judge_driving,
    "diagnosis": _diagnose_collisions,
    "disagreements": _find_disagreements,
    "severity": _measure_severity,
}
"""By field of a row: what is said of each of P plans."""
WITHOUT_LABELS: Final = ("longer", "outcomes")
"""The fields that say something where objects were not labelled: L2."""


def _mask_other_rates(
    definition: CollisionProtocol, outcomes: ProtocolOutcomes, truths: Sequence[SampleTruth]
) -> ProtocolOutcomes:
    """Verdicts that count nothing where key frames come at another rate and a protocol takes them for its steps."""
    at_two_hz = np.array([truth.at_two_hz for truth in truths], np.bool_)
    # Protocols of other packages may predate this attribute.
    if at_two_hz.all() or getattr(definition, "goes_by_clock", False):
        return outcomes
    return replace(outcomes, counted=outcomes.counted & at_two_hz)


def mask_unknown(outcomes: ProtocolOutcomes, truths: Sequence[SampleTruth], *, told: bool) -> ProtocolOutcomes:
    """Verdicts that say of which samples nothing is known of contacts: of all where categories do not tell."""
    known = np.array([truth.labelled and told for truth in truths], np.bool_)
    return outcomes if known.all() else replace(outcomes, known=known)


def _in_lidar(plans: Sequence[Plan], truths: Sequence[SampleTruth]) -> Floats:
    """(P, 6, 2) waypoints of the lidar origin of P plans, those of a frame at once."""
    waypoints = np.zeros((len(plans), PLAN_STEPS, 2))
    for frame in dict.fromkeys(plan.frame for plan in plans):
        frame_places = [place for place, plan in enumerate(plans) if plan.frame is frame]
        ahead_m = np.array([truths[place].lidar_ahead_m for place in frame_places])
        waypoints[frame_places] = waypoints_in_lidar(
            np.array([plans[place].waypoints for place in frame_places]), frame, ahead_m
        )
    return waypoints


def judge_longer_plans(
    plans: Mapping[int, Plan], longer: Callable[[int], Sequence[SampleTruth]]
) -> dict[int, dict[str, Any]]:
    """Verdicts of ``exact`` on plans that go on beyond 3 s, up to 6 s, by number of the sample.

    Contact and displacement are of each step of the whole plan, null where objects were not labelled and past the
    scene. ``longer`` gives the truths of all samples with so many steps.
    """
    steps_of = {index: min(len(plan.waypoints), LONGEST_JUDGED) for index, plan in plans.items()}
    verdicts: dict[int, dict[str, Any]] = {}
    for steps in sorted(set(steps_of.values()) - {PLAN_STEPS}):
        truths = longer(steps)
        chosen = [index for index in plans if steps_of[index] == steps]
        waypoints = [
            replace(plans[index], waypoints=plans[index].waypoints[:steps]).waypoints_in_lidar(
                truths[index].lidar_ahead_m
            )
            for index in chosen
        ]
        collision, l2 = evaluate_longer_plans([truths[index] for index in chosen], np.array(waypoints))
        for index, hits, metres in zip(chosen, collision.tolist(), l2.tolist()):
            known_hits = hits if truths[index].labelled else None
            verdicts[index] = {
                "collision": known_hits,
                "l2": [None if np.isnan(metre_value) else metre_value for metre_value in metres],
            }
    return verdicts


def parse_plan(row: Mapping[str, Any]) -> Plan:
    """The plan that a planner gave, from the JSON object that `benchmark.runs.plan_rows` writes."""
    parts, forecasts = ("modes", "mode_scores"), row["forecasts"]
    try:
        return Plan(
            np.array(row["waypoints"], np.float64),
            PlanFrame(row["frame"]),
            **{name: None if row[name] is None else np.array(row[name], np.float64) for name in parts},
            forecasts=None if forecasts is None else _forecasts(forecasts),
        )
    except ValueError as error:
        raise InputError(
            f"a stored plan cannot be read ({error}); remove the run directory and run challenger-bench eval again"
        ) from error


def _forecasts(row: Mapping[str, Any]) -> Forecasts:
    """Lists that may be empty have lost the shape of what they do not hold."""
    agents = len(row["boxes"])
    modes = len(row["trajectories"][0]) if row["trajectories"] else 0
    if agents and not modes:
        raise ValueError("its forecasts have no modes")
    return Forecasts(
        boxes=np.array(row["boxes"], np.float64).reshape(agents, 5),
        trajectories=np.array(row["trajectories"], np.float64).reshape(agents, modes, PLAN_STEPS, 2),
        scores=np.array(row["scores"], np.float64).reshape(agents, modes),
    )


def _list_recorded_members(truth: SampleTruth, at: SampleContext) -> dict[str, Any]:
    ahead = truth.by_clock
    return {
        "command": int(truth.command),
        "lidar_ahead_m": truth.lidar_ahead_m,
        "complete": ahead.complete,
        "recorded_future": [
            pose.tolist() if valid else None for pose, valid in zip(ahead.ego_future, ahead.ego_future_valid)
        ],
        "place": at.place.value,
        "speed_m_s": at.speed_m_s,
    }
