"""Which candidate of a search is driven: the best that stays on the road and can end without touching another."""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.interactions.tracks import Integers
from generation.extensions.reactive_adversary.rules import AdversaryRules
from generation.extensions.reactive_adversary.safe_endings import SurroundingTracks
from generation.search.hyperparameters import HyperParameters
from generation.search.refinement import Refinement, compare_scores

MOST_CANDIDATES_CHECKED: Final = 96
"""Candidates that are asked after the best one of a search, where that may not be driven."""
_TOGETHER: Final = (1, 8, 24, MOST_CANDIDATES_CHECKED)
"""Mostly the first may be driven; the others are looked at together, more and more at a time, the last not by rules."""


def list_allowed(refinement: Refinement, hyper: HyperParameters, steps: int, *, on_road: bool) -> list[tuple[int, int]]:
    """Round and index: what the search chose, then the others by score, but those that leave the road if ``on_road``.

    That is asked of what would be executed, so many ``steps``.
    """
    found = [batch.evaluated for batch in refinement.batches]
    may = np.stack([each.motion.finite for each in found])
    if on_road:
        may &= ~np.stack([each.terms.center_off_road[:, :steps].any(axis=1) for each in found])
    others = order_candidates(compare_scores(refinement.batches, hyper), MOST_CANDIDATES_CHECKED)
    return [each for each in itertools.chain([(refinement.round, refinement.chosen)], others) if may[each]]


def find_drivable(
    candidates: Iterable[tuple[int, int]],
    refinement: Refinement | None,
    around: SurroundingTracks,
    steps: int,
    rules: AdversaryRules | None = None,
    are_allowed: Callable[[Floats], Bools] | None = None,
) -> tuple[int, int, Floats] | None:
    """The first candidate that has an ending, by round and index, and that ending; ``None`` where none has.

    ``are_allowed`` says which whole motions are (`SurroundingTracks.find_ending`).
    """
    asked = iter(candidates)
    for most in _TOGETHER if rules is None else _TOGETHER[:-1]:
        some = [*itertools.islice(asked, most)]
        if refinement is None or not some:
            break
        motions, back = _collect_motions(some, refinement), None
        if rules is not None:
            fair = np.flatnonzero(rules.are_fair(motions))
            some, motions = [some[row] for row in fair], motions[fair]
            back = None if are_allowed is None else rules.find_return(around, motions, steps, are_allowed)
            motions = motions if back is None else motions[: back[0]]
        found = around.find_ending(motions, steps, are_allowed)
        found = back if found is None else found
        if found is not None:
            return (*some[found[0]], found[1])
    return None


def choose_by_rules(
    candidates: list[tuple[int, int]],
    refinement: Refinement | None,
    around: SurroundingTracks,
    steps: int,
    rules: AdversaryRules,
    options: Callable[[], Sequence[Floats]],
) -> tuple[int, int, Floats] | Floats | None:
    """A candidate and its ending as of `find_drivable`, or one of other motions (K + 1, 3); ``None``: nothing is fair.

    Rules are dropped one by one: that the ego may turn; that an ending is fair, too; the road, as briefly as can be.
    Of the motions the first goes on as was meant; returning from it to the recording is another. Mostly none is needed.
    """

    @functools.cache
    def list_options() -> list[Floats]:
        meant, *others = options()
        back = rules.find_return(around, meant[None], 0, rules.are_on_road)
        return [meant, *([] if back is None else back[1:]), *others]

    expected = rules.as_expected
    may_turn = ((rules, rules.are_kept),) if len(rules.careful) > 1 else ()
    for held, are_allowed in (*may_turn, (expected, expected.are_kept), (expected, expected.are_on_road)):
        found = find_drivable(candidates, refinement, around, steps, held, are_allowed)
        kept = held.find_kept(around, list_options(), keeps_to_road=True) if found is None else None
        if found is not None or kept is not None:
            return kept if found is None else found
    if refinement is None or not candidates:
        return expected.find_kept(around, list_options(), keeps_to_road=False)
    off = expected.measure_off_road(_collect_motions(candidates, refinement).transpose(2, 0, 1))
    shortest = [candidates[row] for row in np.argsort(off, kind="stable").tolist()]
    found = find_drivable(shortest, refinement, around, steps, expected)
    kept = expected.find_kept(around, list_options(), keeps_to_road=False)
    if found is None or kept is None:
        return kept if found is None else found
    motion = _collect_motions([found[:2]], refinement)[0]
    meant, other = (float(expected.measure_off_road(poses.T[:, None])[0]) for poses in (motion, kept))
    return found if meant <= other else kept


def _collect_motions(candidates: Iterable[tuple[int, int]], refinement: Refinement) -> Floats:
    """(N, F, 3) of candidates by round and index."""
    return np.stack([refinement.batches[number].evaluated.motion.center[index] for number, index in candidates])


def order_candidates(scores: Floats, most: int) -> Iterator[tuple[int, int]]:
    """Round and index of at most ``most`` finite (R, B) scores: lowest first, and as many from all over the rest."""
    flat = scores.ravel()
    order: Integers = np.argsort(flat, kind="stable")
    order = order[np.isfinite(flat[order])]
    # The best candidates are alike: an obstacle to one of them stops the others, too.
    spread = np.unique(np.linspace(0, max(len(order) - 1, 0), most - most // 2).astype(np.int64))
    for place in order[np.union1d(np.arange(min(most // 2, len(order))), spread[: len(order)])].tolist():
        yield divmod(place, scores.shape[1])
