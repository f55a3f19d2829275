"""Do scenes that break one planner break another: the surrogate-filtered matrix of the paper's appendix.

A scene fails a planner if any counted sample of it collides at any step (`benchmark.records.run.scene_failures`). Cell
(surrogate, victim) is the share of the surrogate's failed scenes that the victim fails too. It is not symmetric, and
the victim's failure rate over all scenes (``base_rates``) belongs beside it: transfer is what exceeds that. Two
planners that fail many scenes share many of them by chance; the phi coefficient says how much more than that.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.metrics.rates import Estimate, Rate, SceneSums, ends, resampled, sums_by_scene
from benchmark.metrics.scores import require_current, source_of_scenes
from benchmark.protocols import protocol as definition_of
from benchmark.records.file_plans import file_notes
from benchmark.records.run import NATIVE, RunRecord, protocol_of, scene_failures

Verdicts = Mapping[str, bool | None]
"""Whether a planner fails, by scene; ``None`` where that cannot be said."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far two planners fail the same scenes, over the scenes that both were judged on.

    Attributes:
        planners: Names of the first and the second.
        both: Scenes that both fail.
        only_first: Scenes that the first alone fails.
        only_second: Scenes that the second alone fails.
        neither: Scenes that none of them fails.
        phi: Correlation of the two verdicts, -1..1; it does not exist where one of them fails all or none.
        lift: How many times more often they fail together than by chance: both * all / (fails of the first * fails of
            the second); ``None`` where one of them fails none.
    """

    planners: tuple[str, str]
    both: int
    only_first: int
    only_second: int
    neither: int
    phi: Estimate
    lift: float | None


@dataclass(frozen=True, slots=True)
class TransferMatrix:
    """Failure transfer between planners on one split.

    Attributes:
        protocol: Who judged the collisions; ``native`` if each planner's own protocol did.
        split: Name of the split.
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


def transfer(records: Sequence[RunRecord], *, protocol: str = "exact", seed: int = 0) -> TransferMatrix:
    """Transfer matrix of several planners on the same scenes.

    Args:
        records: One for each planner.
        protocol: Whose verdicts count; ``native`` takes those of each planner's own repository.
        seed: Seed of the intervals. What is drawn is the recorded scene with everything made from it.

    Returns:
        The matrix.

    Raises:
        InputError: If there is no record, a planner appears twice, the records are not of the same data and split, or a
            record was not judged by the protocol or by another version of it.
    """
    judges = _judges(records, protocol)
    verdicts = [scene_failures(record.rows, judge) for record, judge in zip(records, judges)]
    every_scene = sorted({scene for verdict in verdicts for scene in verdict})
    sources = {scene: source for record in records for scene, source in source_of_scenes(record).items()}
    return TransferMatrix(
        protocol=protocol,
        split=records[0].run.split,
        recordings=len(set(sources.values())),
        planners=tuple(record.planner for record in records),
        privileged=tuple(record.run.planner.privileged for record in records),
        miniatures=tuple(record.run.planner.miniature for record in records),
        judges=judges,
        cells=tuple(tuple(_cell(surrogate, victim, sources, seed) for victim in verdicts) for surrogate in verdicts),
        base_rates=tuple(_cell(dict.fromkeys(verdict, True), verdict, sources, seed) for verdict in verdicts),
        undecided=tuple(tuple(scene for scene in every_scene if verdict.get(scene) is None) for verdict in verdicts),
        agreements=tuple(
            _agreement(
                (records[first].planner, records[second].planner), verdicts[first], verdicts[second], sources, seed
            )
            for first, second in itertools.combinations(range(len(records)), 2)
        ),
        records=tuple(record.content_id for record in records),
        file_notes=tuple(file_notes(records)),
    )


def _cell(surrogate: Verdicts, victim: Verdicts, sources: Mapping[str, str], seed: int) -> Rate:
    sums = _fourfold(surrogate, victim, sources)
    both, only_surrogate = sums.numerators[:, 0], sums.numerators[:, 1]
    shared, failed = float(both.sum()), float(both.sum() + only_surrogate.sum())
    interval: tuple[float | None, float | None] = (None, None)
    if np.count_nonzero(both + only_surrogate) > 1:
        drawn = resampled(np.stack([both, both + only_surrogate], axis=1), sums.names, seed=seed)
        interval = ends(_quotient(drawn[:, 0], drawn[:, 1]), (0.0, 1.0))
    return Rate(shared / failed if failed else None, shared, round(failed), *interval)


def _agreement(
    planners: tuple[str, str], first: Verdicts, second: Verdicts, sources: Mapping[str, str], seed: int
) -> Agreement:
    sums = _fourfold(first, second, sources)
    both, only_first, only_second, neither = (round(count) for count in sums.numerators.sum(axis=0).tolist())
    phi = float(_phi(sums.numerators.sum(axis=0)[None])[0])
    defined = not math.isnan(phi)
    interval: tuple[float | None, float | None] = (None, None)
    if defined and len(sums.names) > 1:
        interval = ends(_phi(resampled(sums.numerators, sums.names, seed=seed)), (-1.0, 1.0))
    product = (both + only_first) * (both + only_second)
    return Agreement(
        planners=planners,
        both=both,
        only_first=only_first,
        only_second=only_second,
        neither=neither,
        phi=Estimate(phi if defined else None, *interval),
        lift=both * (both + only_first + only_second + neither) / product if product else None,
    )


def _fourfold(first: Verdicts, second: Verdicts, sources: Mapping[str, str]) -> SceneSums:
    """Scenes by recording that both, only the first, only the second, and neither fail; both must have a verdict."""
    scenes = [scene for scene, failed in first.items() if failed is not None and second.get(scene) is not None]
    pairs = [(first[scene], second[scene]) for scene in scenes]
    kinds = ((True, True), (True, False), (False, True), (False, False))
    counts = np.array([[float(pair == kind) for kind in kinds] for pair in pairs]).reshape(-1, len(kinds))
    return sums_by_scene(counts, np.ones_like(counts), [sources.get(scene, scene) for scene in scenes])


def _phi(counts: Floats) -> Floats:
    """Phi coefficients of (R, 4) fourfold tables; NaN where a margin is empty."""
    both, first, second, neither = counts.T
    margins = (both + first) * (both + second) * (first + neither) * (second + neither)
    return _quotient(both * neither - first * second, np.sqrt(margins))


def _quotient(above: Floats, below: Floats) -> Floats:
    """Quotients, NaN where the denominator is zero."""
    return np.divide(above, below, out=np.full_like(above, np.nan), where=below > 0)


def _judges(records: Sequence[RunRecord], protocol: str) -> tuple[str, ...]:
    """Who judged each record; refuses what cannot be compared."""
    if not records:
        raise InputError("a transfer matrix needs run records and there are none; run challenger-bench eval first")
    if protocol != NATIVE:
        # One that nobody knows is said to be that, rather than one that did not judge.
        definition_of(protocol)
    names = [record.planner for record in records]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(
            f"more than one record of {', '.join(repeated)} on this split; name single runs with --records"
        )
    first = records[0].run
    judges = tuple(protocol_of(record, protocol) for record in records)
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
