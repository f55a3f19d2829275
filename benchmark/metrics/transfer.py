"""Do scenes that break one planner break another: the surrogate-filtered matrix of the paper's appendix.

A scene fails a planner if any counted sample of it collides at any step (`records.rows.find_scene_failures`). Cell
(surrogate, victim) is the share of the surrogate's failed scenes that the victim fails too. It is not symmetric, and
the victim's failure rate over all scenes (``base_rates``) belongs beside it: transfer is what exceeds that. Two
planners that fail many scenes share many of them by chance; lift and the phi coefficient say how much more than that.

The paper counts any collision. With ``adversary_only`` a scene fails a planner if the first contact of a counted sample
under ``exact`` is with an adversary: bystanders in whom both planners collide anyway are no transfer.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import find_touched_scenes, knows_contact_partners
from benchmark.metrics.rates import Estimate, Rate, find_intervals, resample_totals
from benchmark.metrics.scores import describe_record, map_scenes_to_sources, require_current
from benchmark.protocols import find_protocol as definition_of
from benchmark.records.planner_versions import list_file_notes
from benchmark.records.rows import find_scene_failures
from benchmark.records.run import NATIVE, RunRecord, resolve_protocol

Verdicts = Mapping[str, bool | None]
"""Whether a planner fails, by scene; ``None`` where that cannot be said."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far two planners fail the same scenes, over the scenes that both were judged on.

    ``phi`` is the correlation of the two verdicts, -1..1; it does not exist where one of them fails all or none.
    ``lift`` is how many times more often they fail together than by chance, both * all / (fails of the first * fails of
    the second), with its 95 % interval; ``None`` where one of them fails none.
    """

    planners: tuple[str, str]
    both: int
    only_first: int
    only_second: int
    neither: int
    phi: Estimate
    lift: float | None
    lift_low: float | None
    lift_high: float | None

    @property
    def scenes(self) -> int:
        """Scenes that both were judged on."""
        return self.both + self.only_first + self.only_second + self.neither


@dataclass(frozen=True, slots=True)
class TransferMatrix:
    """Failure transfer between planners on one split.

    Attributes:
        protocol: Who judged the collisions; ``native`` if each planner's own protocol did.
        adversary_only: Whether only first contacts with an adversary fail a scene.
        recordings: How many recorded scenes the scenes come from; they are what the intervals draw.
        planners: Names of P planners, in the order given.
        privileged: P flags: whether the planner saw what no car sees.
        miniatures: P flags: whether the planner shows the pipeline and ranks nothing.
        judges: P protocols: who judged each planner.
        cells: P x P, first index surrogate, second victim. ``denominator`` counts the scenes that the surrogate fails
            and both were judged on, ``numerator`` those that the victim fails too; ``value`` is ``None`` (a dash)
            where the surrogate fails none. The diagonal is 1 by construction.
        base_rates: P rates of failed scenes over all scenes that the planner was judged on.
        undecided: P lists of scenes without a verdict for the planner; they are in no denominator of it.
        agreements: One for each pair of planners, in their order.
        records: P content ids of the records (`benchmark.records.run.RunRecord.content_id`).
        file_notes: What has to be said of planners whose plans come from a file.
    """

    protocol: str
    adversary_only: bool
    split: str
    recordings: int
    planners: tuple[str, ...]
    privileged: tuple[bool, ...]
    miniatures: tuple[bool, ...]
    judges: tuple[str, ...]
    cells: tuple[tuple[Rate, ...], ...]
    base_rates: tuple[Rate, ...]
    undecided: tuple[tuple[str, ...], ...]
    agreements: tuple[Agreement, ...]
    records: tuple[str, ...]
    file_notes: tuple[str, ...] = ()


def transfer(
    records: Sequence[RunRecord], *, protocol: str = EXACT, adversary_only: bool = False, seed: int = 0
) -> TransferMatrix:
    """Transfer matrix of several planners on the same scenes.

    Args:
        records: One for each planner.
        protocol: Whose verdicts count; ``native`` takes those of each planner's own repository.
        adversary_only: Whether only first contacts with an adversary fail a scene; ``exact`` alone says that.
        seed: Seed of the intervals. What is drawn is the recorded scene with everything made from it.

    Returns:
        The matrix.

    Raises:
        InputError: If there is no record, a planner appears twice, the records are not of the same data and split, or a
            record was not judged by the protocol or by another version of it, or does not say whom contacts are with,
            or no scene has a verdict.
    """
    judges = _find_judges(records, protocol)
    if adversary_only and protocol != EXACT:
        raise InputError(f"only {EXACT} reports which road user is touched first, not {protocol}; use {EXACT}")
    verdicts = [
        find_adversary_failures(record) if adversary_only else find_scene_failures(record.rows, judge)
        for record, judge in zip(records, judges)
    ]
    if all(failed is None for verdict in verdicts for failed in verdict.values()):
        raise InputError(
            f"no scene of split {records[0].run.split!r} has a verdict of {' or '.join(dict.fromkeys(judges))}, as no "
            "sample is complete and has its surroundings annotated; choose another split or protocol"
        )
    every_scene = sorted({scene for verdict in verdicts for scene in verdict})
    sources = {scene: source for record in records for scene, source in map_scenes_to_sources(record).items()}
    failures = FailureMatrix.of(verdicts, sources)
    return TransferMatrix(
        protocol=protocol,
        adversary_only=adversary_only,
        split=records[0].run.split,
        recordings=len(set(sources.values())),
        planners=tuple(record.planner for record in records),
        privileged=tuple(record.run.planner.privileged for record in records),
        miniatures=tuple(record.run.planner.miniature for record in records),
        judges=judges,
        cells=tuple(failures.compute_transfer(surrogate, seed) for surrogate in range(len(records))),
        base_rates=tuple(failures.base_rates(seed)),
        undecided=tuple(tuple(scene for scene in every_scene if verdict.get(scene) is None) for verdict in verdicts),
        agreements=tuple(
            agreement
            for first in range(len(records))
            for agreement in failures.agreements(first, [record.planner for record in records], seed)
        ),
        records=tuple(record.content_id for record in records),
        file_notes=tuple(list_file_notes(records)),
    )


@dataclass(frozen=True, slots=True)
class FailureMatrix:
    """Which of S scenes P planners fail: (P, S) 1 in ``fails``, and in ``known`` where that can be said.

    ``units`` are U sorted names of what is drawn together, ``unit_of`` (S, U) is 1 where a scene is of a unit.
    """

    fails: Floats
    known: Floats
    units: tuple[str, ...]
    unit_of: Floats

    @classmethod
    def of(cls, verdicts: Sequence[Verdicts], sources: Mapping[str, str]) -> "FailureMatrix":
        """Verdicts of P planners as arrays; scenes without a source stand for themselves."""
        scenes = sorted({scene for verdict in verdicts for scene in verdict})
        units = sorted({sources.get(scene, scene) for scene in scenes})
        fails = np.array([[verdict.get(scene) is True for scene in scenes] for verdict in verdicts], np.float64)
        known = np.array([[verdict.get(scene) is not None for scene in scenes] for verdict in verdicts], np.float64)
        unit_of = np.array([[sources.get(scene, scene) == unit for unit in units] for scene in scenes], np.float64)
        return cls(fails, known, tuple(units), unit_of.reshape(len(scenes), len(units)))

    def compute_transfer(self, surrogate: int, seed: int) -> tuple[Rate, ...]:
        """How many of a surrogate's failed scenes each of P victims fails too."""
        failed = self._sum_by_unit(self.fails[surrogate] * self.known)
        both = self._sum_by_unit(self.fails[surrogate] * self.fails)
        return tuple(self._rates(both, failed, self._shared(surrogate), seed))

    def base_rates(self, seed: int) -> list[Rate]:
        """How many of all scenes that a planner was judged on each of P planners fails."""
        known = self._sum_by_unit(self.known)
        return self._rates(self._sum_by_unit(self.fails), known, known > 0, seed)

    def agreements(self, first: int, names: Sequence[str], seed: int) -> list[Agreement]:
        """Agreement of a planner with each that follows it."""
        others = slice(first + 1, None)
        fails, known, shared = self.fails[others], self.known[others], self._shared(first)[others]
        both = self._sum_by_unit(self.fails[first] * fails)
        only_first = self._sum_by_unit(self.fails[first] * known) - both
        only_second = self._sum_by_unit(self.known[first] * fails) - both
        neither = self._sum_by_unit(self.known[first] * known) - both - only_first - only_second
        tables = np.stack([both, only_first, only_second, neither])
        totals = tables.sum(axis=2)
        values = _phi(totals.T)
        estimable = ~np.isnan(values) & (np.count_nonzero(shared, axis=1) > 1)
        intervals = self._find_intervals(tables, shared, estimable, (-1.0, 1.0), lambda drawn: _phi_of(*drawn), seed)
        lifts = _lift_of(*totals)
        estimable = ~np.isnan(lifts) & (np.count_nonzero(shared, axis=1) > 1)
        # The maximum: both fail one scene, the same one.
        most = float(self.fails.shape[1])
        of_lift = self._find_intervals(tables, shared, estimable, (0.0, most), lambda drawn: _lift_of(*drawn), seed)
        return [
            Agreement(
                (names[first], names[first + 1 + place]),
                **dict(zip(("both", "only_first", "only_second", "neither"), map(round, total))),
                phi=Estimate(None if math.isnan(phi) else phi, *interval),
                lift=None if math.isnan(lift) else lift,
                lift_low=ends[0],
                lift_high=ends[1],
            )
            for place, (total, phi, interval, lift, ends) in enumerate(
                zip(totals.T.tolist(), values.tolist(), intervals, lifts.tolist(), of_lift, strict=True)
            )
        ]

    def _sum_by_unit(self, scenes: Floats) -> Floats:
        """(P, U) sums over the scenes of each unit."""
        return np.asarray(scenes @ self.unit_of)

    def _shared(self, planner: int) -> Bools:
        """(P, U) whether a planner and each other one were judged on a scene of a unit."""
        return self._sum_by_unit(self.known[planner] * self.known) > 0

    def _rates(self, both: Floats, failed: Floats, shared: Bools, seed: int) -> list[Rate]:
        """Rates of (P, U) counts, and intervals where more than one unit has something below the line."""
        estimable = np.count_nonzero(failed, axis=1) > 1
        intervals = self._find_intervals(
            np.stack([both, failed]), shared, estimable, (0.0, 1.0), lambda drawn: _quotient(drawn[0], drawn[1]), seed
        )
        return [
            Rate(above / below if below else None, above, round(below), *interval)
            for above, below, interval in zip(
                both.sum(axis=1).tolist(), failed.sum(axis=1).tolist(), intervals, strict=True
            )
        ]

    def _find_intervals(
        self,
        counts: Floats,
        shared: Bools,
        estimable: Bools,
        bounds: tuple[float, float],
        number: Callable[[Floats], Floats],
        seed: int,
    ) -> list[tuple[float | None, float | None]]:
        """Intervals of numbers made of (K, P, U) counts, for the planners that are asked for.

        Units are drawn that a pair shares: pairs that share the same ones are drawn together.
        """
        intervals: list[tuple[float | None, float | None]] = [(None, None)] * len(estimable)
        for units in np.unique(shared[estimable], axis=0):
            planners = np.flatnonzero(estimable & (shared == units).all(axis=1))
            names = tuple(name for name, there in zip(self.units, units.tolist()) if there)
            # Whole numbers: their totals are the same in any order.
            chosen = counts[:, planners][:, :, units].reshape(-1, len(names))
            drawn = resample_totals(np.ascontiguousarray(chosen.T), names, seed=seed).T.reshape(
                len(counts), len(planners), -1
            )
            for place, low, high in zip(
                planners.tolist(), *(part.tolist() for part in find_intervals(number(drawn), bounds))
            ):
                intervals[place] = low, high
        return intervals


def _phi(counts: Floats) -> Floats:
    """Phi coefficients of (R, 4) fourfold tables; NaN where a margin is empty."""
    return _phi_of(*counts.T)


def _phi_of(both: Floats, first: Floats, second: Floats, neither: Floats) -> Floats:
    margins = (both + first) * (both + second) * (first + neither) * (second + neither)
    return _quotient(both * neither - first * second, np.sqrt(margins))


def _lift_of(both: Floats, first: Floats, second: Floats, neither: Floats) -> Floats:
    """How many times more often both fail than by chance; NaN where one of them fails none."""
    return _quotient(both * (both + first + second + neither), (both + first) * (both + second))


def _quotient(above: Floats, below: Floats) -> Floats:
    """Quotients, NaN where the denominator is zero."""
    return np.divide(above, below, out=np.full_like(above, np.nan), where=below > 0)


def find_adversary_failures(record: RunRecord) -> dict[str, bool | None]:
    """Scenes that a planner fails by touching the adversary first.

    Verdicts as `records.rows.find_scene_failures` has them; the record must say whom contacts are with.
    """
    if not knows_contact_partners(record):
        raise InputError(
            f"{describe_record(record)} does not say whom contacts are with, or who is an adversary; run "
            "challenger-bench rescore"
        )
    failures = find_touched_scenes(record)
    return {scene: failures.get(scene) for scene in record.run.scenes}


def _find_judges(records: Sequence[RunRecord], protocol: str) -> tuple[str, ...]:
    """Protocol that judged each record; refuses records that cannot be compared."""
    if not records:
        raise InputError("a transfer matrix needs run records, but none were found; run challenger-bench eval first")
    if protocol != NATIVE:
        # An unknown protocol is reported as unknown, rather than as one that did not judge.
        definition_of(protocol)
    names = [record.planner for record in records]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(
            f"more than one record of {', '.join(repeated)} on this split; select single runs with --records"
        )
    first = records[0].run
    judges = tuple(resolve_protocol(record, protocol) for record in records)
    for record, judge in zip(records, judges):
        run = record.run
        if (record.judged_content, run.split) != (records[0].judged_content, first.split):
            raise InputError(
                f"{record.directory} is split {run.split!r} of {run.data.name!r} and {records[0].directory} is split "
                f"{first.split!r} of {first.data.name!r} with other content or other verdicts of "
                "inspectors; transfer compares records of the same scenes"
            )
        require_current(record, judge)
    return judges
