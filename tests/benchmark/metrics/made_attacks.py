"""Records of planners whose plans touch somebody, or nearly do, as letters say; and scenes that somebody judged."""

from collections.abc import Mapping
from dataclasses import replace

from benchmark.records.fault import StoredFault
from benchmark.records.row_schema import PlanCollision, PlanNearRow, PlanSeverityRow
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import SceneFacts
from benchmark.records.scene_assessment import (
    TRACK_DEFECT_NAMES,
    AssessmentSummary,
    CtgRow,
    FeatureRealism,
    KindName,
    SplitRealism,
    ValidityRow,
)
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, UNCOUNTED, hand_made
from tests.benchmark.records.made_judgements import hits, made_judgement

_CONTACTS: dict[str, tuple[KindName, str | None, float, bool]] = {
    # kind, whose fault, impact speed, adversary
    "f": ("front", "ego", 10.0, True),
    "F": ("front", "ego", 20.0, False),
    "r": ("rear", "other", 4.0, True),
    "s": ("lateral", "shared", 2.0, True),
    "u": ("lateral", "unclear", 2.0, True),
    "?": ("front", None, 2.0, True),
}
_FLAGS = {".": CLEAN, "!": FAILED, "-": UNCOUNTED}


def contact(letter: str) -> PlanSeverityRow:
    """A sample that touches somebody: f, F at its fault, r not, s shared, u unclear, ? as older records say it."""
    kind, verdict, speed, adversary = _CONTACTS[letter]
    fault = None if verdict is None else StoredFault.model_validate({"verdict": verdict, "reason": "lane-change"})
    hit = PlanCollision(
        time_s=1.3, kind=kind, at_fault=kind == "front", fault=fault, impact_speed_m_s=speed,
        delta_v_ego_m_s=0.5 * speed, delta_v_other_m_s=0.4 * speed,
        fatal_probability=min((0.5 * speed / 31.74) ** 4, 1.0), agent="a" if adversary else "b", adversary=adversary,
    )  # fmt: skip
    return PlanSeverityRow(contact=hit)


def near(index: int) -> PlanSeverityRow:
    """A sample without contact: later ones come nearer; the first does not head for the adversary."""
    ttc_s, pet_s = (None, None) if index == 0 else (3.0 / index, 2.0)
    return PlanSeverityRow(
        near=PlanNearRow(
            least_gap_m=5.0 - index, least_ttc_s=ttc_s, tet_s=0.1 * index, tit_s2=0.01 * index,
            pet_s=pet_s, max_btn=0.5 * index,
        )
    )  # fmt: skip


def attacked(
    planner: str,
    scenes: Mapping[str, str],
    careful: Mapping[str, bool | None],
    *,
    split: str = "adv",
    sources: Mapping[str, str] | None = None,
    data: str = "d",
    privileged: bool = False,
) -> RunRecord:
    """A record; in ``scenes`` a letter a sample (see `contact`), ``.`` near, ``!`` failed, ``-`` too late.

    ``careful``: whether the careful human survives each scene, ``None`` where nobody judged it.
    """
    flags = {scene: [_FLAGS.get(letter, HIT) for letter in letters] for scene, letters in scenes.items()}
    record = hand_made(planner, flags, split=split, data=data, privileged=privileged)
    rows = []
    for row in record.rows:
        letter = scenes[row.scene][row.index]
        severity = None if letter == "!" else contact(letter) if letter in _CONTACTS else near(row.index)
        rows.append(row.model_copy(update={"severity": severity, "complete": letter != "-"}))
    facts = {}
    for scene, survives in careful.items():
        source = (sources or {}).get(scene, scene)
        facts[scene] = SceneFacts(source=source, manoeuvre="cut-in-left", adversaries=1, judgement=judged(survives))
    return replace(record, rows=tuple(rows), run=record.run.model_copy(update={"scene_facts": facts}))


def told(record: RunRecord) -> RunRecord:
    """The record with what ``exact`` says of whom its plans touch."""
    rows = []
    for row in record.rows:
        contact = None if row.severity is None else row.severity.contact
        if (outcome := row.outcomes.get("exact")) is not None:
            facts = {
                "hit": contact and contact.agent,
                "first_contact_s": contact and contact.time_s,
                "hit_adversary": contact and contact.adversary,
                "adversary_contact_s": contact.time_s if contact and contact.adversary else None,
            }
            row = row.model_copy(update={"outcomes": {"exact": outcome.model_copy(update={"facts": facts})}})
        rows.append(row)
    return replace(record, rows=tuple(rows))


def judged(survives: bool | None) -> AssessmentSummary | None:
    """What was said of a scene; where the careful human does not survive, its adversary leaves the road."""
    if survives is None:
        return None
    judgement = made_judgement()
    drivers = {name: run.model_dump() for name, run in judgement.drivers.items()}
    drivers |= {} if survives else {name: hits() for name in ("constant", "idm", "r157", "cc", "fsm", "rss")}
    chance = {} if survives else {"chance": "until", "last_chance_s": 2.0, "margin_s": 1.25}
    faults = {name: name == "off_road" and not survives for name in TRACK_DEFECT_NAMES}
    return AssessmentSummary.of([made_judgement(drivers=drivers, faults=faults, **chance)])


def with_realism(record: RunRecord, worst: float | None) -> RunRecord:
    """The record of a split whose adversaries were looked at; compared with recordings if a worst value is given."""
    count = len(record.run.scenes)
    validity = (
        ValidityRow(fault="off_road", count=1, of=count),
        ValidityRow(fault="teleport", count=0, of=0, unknown=("the generated 12 Hz track is not in the data set",)),
    )
    said = SplitRealism(adversaries=count, validity=validity, not_compared="the recordings are our own town")
    if worst is not None:
        features = tuple(
            FeatureRealism(
                name=name, w1=0.4, w1_of_halves=0.2, w1_in_halves=2.0, realism=realism, realism_of_halves=0.94,
                interval=(realism - 0.05, realism + 0.02),
            )
            for name, realism in (("speed", 0.95), ("jerk_along", worst))
        )  # fmt: skip
        ctg = CtgRow(
            version="ctg", normalisation="scene", mask="current_speed", mean_real_dev=0.05, mean_real_dev_int=None
        )
        said = SplitRealism(
            adversaries=count, validity=validity, reference="vehicle.car of 3 scenes", samples=(120, 900),
            features=features, worst="jerk_along", ctg=ctg,
        )  # fmt: skip
    return replace(record, run=record.run.model_copy(update={"realism": said}))
