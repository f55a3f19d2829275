"""Verdicts of a protocol counted against the exact ones: what it misses and what it invents, from rows alone."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Bools
from benchmark.metrics.disagreement import EXACT, any_contact, before_mask, compared
from benchmark.protocols import Outcomes
from benchmark.records.run import RunRecord, outcomes_of


@dataclass(frozen=True, slots=True)
class Confusion:
    """Verdicts of a protocol counted against the exact ones.

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


def confusion(exact: Bools, official: Bools) -> Confusion:
    """Count verdicts against each other; both arrays have the same shape."""
    return Confusion(
        compared=exact.size,
        exact=int(exact.sum()),
        official=int(official.sum()),
        missed=int((exact & ~official).sum()),
        false_alarms=int((official & ~exact).sum()),
    )


def sample_confusion(exact: Outcomes, official: Outcomes, *, masked: bool = True) -> Confusion:
    """Count "any collision within 3 s" over the samples that both protocols count.

    ``masked`` applies the protocol's mask, as in its published numbers; of ``exact`` any contact at any time
    counts.
    """
    both = compared(exact, official)
    reported = official.collision if masked else before_mask(official)
    return confusion(any_contact(exact)[both], reported.any(axis=-1)[both])


def step_confusion(exact: Outcomes, official: Outcomes, *, masked: bool = True) -> Confusion:
    """Count contacts at the same waypoint over the steps of the samples that both protocols count.

    ``masked`` applies the protocol's mask, as in its published numbers; of ``exact`` only contacts at the waypoints
    count.
    """
    both = compared(exact, official)
    reported = official.collision if masked else before_mask(official)
    return confusion(exact.step("waypoint_collision").astype(np.bool_)[both], reported[both])


@dataclass(frozen=True, slots=True)
class ProtocolComparison:
    """One protocol against ``exact`` on one run.

    Attributes:
        samples: "Any collision within 3 s", after the protocol's mask.
        steps: Contact at the same waypoint, after the protocol's mask.
        mask_removed_steps: Colliding steps that the mask takes away.
        causes: How often each of `CAUSES` occurs; ``None`` if the record does not say it of every disagreement.
    """

    samples: Confusion
    steps: Confusion
    mask_removed_steps: int
    samples_with_removed_steps: int
    causes: Counter[str] | None


def comparisons(record: RunRecord) -> dict[str, ProtocolComparison]:
    """Misses and false alarms of protocols on a run judged by ``exact``, from its rows alone.

    By name, in the order of the names, of each other protocol that judged it; over the samples that have a plan and
    that both count.
    """
    names = tuple(sorted(record.run.protocols))
    kept = record.columns.kept
    if (key := ("comparisons", names)) not in kept:
        exact = outcomes_of(record.rows, EXACT)
        kept[key] = {name: _compared(record, name, exact) for name in names if name != EXACT}
    return dict(kept[key])


def _compared(record: RunRecord, protocol: str, exact: Outcomes) -> ProtocolComparison:
    official = outcomes_of(record.rows, protocol)
    both = compared(exact, official)
    removed = (before_mask(official) & ~official.collision)[both]
    wrong = both & (any_contact(exact) != any_contact(official))
    said = record.columns.values("disagreements")
    differing = [said[place] for place in record.columns.planned[wrong].tolist()]
    known = all(protocol in causes for causes in differing)
    return ProtocolComparison(
        samples=sample_confusion(exact, official),
        steps=step_confusion(exact, official),
        mask_removed_steps=int(removed.sum()),
        samples_with_removed_steps=int(removed.any(axis=1).sum()),
        causes=Counter(causes[protocol] for causes in differing) if known else None,
    )
