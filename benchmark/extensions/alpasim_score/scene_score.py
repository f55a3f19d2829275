"""AlpaSim's scene score: a drive as it logs one in, verdict and parts out, under the rules of two months.

What differs between the rules: July (NVlabs/alpasim 3032e0c) counts progress to the end of the recording and drops
drives with a black picture; September (6f1029c) counts it to where the recording is when the drive ends, and fails who
leaves the corridor sideways. In both the first contact ends a drive, but only one at the front or the side is at fault.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.alpasim_score.bodies import ContactSide, classify_contacts
from benchmark.geometry import Bools, Floats

Verdict = Literal["", "collision_at_fault", "offroad", "left_corridor_laterally"]
"""Why a drive fails, as AlpaSim has it; empty of a drive that passes."""
CORRIDOR_M: Final = 4.0
"""Beside the recorded path, from which on progress does not count, and September's rules fail a drive."""
SATURATION: Final = 0.8
"""Share of the way that gives a full score."""
SHORT_WAY_M: Final = 5.0
"""A shorter recording gives a full score for any progress."""
FEWEST_TIMES: Final = 3
_AT_END_M: Final = 1e-9


@dataclass(frozen=True, slots=True)
class RuleSet:
    """Rules of one month, by the name of their column.

    Attributes:
        whole_way: Whether progress is counted to the end of the recording.
        corridor_fails: Whether leaving the corridor sideways fails a drive.
        drops_black: Whether a drive with a black picture is no drive.
    """

    name: str
    whole_way: bool
    corridor_fails: bool
    drops_black: bool


JULY: Final = RuleSet("alpasim@2026-07", whole_way=True, corridor_fails=False, drops_black=True)
SEPTEMBER: Final = RuleSet("alpasim@2026-09", whole_way=False, corridor_fails=True, drops_black=False)
RULE_SETS: Final = (JULY, SEPTEMBER)


@dataclass(frozen=True, slots=True)
class LoggedDrive:
    """A drive at T logged times among N others, beside a recording of R poses; metres, local frame.

    Attributes:
        times_us: (T,) rising.
        ego: (T, 5) boxes x, y, length, width, yaw.
        others: (N, T, 5) boxes.
        present: (N, T) who is there.
        recorded_us: (R,) of the whole recording.
        recorded: (R, 2) centres of the recorded ego's box.
        scored_from_us: Times before do not count, unless all are.
        ends_us: When it would end by itself, up to which September's rules count the way.
        cut: Whether something that the boxes do not show ended it at the last time: the touch of what is nearest.
    """

    times_us: NDArray[np.int64]
    ego: Floats
    others: Floats
    present: Bools
    recorded_us: NDArray[np.int64]
    recorded: Floats
    scored_from_us: int
    ends_us: int
    cut: bool = False


@dataclass(frozen=True, slots=True)
class DriveMeasures:
    """What both rule sets judge, (T,) each.

    Attributes:
        relevant: Times that count.
        sides: `ContactSide` of the contact that counts.
        way: Progress along the recorded path up to its end, 0 to 1.
        reachable_way: The same up to where the recording is at the drive's own end; may exceed 1.
        from_path_m: Distance from the recorded path.
        beside_path_m: The same, but across the last piece of the path where the drive is past its end.
        driven_m: Own way so far.
        way_m: Length of the recorded path.
    """

    relevant: Bools
    sides: NDArray[np.int64]
    way: Floats
    reachable_way: Floats
    from_path_m: Floats
    beside_path_m: Floats
    driven_m: Floats
    way_m: float


@dataclass(frozen=True, slots=True)
class SceneScore:
    """Score of a drive and its parts.

    ``off_road`` is ``None`` where no map says it: then only collisions and the corridor count. ``front``, ``rear`` and
    ``lateral`` are whether such a contact came before the end, ``corridor`` whether the corridor was left sideways.

    Attributes:
        score: 0 to 1.
        verdict: Why it fails.
        progress: Share of the way, at the last time that counts.
        progress_score: What that gives without a failure.
        from_path_m: Largest distance from the recorded path.
        beside_path_m: Largest distance across it.
        driven_m: Way up to the first incident.
    """

    score: float
    verdict: Verdict
    progress: float
    progress_score: float
    front: bool
    rear: bool
    lateral: bool
    off_road: bool | None
    corridor: bool
    from_path_m: float
    beside_path_m: float
    driven_m: float

    @property
    def at_fault(self) -> bool:
        """Whether there is a contact at the front or the side, AlpaSim's rule of fault."""
        return self.front or self.lateral

    @property
    def incident(self) -> bool:
        """Whether there is any contact, or the road is left."""
        return self.at_fault or self.rear or bool(self.off_road)

    @property
    def incident_at_fault(self) -> bool:
        """The same without contacts from behind."""
        return self.at_fault or bool(self.off_road)


def measure_drive(log: LoggedDrive) -> DriveMeasures | None:
    """Contacts, and the drive beside its recording; ``None`` of one that AlpaSim has no score of.

    That is a drive of fewer than three times, with times outside the recording, or with values that are not finite.
    """
    times, recorded_us = log.times_us, log.recorded_us
    if len(times) < FEWEST_TIMES or not len(recorded_us) or times[0] < recorded_us[0] or times[-1] > recorded_us[-1]:
        return None
    known = np.where(log.present[..., None], log.others, 0.0)
    if not all(np.isfinite(values).all() for values in (log.ego, known, log.recorded)):
        return None
    center, path = log.ego[:, :2], _Path.of(log.recorded)
    station, away = path.project(center)
    end = np.array([[np.interp(log.ends_us, recorded_us, log.recorded[:, axis]) for axis in range(2)]])
    reached = float(path.project(end)[0][0])
    way = _begin_by_hand(station / path.length if path.length else np.zeros(len(times)))
    relevant = times >= log.scored_from_us
    step = np.hypot(*np.diff(center, axis=0).T)
    return DriveMeasures(
        relevant=relevant if relevant.any() else np.ones(len(times), np.bool_),
        sides=classify_contacts(log.ego, log.others, log.present, cut=log.cut),
        way=way,
        reachable_way=way * path.length / reached if reached else way,
        from_path_m=_begin_with_zeros(away),
        beside_path_m=_begin_with_zeros(path.measure_beside(center, station, away)),
        driven_m=_begin_with_zeros(np.concatenate([[0.0], np.cumsum(step)])),
        way_m=path.length,
    )


def score_drive(
    measures: DriveMeasures, rules: RuleSet, off_road: Bools | None = None, black: Bools | None = None
) -> SceneScore | None:
    """Score of a drive under the rules; ``None`` where they drop it.

    Args:
        measures: Of the drive.
        rules: Rule set.
        off_road: (T,) whether the ego is off the road; ``None`` without a map.
        black: (T,) whether the front camera's picture is black.
    """
    kept = np.flatnonzero(measures.relevant)
    if rules.drops_black and black is not None and black[kept].any():
        return None
    off = np.zeros(len(measures.sides), np.bool_) if off_road is None else off_road
    kept = _through_first(kept, (measures.sides > ContactSide.NONE) | off)
    kept = _through_first(kept, measures.from_path_m >= CORRIDOR_M)
    sides = set(measures.sides[kept].tolist())
    way = measures.way if rules.whole_way else measures.reachable_way
    progress = float(way[kept[-1]])
    progress_score = 1.0 if measures.way_m < SHORT_WAY_M else min(float(np.clip(progress, 0.0, 1.0)) / SATURATION, 1.0)
    corridor = bool((measures.beside_path_m[kept] >= CORRIDOR_M).any())
    verdict: Verdict = ""
    if sides & {ContactSide.FRONT, ContactSide.LATERAL}:
        verdict = "collision_at_fault"
    elif off[kept].any():
        verdict = "offroad"
    elif rules.corridor_fails and corridor:
        verdict = "left_corridor_laterally"
    return SceneScore(
        score=0.0 if verdict else progress_score,
        verdict=verdict,
        progress=progress,
        progress_score=progress_score,
        front=ContactSide.FRONT in sides,
        rear=ContactSide.REAR in sides,
        lateral=ContactSide.LATERAL in sides,
        off_road=None if off_road is None else bool(off[kept].any()),
        corridor=corridor,
        from_path_m=float(measures.from_path_m[kept].max()),
        beside_path_m=float(measures.beside_path_m[kept].max()),
        driven_m=float(measures.driven_m[kept[-1]]),
    )


def _through_first(kept: NDArray[np.int64], stops: Bools) -> NDArray[np.int64]:
    """Kept times up to the first that stops, which stays."""
    stopping = np.flatnonzero(stops[kept])
    return kept[: stopping[0] + 1] if len(stopping) else kept


def _begin_by_hand(way: Floats) -> Floats:
    """AlpaSim's values of the first two times: nothing, and half of the third."""
    return np.concatenate([[0.0, 0.5 * way[2]], way[2:]])


def _begin_with_zeros(values: Floats) -> Floats:
    return np.concatenate([np.zeros(2), values[2:]])


@dataclass(frozen=True, slots=True)
class _Path:
    """Recorded path of (R, 2) points; pieces without length are left out."""

    points: Floats
    start: Floats
    step: Floats
    begins: Floats
    length: float

    @classmethod
    def of(cls, points: Floats) -> "_Path":
        step = np.diff(points, axis=0)
        lengths = np.hypot(*step.T)
        ends = np.cumsum(lengths)
        moved = lengths > 0.0
        begins = (ends - lengths)[moved]
        return cls(points, points[:-1][moved], step[moved], begins, float(ends[-1]) if len(ends) else 0.0)

    def project(self, places: Floats) -> tuple[Floats, Floats]:
        """(T,) arc length of the nearest point, the first of equals, and the distance to it, of (T, 2) places."""
        if not len(self.step):
            return np.zeros(len(places)), np.hypot(*(places - self.points[0]).T)
        length = np.hypot(*self.step.T)
        offset = places[:, None] - self.start
        share = np.clip((offset * self.step).sum(axis=-1) / length**2, 0.0, 1.0)
        away = np.hypot(*(offset - share[..., None] * self.step).transpose(2, 0, 1))
        nearest = away.argmin(axis=1)
        rows = np.arange(len(places))
        return self.begins[nearest] + share[rows, nearest] * length[nearest], away[rows, nearest]

    def measure_beside(self, places: Floats, station: Floats, away: Floats) -> Floats:
        """(T,) distances, of places past the end those across the line of the last piece, if it has a length."""
        last = self.points[-1] - self.points[-2] if len(self.points) > 1 else np.zeros(2)
        size = float(np.hypot(*last))
        if not size or not self.length:
            return away
        offset = places - self.points[-1]
        across = np.abs(offset[:, 0] * last[1] - offset[:, 1] * last[0]) / size
        return np.where(station >= self.length - _AT_END_M, across, away)
