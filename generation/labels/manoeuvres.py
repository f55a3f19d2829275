"""Kinds of a vehicle's manoeuvre towards the ego, from its motion along the ego's path (``docs/manoeuvres.md``)."""

from collections.abc import Iterator
from enum import StrEnum

import numpy as np

from benchmark.geometry import Bools
from benchmark.records.attempts import Encroachment, ManoeuvreOccurrence
from generation.labels.interactions import MOVING_M_S, PathInteraction


class Manoeuvre(StrEnum):
    """Kinds of manoeuvre, the more telling ones first."""

    ONCOMING = "oncoming"
    CROSSING = "crossing"
    CUT_IN_LEFT = "cut-in-left"
    CUT_IN_RIGHT = "cut-in-right"
    BRAKING_AHEAD = "braking-ahead"
    BLOCKING = "blocking"
    SQUEEZING_LEFT = "squeezing-left"
    SQUEEZING_RIGHT = "squeezing-right"
    OVERTAKING_LEFT = "overtaking-left"
    OVERTAKING_RIGHT = "overtaking-right"
    TAILGATING = "tailgating"
    BLIND_SPOT_LEFT = "blind-spot-left"
    BLIND_SPOT_RIGHT = "blind-spot-right"
    LEADING = "leading"
    FOLLOWING = "following"
    PASSING_WIDE = "passing-wide"
    DISTANT = "distant"


HELD_FRAMES = 5
"""A condition holds at a frame if it does at most of the so many frames around it."""
SHORT_S = 0.5
LONG_S = 1.0
"""How long a state must last before it has a name: pressing ones, and ones that take time to notice."""
ALONG_RAD = np.deg2rad(45.0)
"""Headings within this of the path's are the ego's own direction; of its reverse, the opposite one."""
HORIZON_S = 3.0
"""Horizon of a plan: positions that the ego reaches within it matter."""
BLOCKING_S = 5.0
"""A vehicle ahead blocks if the ego would hit it within this at the present speeds."""
TAILGATING_S = 1.0
"""Time gap behind the ego below which a follower tailgates."""
BRAKING_M_S2 = 2.0
CLOSING_M_S = 1.5
SQUEEZING_M = 1.0
"""Gap to the side below which a vehicle presses; cars in the middle of neighbouring lanes keep about 1.7 m."""
BESIDE_M = 4.0
"""Gap to the ego's strip within which a vehicle is in the next lane."""
BLIND_SPOT_M = 3.0
"""How far behind the ego's rear, and how far to its side, the blind spot reaches."""
CLEAR_M = 0.3
"""Gap to the ego's strip that a vehicle had within the 3 s before it cuts in."""
GAIN_M = 3.0
OVERTAKEN_M = 2.0
"""An overtaking vehicle gains at least this while it is abreast, and is at least this far ahead then."""
DECISIVE_M = 5.0
"""The primary kind is one during which, or in the 3 s after which, the bodies came as near as ever, up to this."""
CLOSE_M = 10.0
"""Bodies farther apart than this all the time are distant."""


def find_occurrences(met: PathInteraction) -> tuple[ManoeuvreOccurrence, ...]:
    """Every kind of manoeuvre that occurred, one entry each, the primary one first, the others as in `Manoeuvre`.

    The primary kind is the first in the order of `Manoeuvre` among those during which the bodies came within 5 m of
    their least gap, or in the 3 s after which they did: what happened far away first is not what the scene is about.
    Where there is none, the vehicle passed wide, or was distant.
    """
    runs: dict[Manoeuvre, list[slice]] = {}
    for kind, run in (*_find_in_front(met), *_find_beside(met), *_find_behind(met)):
        runs.setdefault(kind, []).append(run)
    nearest = {kind: min(_compute_least_gap(met, run, HORIZON_S) for run in runs[kind]) for kind in runs}
    decisive = [kind for kind in Manoeuvre if nearest.get(kind, np.inf) <= float(met.gap.min()) + DECISIVE_M]
    if not decisive:
        decisive = [_add_passing(met, runs)]
    kinds = sorted(runs, key=lambda kind: (kind is not decisive[0], list(Manoeuvre).index(kind)))
    return tuple(_build_occurrence(met, kind, runs[kind]) for kind in kinds)


def find_encroachment(met: PathInteraction) -> Encroachment | None:
    """First of the closest successions of both bodies on one piece of the ego's path; ``None`` if none was shared."""
    at = np.flatnonzero(smooth_mask(met.inside))
    shared = (met.other.rear[at, None] < met.ego.front) & (met.other.front[at, None] > met.ego.rear)
    if not shared.any():
        return None
    between = np.where(shared, np.abs(met.seconds - met.seconds[at, None]), np.inf)
    which, when = np.unravel_index(int(between.argmin()), between.shape)
    return Encroachment(
        seconds=float(between[which, when]), ego_first=bool(when < at[which]), time_s=float(met.seconds[at[which]])
    )


def _find_in_front(met: PathInteraction) -> Iterator[tuple[Manoeuvre, slice]]:
    """Runs of what happens in the ego's way; crossing behind it counts too."""
    turn = np.abs(met.other.turn)
    same, moving = turn <= ALONG_RAD, met.speed >= MOVING_M_S
    opposing = turn >= np.pi - ALONG_RAD
    concerns = met.meet_s <= HORIZON_S
    facing = (met.is_within(SQUEEZING_M) & met.ahead & concerns) | (met.abreast & (met.gap <= SQUEEZING_M))
    for run in _find_runs(met, opposing & moving & facing):
        yield Manoeuvre.ONCOMING, run
    for run in _find_runs(met, met.inside):
        usual = np.median(turn[run])
        if ALONG_RAD < usual < np.pi - ALONG_RAD:
            if np.median(met.speed[run]) >= MOVING_M_S and _compute_succession(met, run) <= HORIZON_S:
                yield Manoeuvre.CROSSING, run
        elif usual <= ALONG_RAD and met.ahead[run.start] and _is_coming_in(met, run):
            early = run.start + np.flatnonzero(met.seconds[run] <= met.seconds[run.start] + HORIZON_S)
            entering = slice(run.start, int(early[-1]) + 1)
            if (met.reach_s[entering] <= HORIZON_S).any():
                from_left = met.other.offset[run.start] > 0
                yield Manoeuvre.CUT_IN_LEFT if from_left else Manoeuvre.CUT_IN_RIGHT, entering
    in_way = met.inside & met.ahead & (met.ego_speed >= MOVING_M_S)
    for run in _find_runs(met, in_way & same & (met.acceleration <= -BRAKING_M_S2) & concerns, SHORT_S):
        yield Manoeuvre.BRAKING_AHEAD, run
    closing = met.ego_speed - met.along
    blocks = (same | ~moving) & (closing >= CLOSING_M_S) & (met.room <= BLOCKING_S * closing)
    for run in _find_runs(met, in_way & blocks, SHORT_S):
        yield Manoeuvre.BLOCKING, run
    for run in _find_runs(met, in_way & same & (met.reach_s <= HORIZON_S), LONG_S):
        yield Manoeuvre.LEADING, run


def _find_beside(met: PathInteraction) -> Iterator[tuple[Manoeuvre, slice]]:
    """Runs of what happens to the left and right of an ego that moves, at their beginning at least."""
    same = np.abs(met.other.turn) <= ALONG_RAD
    driving = met.present & (met.ego_speed >= MOVING_M_S)
    lead = met.other.station - met.ego.station
    # An ego that stops while it is passed still counts as overtaken.
    for run in _find_runs(met, same & (met.side_gap <= BESIDE_M) & met.abreast):
        first, last = lead[run][0], lead[run][-1]
        if driving[run.start] and first < 0.0 and last >= OVERTAKEN_M and last - first >= GAIN_M:
            yield _choose_side(met, run, Manoeuvre.OVERTAKING_LEFT, Manoeuvre.OVERTAKING_RIGHT), run
    opposing = np.abs(met.other.turn) >= np.pi - ALONG_RAD
    for run in _find_runs(met, driving & ~opposing & met.abreast & (met.gap <= SQUEEZING_M), SHORT_S):
        yield _choose_side(met, run, Manoeuvre.SQUEEZING_LEFT, Manoeuvre.SQUEEZING_RIGHT), run
    hidden = (met.other.front <= met.ego.station) & (met.other.front >= met.ego.rear - BLIND_SPOT_M)
    for run in _find_runs(met, driving & same & hidden & ~met.inside & (met.side_gap <= BLIND_SPOT_M), LONG_S):
        yield _choose_side(met, run, Manoeuvre.BLIND_SPOT_LEFT, Manoeuvre.BLIND_SPOT_RIGHT), run


def _find_behind(met: PathInteraction) -> Iterator[tuple[Manoeuvre, slice]]:
    """Runs of what happens behind a moving ego, in its way."""
    same = np.abs(met.other.turn) <= ALONG_RAD
    trailing = met.inside & ~met.ahead & same & (met.ego_speed >= MOVING_M_S)
    for run in _find_runs(met, trailing & (met.pursuit_s <= TAILGATING_S), LONG_S):
        yield Manoeuvre.TAILGATING, run
    for run in _find_runs(met, trailing & (met.pursuit_s <= HORIZON_S), LONG_S):
        yield Manoeuvre.FOLLOWING, run


def _add_passing(met: PathInteraction, runs: dict[Manoeuvre, list[slice]]) -> Manoeuvre:
    """Add what remains where nothing else is decisive."""
    near = list(_find_runs(met, met.gap <= CLOSE_M))
    if near:
        runs[Manoeuvre.PASSING_WIDE] = near
        return Manoeuvre.PASSING_WIDE
    at = np.flatnonzero(met.present)
    runs[Manoeuvre.DISTANT] = [slice(int(at[0]), int(at[-1]) + 1)]
    return Manoeuvre.DISTANT


def _find_runs(met: PathInteraction, mask: Bools, least_s: float = 0.0) -> Iterator[slice]:
    """Runs of frames at which a condition holds, as `smooth_mask` says, for at least some time."""
    edges = np.flatnonzero(np.diff(smooth_mask(mask), prepend=False, append=False))
    for first, stop in edges.reshape(-1, 2).tolist():
        # The majority can settle on a frame that is itself an exception.
        if mask[first:stop].any() and (stop - first) * met.frame_s >= least_s - 1e-6:
            yield slice(first, stop)


def _is_coming_in(met: PathInteraction, run: slice) -> bool:
    """Whether the vehicle was there before a run inside, and clear of the ego's way: weaving in front is excluded."""
    if run.start < HELD_FRAMES or not met.present[run.start - HELD_FRAMES : run.start].all():
        return False
    before = slice(int(np.searchsorted(met.seconds, met.seconds[run.start] - HORIZON_S)), run.start)
    return bool((met.side_gap[before][met.present[before]] >= CLEAR_M).any())


def _choose_side(met: PathInteraction, run: slice, left: Manoeuvre, right: Manoeuvre) -> Manoeuvre:
    return left if np.median(met.other.offset[run]) > 0.0 else right


def _compute_succession(met: PathInteraction, run: slice) -> float:
    """Shortest time between the vehicle in the ego's way and the ego there, in either order."""
    passed = np.searchsorted(np.maximum.accumulate(met.ego.rear), met.other.front[run])
    since = met.seconds[run] - met.seconds[np.minimum(passed, len(met.seconds) - 1)]
    # Positions that the ego passed before the first frame have an unknown time.
    is_known = (met.ego.rear[run] >= met.other.front[run]) & (passed > 0)
    after = np.where(is_known, np.maximum(since, 0.0), np.inf)
    before = np.where(met.ahead[run], met.meet_s[run], np.inf)
    return float(np.minimum(after, before).min())


def _build_occurrence(met: PathInteraction, kind: Manoeuvre, runs: list[slice]) -> ManoeuvreOccurrence:
    return ManoeuvreOccurrence(
        kind=kind,
        first_s=min(float(met.seconds[run.start]) for run in runs),
        duration_s=sum((run.stop - run.start) * met.frame_s for run in runs),
        least_gap_m=min(_compute_least_gap(met, run, 0.0) for run in runs),
    )


def _compute_least_gap(met: PathInteraction, run: slice, after_s: float) -> float:
    """Smallest gap in a run and some time after it."""
    last = met.seconds[run.stop - 1] + after_s
    return float(met.gap[run.start : int(np.searchsorted(met.seconds, last, side="right"))].min())


def smooth_mask(mask: Bools) -> Bools:
    """(F,) condition that holds at most of the `HELD_FRAMES` around each; outside of all frames nothing holds."""
    half = HELD_FRAMES // 2
    padded = np.pad(mask.astype(np.int64), half)
    return np.asarray(np.convolve(padded, np.ones(HELD_FRAMES, np.int64), mode="valid") > half)
