"""What tables read of a record's rows, as columns: read once, a tenth of the rows' memory."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols import Outcomes
from benchmark.records.row_schema import DiagnosisRow, LongerRow, PlaceName, PlanSeverityRow, SampleRow
from benchmark.waypoints import waypoints_in_lidar

_NONE: Final[Mapping[str, str]] = {}
_NOT_SEVERE: Final = PlanSeverityRow()


@dataclass(frozen=True, slots=True)
class BriefRow:
    """A `SampleRow` less plan, recorded motion and verdicts; ``judged`` are the protocols that have one.

    Attributes:
        recorded: Whether the recording goes on for a step at least.
        driven: Whether there are driving scores.
    """

    scene: str
    sample_token: str
    index: int
    timestamp_us: int
    status: Literal["ok", "failed"]
    command: int
    complete: bool
    recorded: bool
    place: PlaceName | None
    speed_m_s: float | None
    judged: frozenset[str]
    diagnosis: DiagnosisRow | None
    disagreements: Mapping[str, str]
    driven: bool
    longer: LongerRow | None
    severity: PlanSeverityRow | None


class RowColumns:
    """Columns of a record.

    Args:
        rows: One for each sample; they are asked again only for verdicts that do not go together in columns.
        parsed: The same rows, where they are at hand.

    Attributes:
        brief: What is light of each row.
        planned: Places of the rows with a plan.
        failures: Kept by `benchmark.records.run.scene_failures`, by protocol.
        kept: What others made of the columns, under a key of theirs that says all that it depends on.
        in_lidar: (S, 6, 2) planned waypoints of the lidar origin of the S rows in `planned`, metres.
        moved: (S, 3) x, y, yaw of the recorded lidar origin half a second later; NaN past the end.
    """

    def __init__(self, rows: Sequence[SampleRow], parsed: Sequence[SampleRow] | None = None) -> None:
        whole = list(rows) if parsed is None else parsed
        self._rows = rows
        self._outcomes: dict[str, Outcomes] = {}
        self.failures: dict[str, dict[str, bool | None]] = {}
        self.kept: dict[Any, Any] = {}
        shared: dict[Any, Any] = {}
        self.brief: tuple[BriefRow, ...] = tuple(_brief(row, shared) for row in whole)
        planned = [row for row in whole if row.status == "ok"]
        self.planned: tuple[int, ...] = tuple(place for place, row in enumerate(whole) if row.status == "ok")
        self.in_lidar, self.moved = _plans(planned)
        driven = [row.driving for row in whole if row.driving is not None]
        self._driving: tuple[Floats, Bools] | None = _driving_scores(driven) if driven else None
        arrays: dict[tuple[Any, ...], NDArray[Any]] = {}
        for name in sorted({name for row in planned for name in row.outcomes}):
            if all(name in row.outcomes for row in planned):
                try:
                    found = Outcomes.from_rows([vars(row.outcomes[name]) for row in planned])
                except (KeyError, ValueError):
                    # Whoever asks for them gets the error that they deserve.
                    continue
                self._outcomes[name] = _sharing(found, arrays)

    def outcomes(self, protocol: str) -> Outcomes:
        """Verdicts of a protocol on the samples that have a plan, in their order; nobody may write to the arrays.

        Args:
            protocol: Its name.

        Returns:
            The verdicts.

        Raises:
            KeyError: If it did not judge a sample.
        """
        if protocol in self._outcomes:
            return self._outcomes[protocol]
        return Outcomes.from_rows([vars(row.outcomes[protocol]) for row in self._rows if row.status == "ok"])

    def collides(self, protocol: str) -> Bools:
        """(R,) whether a row counts under a protocol and its plan collides; rows without a plan do not."""
        found = np.zeros(len(self.brief), np.bool_)
        outcomes = self.outcomes(protocol)
        found[list(self.planned)] = outcomes.counted & outcomes.collision.any(axis=1)
        return found

    def counted(self, protocol: str) -> Bools:
        """(R,) whether a row counts under a protocol."""
        found = np.zeros(len(self.brief), np.bool_)
        found[list(self.planned)] = self.outcomes(protocol).counted
        return found

    @property
    def driving(self) -> tuple[Floats, Bools] | None:
        """`benchmark.records.driving.sample_scores` of the rows that have driving scores, if any has."""
        return self._driving

    @cached_property
    def planned_tokens(self) -> tuple[str, ...]:
        """Tokens of the samples with a plan."""
        return tuple(self.brief[place].sample_token for place in self.planned)

    @cached_property
    def planned_scenes(self) -> tuple[str, ...]:
        """Scenes of the samples with a plan."""
        return tuple(self.brief[place].scene for place in self.planned)

    @cached_property
    def failed_tokens(self) -> frozenset[str]:
        """Tokens of the samples without a plan."""
        return frozenset(row.sample_token for row in self.brief if row.status == "failed")

    @cached_property
    def places_of_scenes(self) -> dict[str, list[int]]:
        """Places of each scene's rows, in the order in which scenes appear."""
        found: dict[str, list[int]] = {}
        for place, row in enumerate(self.brief):
            found.setdefault(row.scene, []).append(place)
        return found


def _plans(rows: Sequence[SampleRow]) -> tuple[Floats, Floats]:
    """Waypoints in the lidar frame and the first step of the recording, of rows with a plan."""
    in_lidar, moved = np.full((len(rows), PLAN_STEPS, 2), np.nan), np.full((len(rows), 3), np.nan)
    plans = [(place, row.lidar_ahead_m, row.plan) for place, row in enumerate(rows) if row.plan is not None]
    for frame, ahead in sorted({(plan.frame, ahead) for _, ahead, plan in plans}):
        those = [
            (place, plan.waypoints[:PLAN_STEPS]) for place, own, plan in plans if (plan.frame, own) == (frame, ahead)
        ]
        # Plans that are no plans are found by whoever judges them.
        those = [each for each in those if len(each[1]) == PLAN_STEPS and all(len(point) == 2 for point in each[1])]
        if those:
            places, waypoints = zip(*those)
            in_lidar[list(places)] = waypoints_in_lidar(np.array(waypoints, np.float64), frame, ahead)
    for place, row in enumerate(rows):
        if row.recorded_future and (pose := row.recorded_future[0]):
            moved[place] = pose
    return in_lidar, moved


def _driving_scores(rows: Sequence[Any]) -> tuple[Floats, Bools]:
    from benchmark.records.driving import sample_scores

    return sample_scores(rows)


def _brief(row: SampleRow, shared: dict[Any, Any]) -> BriefRow:
    def one(value: Any) -> Any:
        """The same object for the same value."""
        return shared.setdefault(value, value)

    severity = row.severity
    if severity is not None and severity.contact is None and severity.near is None:
        severity = _NOT_SEVERE
    return BriefRow(
        scene=one(row.scene),
        # All planners of a split have the same ones.
        sample_token=sys.intern(row.sample_token),
        index=row.index,
        timestamp_us=row.timestamp_us,
        status=row.status,
        command=row.command,
        complete=row.complete,
        recorded=any(row.recorded_future),
        place=one(row.place),
        speed_m_s=row.speed_m_s,
        judged=one(frozenset(row.outcomes)),
        diagnosis=row.diagnosis,
        disagreements=row.disagreements or _NONE,
        driven=row.driving is not None,
        longer=row.longer,
        severity=severity,
    )


def _sharing(outcomes: Outcomes, arrays: dict[tuple[Any, ...], NDArray[Any]]) -> Outcomes:
    """The same verdicts; equal columns of several protocols, displacements above all, are one array."""

    def one(values: NDArray[Any]) -> NDArray[Any]:
        if values.dtype == np.object_:
            return values
        key = (values.shape, values.dtype.str, values.tobytes())
        values.flags.writeable = False
        return arrays.setdefault(key, values)

    return Outcomes(
        collision=one(outcomes.collision),
        l2=one(outcomes.l2),
        valid=one(outcomes.valid),
        counted=one(outcomes.counted),
        steps={name: one(values) for name, values in outcomes.steps.items()},
        facts=outcomes.facts,
    )
