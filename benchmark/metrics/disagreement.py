"""Where a protocol and the exact truth disagree on a plan, and why: a ladder of counterfactuals between the two.

``exact`` looks at everything all the time; an official protocol takes something away at each rung:

1. ``between waypoints``: only the six waypoints are looked at;
2. ``class not counted``: objects of some categories cannot be hit;
3. ``not annotated now or since``: nor can those that appear later, have a gap, or were not seen before;
4. ``out of range now``: nor those that are far away;
5. ``no sensor points``: nor those on which no sensor point was counted;
6. ``heading``: the ego is turned by the protocol's own rule, or not at all;
7. ``raster``: boxes are drawn and compared as the protocol does it;
8. ``mask``: steps do not count at which the recorded ego collides too.

Where key frames are not half a second apart, the two look at other instants: the cause is ``other instants`` there,
regardless of other differences.

Each rung gives a verdict, "any contact at the steps in question": those at which ``exact`` sees the collision that is
missed, or the protocol the one that is none. The cause of a disagreement is the last rung at which the verdict changes:
from there on it is the official one. Rungs 2 to 5 ask the protocol itself which objects it would count if the
others of these reasons did not exist, so a new protocol needs nothing more to be explained.

Verdicts of a protocol counted against the exact ones: what it misses and what it invents, from rows alone.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, CollisionProtocol, ProtocolOutcomes
from benchmark.protocols.sparsedrive import find_waypoint_contacts
from benchmark.protocols.stacked_truths import StackedTruths, stack
from benchmark.records.run import RunRecord, collect_outcomes
from benchmark.truth import SampleTruth

EXACT = "exact"
COUNTERFACTUALS = (
    "between waypoints",
    "class not counted",
    "not annotated now or since",
    "out of range now",
    "no sensor points",
    "heading",
    "raster",
    "mask",
)
MISS, FALSE_ALARM = "miss", "false alarm"
OTHER_INSTANTS = "other instants"
CAUSES = (
    *(f"{MISS}: {rung}" for rung in COUNTERFACTUALS),
    *(f"{FALSE_ALARM}: {rung}" for rung in COUNTERFACTUALS[5:7]),
    *(f"{kind}: {OTHER_INSTANTS}" for kind in (MISS, FALSE_ALARM)),
)
"""All causes. A rung that only removes contacts can cause only misses."""


@dataclass(frozen=True, slots=True)
class CounterfactualVerdicts:
    """(9, S, 6) contact of S samples at each step under ``exact``, then after each of `COUNTERFACTUALS`."""

    verdicts: Bools

    def causes(self) -> list[str | None]:
        """Why the two ends differ within 3 s: of each sample one of `CAUSES`, or ``None`` where they agree."""
        within = self.verdicts.any(axis=-1)
        rung = _find_last_change(self._followed().any(axis=-1))
        return [
            f"{FALSE_ALARM if official else MISS}: {COUNTERFACTUALS[at]}" if official != exact else None
            for exact, official, at in zip(within[0].tolist(), within[-1].tolist(), rung.tolist())
        ]

    def decisive_steps(self) -> Bools:
        """(S, 6) contacts that are lost (a miss) or appear (a false alarm) at the rung that is the cause.

        None where both ends agree.
        """
        within, followed = self.verdicts.any(axis=-1), self._followed()
        samples, rung = np.arange(within.shape[1]), _find_last_change(followed.any(axis=-1))
        lost, gained = followed[rung, samples], followed[rung + 1, samples]
        steps = np.where(within[-1][:, None], gained, lost)
        return np.asarray(steps & (within[0] != within[-1])[:, None])

    def _followed(self) -> Bools:
        """(9, S, 6) contacts at the steps that matter: those that are missed, or those that are false alarms."""
        official = self.verdicts[-1].any(axis=-1)
        return np.asarray(self.verdicts & np.where(official[:, None], self.verdicts[-1], self.verdicts[0]))


def _find_last_change(within: Bools) -> NDArray[np.int64]:
    """(S,) index of the last rung that changes the verdicts (9, S); 0 where none does."""
    changes = within[1:] != within[:-1]
    last = len(changes) - 1 - np.argmax(changes[::-1], axis=0)
    return np.where(changes.any(axis=0), last, 0)


def compute_counterfactuals(
    definition: CollisionProtocol,
    truths: StackedTruths,
    plans_lidar: Floats,
    exact: ProtocolOutcomes,
    official: ProtocolOutcomes,
) -> CounterfactualVerdicts:
    """Every rung from the exact to the official verdict on S samples.

    ``plans_lidar`` are (S, 6, 2) waypoints of the lidar origin, x right, y forward, metres.
    """
    heading = PROTOCOLS[EXACT].headings(plans_lidar)
    objects = filter_objects(definition, truths)
    contacts = [find_waypoint_contacts(truths, counted, plans_lidar, heading) for counted in objects]
    turned = find_waypoint_contacts(truths, objects[-1], plans_lidar, definition.headings(plans_lidar))
    return CounterfactualVerdicts(
        np.stack(
            [
                exact.collision,
                exact.step("waypoint_collision"),
                *contacts,
                turned,
                find_contacts_before_mask(official),
                official.collision,
            ]
        )
    )


def filter_objects(definition: CollisionProtocol, truths: StackedTruths) -> list[Bools]:
    """Four times (M, 6) objects a protocol keeps: by class; also annotated; also in range; also with sensor points.

    The last is what the protocol counts.
    """
    everywhere = np.ones_like(truths.annotated)
    at_hand = truths.boxes.copy()
    at_hand[..., :2] = 0.0
    pointed = replace(truths, has_points=everywhere, has_lidar_points=everywhere)
    unseen = replace(pointed, boxes=at_hand, annotated=everywhere, seen_before=everywhere[:, 0])
    by_class = definition.counted_objects(unseen)
    by_annotation = definition.counted_objects(replace(pointed, boxes=at_hand))
    by_range = definition.counted_objects(pointed)
    there = truths.annotated[:, 1:]
    filters = (by_class & there, by_annotation, by_range, definition.counted_objects(truths))
    return [np.logical_and.reduce(filters[: count + 1]) for count in range(len(filters))]


def find_contacts_before_mask(outcomes: ProtocolOutcomes) -> Bools:
    """(S, 6) contacts of a protocol before its mask of what the recorded ego does, if it has one."""
    return np.asarray(outcomes.steps.get("before_mask", outcomes.collision), np.bool_).reshape(-1, PLAN_STEPS)


def explain_disagreements(
    truths: Sequence[SampleTruth], plans_lidar: Floats, outcomes: Mapping[str, ProtocolOutcomes]
) -> list[dict[str, str]]:
    """Cause (`CAUSES`) by protocol, for each sample, of disagreement with ``exact`` on "any collision within 3 s".

    ``plans_lidar`` are (S, 6, 2) waypoints of the lidar origin, x right, y forward, metres; ``outcomes`` are those of
    registered protocols. Empty where the verdicts agree, where the protocol or ``exact`` does not count the sample, and
    everywhere if ``exact`` is not among the outcomes.
    """
    plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
    if any(count != len(truths) for count in (len(plans), *map(len, outcomes.values()))):
        raise ValueError(f"{len(truths)} truths, but plans or outcomes of another number of samples")
    causes: list[dict[str, str]] = [{} for _ in truths]
    if EXACT not in outcomes:
        return causes
    exact = outcomes[EXACT]
    for name, official in outcomes.items():
        differ = np.flatnonzero(are_comparable(exact, official) & (has_any_contact(exact) != has_any_contact(official)))
        if name == EXACT:
            continue
        apart = np.array([truths[index].timed is not None for index in differ], np.bool_)
        for index in differ[apart].tolist():
            causes[index][name] = f"{FALSE_ALARM if official.collision[index].any() else MISS}: {OTHER_INSTANTS}"
        differ = differ[~apart]
        if not len(differ):
            continue
        rungs = compute_counterfactuals(
            PROTOCOLS[name],
            stack([truths[index] for index in differ]),
            plans[differ],
            _select_samples(exact, differ),
            _select_samples(official, differ),
        )
        for index, cause in zip(differ.tolist(), rungs.causes()):
            assert cause is not None
            causes[index][name] = cause
    return causes


def _select_samples(outcomes: ProtocolOutcomes, samples: NDArray[np.int64]) -> ProtocolOutcomes:
    return ProtocolOutcomes(
        collision=outcomes.collision[samples],
        l2=outcomes.l2[samples],
        valid=outcomes.valid[samples],
        counted=outcomes.counted[samples],
        known=None if outcomes.known is None else outcomes.known[samples],
        steps={name: column[samples] for name, column in outcomes.steps.items()},
    )


def has_any_contact(outcomes: ProtocolOutcomes) -> Bools:
    """Whether a protocol reports a collision at any step, after its mask."""
    return np.asarray(outcomes.collision.any(axis=-1))


def are_comparable(exact: ProtocolOutcomes, official: ProtocolOutcomes) -> Bools:
    """Samples on which two protocols can be compared: both count them, and all their contacts are known."""
    return np.logical_and(exact.decided & exact.valid.all(axis=-1), official.decided)


@dataclass(frozen=True, slots=True)
class Confusion:
    """Verdicts of a protocol against the exact ones.

    Missed are collisions of ``exact`` alone, false alarms those of the protocol alone.
    """

    compared: int
    exact: int
    official: int
    missed: int
    false_alarms: int

    @property
    def missed_share(self) -> float | None:
        """Share of the exact collisions that are missed; ``None`` if there are none."""
        return self.missed / self.exact if self.exact else None

    @property
    def false_share(self) -> float | None:
        """Share of the reported collisions that are false; ``None`` if there are none."""
        return self.false_alarms / self.official if self.official else None


def count_confusion(exact: Bools, official: Bools) -> Confusion:
    """Count verdicts against each other; both arrays have the same shape."""
    return Confusion(
        compared=exact.size,
        exact=int(exact.sum()),
        official=int(official.sum()),
        missed=int((exact & ~official).sum()),
        false_alarms=int((official & ~exact).sum()),
    )


def count_sample_confusion(exact: ProtocolOutcomes, official: ProtocolOutcomes, *, masked: bool = True) -> Confusion:
    """Count "any collision within 3 s" over the samples that both protocols count.

    ``masked`` applies the protocol's mask, as in its published numbers; of ``exact`` any contact at any time counts.
    """
    both = are_comparable(exact, official)
    reported = official.collision if masked else find_contacts_before_mask(official)
    return count_confusion(has_any_contact(exact)[both], reported.any(axis=-1)[both])


def count_step_confusion(exact: ProtocolOutcomes, official: ProtocolOutcomes, *, masked: bool = True) -> Confusion:
    """Count contacts at the same waypoint over the steps of the samples that both protocols count.

    ``masked`` applies the protocol's mask, as in its published numbers; of ``exact`` only contacts at waypoints count.
    """
    both = are_comparable(exact, official)
    reported = official.collision if masked else find_contacts_before_mask(official)
    return count_confusion(exact.step("waypoint_collision").astype(np.bool_)[both], reported[both])


@dataclass(frozen=True, slots=True)
class ProtocolComparison:
    """One protocol, after its mask, against ``exact``: any collision within 3 s, and contact at the same waypoint.

    ``mask_removed_steps`` are colliding steps that the mask takes away. ``causes`` counts each of `CAUSES`; ``None`` if
    the record does not say it of every disagreement.
    """

    samples: Confusion
    steps: Confusion
    mask_removed_steps: int
    samples_with_removed_steps: int
    causes: Counter[str] | None


def compare_protocols(record: RunRecord) -> dict[str, ProtocolComparison]:
    """Misses and false alarms on a run judged by ``exact``, from its rows alone, by sorted name of each other protocol.

    Over the samples that have a plan and that both count.
    """
    names = tuple(sorted(record.run.protocols))
    cache = record.columns.kept
    if (key := ("comparisons", names)) not in cache:
        exact = collect_outcomes(record.rows, EXACT)
        cache[key] = {name: _compare_protocol(record, name, exact) for name in names if name != EXACT}
    return dict(cache[key])


def _compare_protocol(record: RunRecord, protocol: str, exact: ProtocolOutcomes) -> ProtocolComparison:
    official = collect_outcomes(record.rows, protocol)
    both = are_comparable(exact, official)
    removed = (find_contacts_before_mask(official) & ~official.collision)[both]
    wrong = both & (has_any_contact(exact) != has_any_contact(official))
    disagreements = record.columns.values("disagreements")
    differing = [disagreements[place] for place in record.columns.planned[wrong].tolist()]
    known = all(protocol in causes for causes in differing)
    return ProtocolComparison(
        samples=count_sample_confusion(exact, official),
        steps=count_step_confusion(exact, official),
        mask_removed_steps=int(removed.sum()),
        samples_with_removed_steps=int(removed.any(axis=1).sum()),
        causes=Counter(causes[protocol] for causes in differing) if known else None,
    )
