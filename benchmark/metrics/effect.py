"""The effect of the adversary: how much more often a planner collides because of it (docs/metrics.md).

Each recording weighs as often as it has samples, however many adversarial variants were made of it: a sample weighs
1 / (variants of its recording in the split). An adversarial sample is paired with the sample of the same recording and
key frame on the unchanged recording; both must count. All contacts are those of ``exact``.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.metrics.attacks import has_adversaries, knows_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.rates import HORIZONS, PairedDifference, append_average, compute_paired_difference
from benchmark.metrics.scores import ScoredSamples, map_scenes_to_sources, require_current, score_record
from benchmark.protocols import PROTOCOLS, compute_published_values
from benchmark.protocols.raster import HIT_ADVERSARY, TOUCHED_ADVERSARY, touches_adversary
from benchmark.records.fault import FaultVerdict
from benchmark.records.row_schema import PlanCollision
from benchmark.records.rows import find_scene_failures, find_scenes_with
from benchmark.records.run import RunRecord

HORIZON_S: Final = (1.0, 2.0, 3.0)
AT_3_S: Final = 2
"""Column of values at 1, 2 and 3 s and their mean."""


@dataclass(frozen=True, slots=True)
class SampleContacts:
    """Contacts of the samples of a record under ``exact``, by whom they are with.

    Rates are (S, 4), 0..1: contacts up to 1, 2 and 3 s, and their mean; ``adversary`` are of first contacts with an
    adversary, and ``faults`` of those by whose fault they are (``fault@1``).

    Attributes:
        keys: S pairs of recording and key-frame index.
        counted: (S,) whether a verdict on contacts up to 3 s exists.
        weights: (S,) 1 / variants of the recording.
        unknown_fault: (S,) first contacts with an adversary that do not say whose fault they are, as in older records.
        hits: S instances that are touched first, and seconds from the sample on; ``None`` without a contact.
        severity: S contacts with that instance as `benchmark.fairness.plan_severity` has them, fault included;
            ``None`` where the record has none.
    """

    keys: tuple[tuple[str, int], ...]
    counted: Bools
    weights: Floats
    any_contact: Floats
    adversary: Floats
    faults: Mapping[FaultVerdict, Floats]
    unknown_fault: Bools
    hits: tuple[tuple[str, float] | None, ...]
    severity: tuple[PlanCollision | None, ...]


@dataclass(frozen=True, slots=True)
class PairedEffect:
    """A planner on adversarial scenes beside the same recordings unchanged; contacts up to 3 s.

    Attributes:
        difference: Adversarial less unchanged, with its interval over recordings.
        new_others: Share of pairs with a first contact with another than the adversary, and none unchanged; ``None``
            where it is not known which road users are adversaries.
        lost_others: Share of pairs with a contact unchanged, and none with another than the adversary; likewise.
        unpaired_scenes: Scenes of either side without any partner, by name.
        unpaired: Adversarial samples that count and have no partner.
    """

    adversarial: float | None
    unchanged: float | None
    difference: PairedDifference
    new_others: float | None
    lost_others: float | None
    pairs: int
    unpaired_scenes: tuple[str, ...]
    unpaired: int

    @property
    def ratio(self) -> float | None:
        """How many times as often; ``None`` over a rate of zero."""
        return None if not self.unchanged or self.adversarial is None else self.adversarial / self.unchanged


@dataclass(frozen=True, slots=True)
class AdversaryEffect:
    """Effect of an adversarial split on a planner, over the samples that count.

    ``touched`` are weighted rates of first contacts with an adversary at 1, 2, 3 s and their mean, ``at_fault``,
    ``shared_fault`` and ``unclear_fault`` of those at the planner's fault, at both users' and at unclear fault;
    ``None`` where no sample counts, or it is not known which road users are adversaries, and of fault where contacts do
    not say it: those are ``unknown_fault``.
    """

    record: RunRecord
    touched: tuple[float, ...] | None
    at_fault: tuple[float, ...] | None
    shared_fault: tuple[float, ...] | None
    unclear_fault: tuple[float, ...] | None
    unknown_fault: int
    samples: int
    recordings: int
    unchanged: RunRecord | None
    paired: PairedEffect | None


@dataclass(frozen=True, slots=True)
class FirstContactFlags:
    """(R,) samples of a record that count and collide, by whom their plans touch first; each is in one at most.

    ``adversary`` is any object on a split without adversaries; ``others`` and ``unsaid``, where the record does not say
    whom, exist on a split with adversaries only.
    """

    adversary: Bools
    others: Bools
    unsaid: Bools


def knows_contact_partners(record: RunRecord, protocol: str = EXACT) -> bool:
    """Whether a record says of its contacts whether they are with an adversary; older ones do not until rescored."""
    return knows_adversaries(record) and _knows_contact_partners_now(record, protocol)


def attributes_contacts(record: RunRecord) -> bool:
    """Whether contacts are counted by whom they are with: with adversaries, unless it is known that there are none."""
    known_to_have_none = knows_adversaries(record) and not any(
        facts.adversaries for facts in record.run.scene_facts.values()
    )
    return has_adversaries(record) and not known_to_have_none


def _knows_contact_partners_now(record: RunRecord, protocol: str = EXACT) -> bool:
    if protocol not in record.run.protocols:
        return False
    facts = record.columns.outcomes(protocol).facts
    return HIT_ADVERSARY in facts or TOUCHED_ADVERSARY in facts


def compute_effect(record: RunRecord, unchanged: RunRecord | None) -> AdversaryEffect | None:
    """Effect of the adversaries of a split on a planner.

    ``None`` of a split without adversaries, and of older records until they are rescored.
    """
    if not (has_adversaries(record) and _knows_contact_partners_now(record)):
        return None
    contacts, known = collect_sample_contacts(record), knows_adversaries(record)
    rows = np.flatnonzero(contacts.counted)
    weights = contacts.weights[rows]
    total, unknown_fault = float(weights.sum()), int(contacts.unknown_fault[rows].sum())

    def share(values: Floats) -> tuple[float, ...] | None:
        return _average_weighted(values[rows], weights) if total and known else None

    of_verdict = {verdict: None if unknown_fault else share(values) for verdict, values in contacts.faults.items()}
    return AdversaryEffect(
        record=record,
        touched=share(contacts.adversary),
        at_fault=of_verdict[FaultVerdict.EGO],
        shared_fault=of_verdict[FaultVerdict.SHARED],
        unclear_fault=of_verdict[FaultVerdict.UNCLEAR],
        unknown_fault=unknown_fault,
        samples=len(rows),
        recordings=len({contacts.keys[row][0] for row in rows.tolist()}),
        unchanged=unchanged,
        paired=None if unchanged is None else _pair_samples(contacts, record, unchanged, known=known),
    )


def effect_to_json(record: RunRecord, unchanged: RunRecord | None) -> dict[str, Any]:
    """Adversary effect as JSON values under ``effect``; empty where there is none, or a sentence that says why."""
    try:
        effect = compute_effect(record, unchanged)
    except InputError as refusal:
        return {"effect": {"refused": str(refusal)}}
    if effect is None:
        return {}
    rates = {
        name: None if values is None else dict(zip(HORIZONS, values, strict=True))
        for name, values in (
            ("adversary", effect.touched),
            ("at_fault", effect.at_fault),
            ("shared_fault", effect.shared_fault),
            ("unclear_fault", effect.unclear_fault),
        )
    }
    partner = None if unchanged is None else {"data": unchanged.run.data.name, "split": unchanged.run.split}
    pairs = None if effect.paired is None else {**asdict(effect.paired), "ratio": effect.paired.ratio}
    counts = {name: getattr(effect, name) for name in ("samples", "recordings", "unknown_fault")}
    return {"effect": {**rates, **counts, "unchanged": partner, "paired": pairs}}


def collect_sample_contacts(record: RunRecord) -> SampleContacts:
    """Contacts of each sample of a record that has a plan, by whom they are with."""
    require_current(record, EXACT)
    columns = record.columns
    outcomes, planned = columns.outcomes(EXACT), columns.planned.tolist()
    sources = map_scenes_to_sources(record)
    variants: dict[str, int] = {}
    for source in sources.values():
        variants[source] = variants.get(source, 0) + 1
    recordings = [sources[scene] for scene in columns.planned_scenes]
    index = columns.values("index")
    any_contact = append_average(compute_published_values(PROTOCOLS[EXACT], outcomes)["collision"]).reshape(-1, 4)
    facts, severity = outcomes.facts, columns.values("severity")
    hit, first_s, adversary = (facts.get(name, (None,) * len(planned)) for name in _FIRST)
    contacts = [None if (own := severity[place]) is None else own.contact for place in planned]
    with_adversary = np.array([bool(flag) for flag in adversary], np.bool_)
    same = tuple(one if one is not None and one.agent == name else None for one, name in zip(contacts, hit))
    verdicts = np.array([None if one is None or one.fault is None else one.fault.verdict for one in same], object)
    by_horizon = np.array([[time is not None and time <= horizon for horizon in HORIZON_S] for time in first_s])
    touched = by_horizon.reshape(-1, 3) & with_adversary[:, None]
    return SampleContacts(
        keys=tuple((recording, int(index[place])) for recording, place in zip(recordings, planned)),
        counted=outcomes.decided & ~np.isnan(any_contact).any(axis=1),
        weights=np.array([1.0 / variants[recording] for recording in recordings]),
        any_contact=np.nan_to_num(any_contact),
        adversary=append_average(touched.astype(np.float64)),
        faults={
            verdict: append_average((touched & (verdicts == verdict)[:, None]).astype(np.float64))
            for verdict in FaultVerdict
        },
        unknown_fault=with_adversary & np.array([verdict is None for verdict in verdicts], np.bool_),
        hits=tuple(None if name is None else (name, time) for name, time in zip(hit, first_s)),
        severity=same,
    )


def find_first_contacts(record: RunRecord, protocol: str = EXACT) -> FirstContactFlags:
    """Whom the colliding samples of a record touch first; all its rows must be judged by the protocol."""
    columns = record.columns
    hits, none = columns.collides(protocol), np.zeros(len(columns), np.bool_)
    if not attributes_contacts(record):
        return FirstContactFlags(hits, none, none)
    if not knows_contact_partners(record, protocol):
        return FirstContactFlags(none, none, hits)
    outcomes = columns.outcomes(protocol)
    adversary = none.copy()
    for row in np.flatnonzero(hits[columns.planned]).tolist():
        facts = {name: column[row] for name, column in outcomes.facts.items()}
        adversary[columns.planned[row]] = touches_adversary(outcomes.collision[row].tolist(), facts) is True
    return FirstContactFlags(adversary, hits & ~adversary, none)


def find_touched_scenes(record: RunRecord, protocol: str = EXACT) -> dict[str, bool | None]:
    """Which scenes a planner fails by touching the adversary first; on a split without adversaries, any object.

    Verdicts as of `benchmark.records.rows.find_scene_failures`; ``None`` also where a plan collides and the record does
    not say with whom.
    """
    any_failures = find_scene_failures(record.rows, protocol)
    if not attributes_contacts(record):
        return any_failures
    first_contacts = find_first_contacts(record, protocol)
    undecided_scenes = {
        scene for scene, places in record.columns.places_of_scenes.items() if first_contacts.unsaid[places].any()
    }
    verdicts = find_scenes_with(record.columns, protocol, first_contacts.adversary)
    return {scene: None if scene in undecided_scenes else failed for scene, failed in verdicts.items()}


def find_attributed_collisions(record: RunRecord) -> Bools:
    """(R,) samples that count under ``exact`` and whose collision is the adversary's doing.

    On a split with adversaries those whose first contact is with one; of recordings, and where the record does not say
    whom contacts are with, any collision.
    """
    first_contacts = find_first_contacts(record)
    return first_contacts.adversary | first_contacts.unsaid


def score_adversary_contacts(record: RunRecord) -> ScoredSamples:
    """Contributions of samples to the rate of first contacts with an adversary; needs `knows_contact_partners`."""
    own, cache = score_record(record, protocol=EXACT), record.columns.kept
    if _TOUCHING not in cache:
        # Slices of every kind ask for it.
        cache[_TOUCHING] = np.where(np.isnan(own.values), np.nan, collect_sample_contacts(record).adversary)
    return replace(own, values=cache[_TOUCHING], kept={})


_TOUCHING: Final = "touching an adversary"
_FIRST: Final = ("hit", "first_contact_s", HIT_ADVERSARY)


def _average_weighted(values: Floats, weights: Floats) -> tuple[float, ...]:
    return tuple((values * weights[:, None]).sum(axis=0) / weights.sum())


def _pair_samples(contacts: SampleContacts, record: RunRecord, unchanged: RunRecord, *, known: bool) -> PairedEffect:
    """Pairs by recording and key-frame index."""
    base = collect_sample_contacts(unchanged)
    partner = _find_partners(base)
    rows = np.array(
        [row for row in np.flatnonzero(contacts.counted).tolist() if contacts.keys[row] in partner], np.int64
    )
    weights = contacts.weights[rows]
    adversarial = contacts.any_contact[rows, AT_3_S]
    before = np.array([partner[contacts.keys[row]] for row in rows.tolist()])
    others = adversarial * (contacts.adversary[rows, AT_3_S] == 0.0)
    names = sorted({contacts.keys[row][0] for row in rows.tolist()})
    place = {name: number for number, name in enumerate(names)}
    own = np.array([place[contacts.keys[row][0]] for row in rows.tolist()], np.int64)
    total = float(weights.sum())

    def share(values: Floats) -> float | None:
        return float((values * weights).sum()) / total if total else None

    return PairedEffect(
        adversarial=share(adversarial),
        unchanged=share(before),
        difference=compute_paired_difference(
            _sum_by_place(own, (adversarial - before) * weights, names), _sum_by_place(own, weights, names)
        ),
        new_others=share(others * (1.0 - before)) if known else None,
        lost_others=share(before * (1.0 - others)) if known else None,
        pairs=len(rows),
        unpaired_scenes=_find_unpaired_scenes(record, unchanged),
        unpaired=int(contacts.counted.sum()) - len(rows),
    )


def _find_partners(base: SampleContacts) -> Mapping[tuple[str, int], float]:
    """Contact up to 3 s of each sample that counts on the unchanged side; the mean where a recording is there twice."""
    sums: dict[tuple[str, int], list[float]] = {}
    for row in np.flatnonzero(base.counted).tolist():
        sums.setdefault(base.keys[row], []).append(float(base.any_contact[row, AT_3_S]))
    return {key: sum(values) / len(values) for key, values in sums.items()}


def _sum_by_place(places: NDArray[np.int64], values: Floats, names: list[str]) -> Floats:
    return np.asarray(np.bincount(places, weights=values, minlength=len(names)), np.float64)


def _find_unpaired_scenes(record: RunRecord, unchanged: RunRecord) -> tuple[str, ...]:
    """Scenes whose recording the other side does not have."""
    mine, theirs = map_scenes_to_sources(record), map_scenes_to_sources(unchanged)
    lonely = [scene for scene, source in mine.items() if source not in set(theirs.values())]
    return tuple(sorted(lonely))
