"""Interface of a protocol: boxes and plans in, verdicts per sample and step out, and their averages up to a horizon."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import HORIZON_STEPS, PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols.stacked_truths import StackedTruths
from benchmark.truth import SampleTruth


@dataclass(frozen=True, slots=True)
class ProtocolOutcomes:
    """The verdicts of one protocol on S samples.

    Attributes:
        collision: (S, 6) what the protocol calls a collision at each step, after its own exclusions.
        l2: (S, 6) displacement from the recorded ego, metres; 0 where ``valid`` is False.
        valid: (S, 6) whether the recorded ego exists at the step.
        counted: (S,) whether the protocol lets the sample into its denominators.
        steps: Further columns of the protocol, each (S, 6), for example the verdicts before an exclusion.
        facts: Further values of the protocol, one JSON value for each sample.
        known: (S,) whether the data say whom a plan could touch; where not, ``collision`` is no verdict. ``None``: of
            every sample.
    """

    collision: Bools
    l2: Floats
    valid: Bools
    counted: Bools
    steps: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    facts: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    known: Bools | None = None

    def __len__(self) -> int:
        return len(self.counted)

    @property
    def decided(self) -> Bools:
        """(S,) whether a sample counts and its collisions are known: what collision rates are made of."""
        return self.counted if self.known is None else self.counted & self.known

    def step(self, name: str) -> NDArray[Any]:
        """A further column, (S, 6); of no samples there is every column."""
        return self.steps[name] if len(self) else np.zeros((0, PLAN_STEPS), dtype=np.bool_)

    def as_rows(self) -> list[dict[str, Any]]:
        """One JSON object for each sample; null are a displacement that does not exist and unknown collisions."""
        collision, l2, valid = self.collision.tolist(), self.l2.tolist(), self.valid.tolist()
        for index in () if self.known is None else np.flatnonzero(~self.known).tolist():
            collision[index] = None
        counted, steps = self.counted.tolist(), {name: column.tolist() for name, column in self.steps.items()}
        return [
            {
                "collision": collision[index],
                "l2": [metres if there else None for metres, there in zip(l2[index], valid[index])],
                "counted": counted[index],
                "steps": {name: column[index] for name, column in steps.items()},
                "facts": {name: column[index] for name, column in self.facts.items()},
            }
            for index in range(len(self))
        ]

    @classmethod
    def from_rows(cls, rows: Sequence[Mapping[str, Any]]) -> "ProtocolOutcomes":
        """The inverse of `as_rows`."""
        shape = (len(rows), PLAN_STEPS)
        # Null becomes NaN, which marks a missing displacement.
        l2 = np.array([row["l2"] for row in rows], dtype=np.float64).reshape(shape)
        valid = ~np.isnan(l2)
        first = rows[0] if rows else {"steps": {}, "facts": {}}
        known = np.array([row["collision"] is not None for row in rows], np.bool_)
        collision = [row["collision"] or [False] * PLAN_STEPS for row in rows]
        return cls(
            collision=np.array(collision, dtype=np.bool_).reshape(shape),
            l2=np.where(valid, l2, 0.0),
            valid=valid,
            counted=np.array([row["counted"] for row in rows], dtype=np.bool_),
            steps={name: np.array([row["steps"][name] for row in rows]) for name in first["steps"]},
            facts={name: tuple(row["facts"][name] for row in rows) for name in first["facts"]},
            known=None if known.all() else known,
        )


class CollisionProtocol(Protocol):
    """A named, versioned definition of collision and L2.

    A new one is one module with one instance of a class like this, registered in ``benchmark/protocols/__init__.py``.
    It sees boxes and plans only; a protocol that draws a raster draws it itself.

    Attributes:
        name: Column name; two protocols never share one.
        version: Raised whenever a verdict or an average may change.
        counts_incomplete: Whether samples count whose recording ends before 3 s.
        uses_categories: Whether it depends on an object's category whether it can be hit.

    One that judges by `SampleTruth.by_clock` says so by an attribute ``goes_by_clock = True``. Step k of all others is
    the k-th following key frame, whenever that is: where key frames are not half a second apart, the horizons are other
    times, and in scenes at another rate they count nothing (`benchmark.datasets.steps`).
    """

    @property
    def name(self) -> str:
        """Column name."""

    @property
    def version(self) -> int:
        """Raised whenever a verdict or an average may change."""

    @property
    def counts_incomplete(self) -> bool:
        """Whether samples count whose recording ends before 3 s."""

    @property
    def uses_categories(self) -> bool:
        """Whether it depends on an object's category whether it can be hit."""

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Which objects can be hit at which step; what tells a missed object from a missed contact.

        Args:
            truths: S samples with M objects.

        Returns:
            (M, 6) verdicts.
        """

    def headings(self, plans_lidar: Floats) -> Floats:
        """How the protocol turns the ego at each waypoint.

        Args:
            plans_lidar: (S, 6, 2) waypoints, metres.

        Returns:
            (S, 6) radians.
        """

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Judge plans against what really happened.

        The verdict on a sample must not depend on the other samples.

        Args:
            truths: S samples.
            plans_lidar: (S, 6, 2) waypoints of the lidar origin, x right, y forward, metres.

        Returns:
            The verdicts.
        """

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """How much each sample adds to each published number.

        The rate at a horizon is the sum of these values over the counted samples divided by their number, so
        that "value at the step", "mean up to the step" and "any contact up to the step" are all one form.

        Args:
            outcomes: S verdicts of this protocol.

        Returns:
            Columns by name, each (S, 3) at 1, 2 and 3 s; ``collision`` (0..1) and ``l2`` (metres) always. NaN: the
            sample says nothing about the column at that horizon, and is not in its denominator.
        """


def counts_at_all_horizons(definition: CollisionProtocol, outcomes: ProtocolOutcomes) -> Bools:
    """(S,) which samples count at all three horizons.

    False where a sample counts but a gap in the recording leaves some of its steps unknown, or the data do not say whom
    a plan could touch.
    """
    return np.logical_and(outcomes.decided, outcomes.valid.all(axis=-1) | definition.counts_incomplete)


def compute_published_values(definition: CollisionProtocol, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
    """(S, 3) columns of `CollisionProtocol.sample_values`, those of contacts NaN where ``outcomes.known`` is False."""
    columns = definition.sample_values(outcomes)
    if outcomes.known is None:
        return columns
    unknown = ~outcomes.known[:, None]
    return {
        name: np.where(unknown, np.nan, values) if name.startswith(_OF_CONTACTS) else values
        for name, values in columns.items()
    }


COLUMN_MEANINGS: Final[Mapping[str, str]] = {
    "collision": "Collision rate, 0 to 1, after the protocol's exclusions.",
    "collision_before_mask": "The same without excluding steps at which the recorded ego collides.",
    "collision_mean": "Mean of the collision flags over the steps up to the horizon.",
    "obj_col": "Collision flags of the single cell below the waypoint, instead of the whole ego.",
    "l2": "Displacement from the recorded ego, metres.",
    "l2_mean": "Mean displacement over the steps up to the horizon, metres.",
    "ade": "Mean displacement over the steps up to the horizon, metres.",
    "kerb": "Contact with the edge of the road, after the mask.",
    "kerb_before_mask": "The same regardless of the recorded ego.",
    "kerb_point": "Contact of the point below the waypoint with the edge of the road, mean over the steps.",
    "off_road": "Any step with a cell that is not drivable.",
}
"""What each column of `CollisionProtocol.sample_values` of our protocols is; horizons average as the protocol does."""
_OF_CONTACTS: Final = ("collision", "obj_col")
"""How the names of columns begin that need to know who is around."""


@runtime_checkable
class GroundTruthMask(CollisionProtocol, Protocol):
    """A protocol that takes back collisions at steps at which the recorded ego collides by the same rule.

    Its verdicts have the columns ``before_mask``, ``recorded`` (what the mask goes by) and ``recorded_adversary`` (the
    same for adversaries alone).
    """

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """At which steps that were recorded the recorded ego collides with some objects.

        Args:
            truths: S samples with M objects.
            among: (M,) which objects are asked about.

        Returns:
            (S, 6) verdicts.
        """


def select_horizons(values: NDArray[Any]) -> Floats:
    """(S, 6) values at the steps: those at 1, 2 and 3 s themselves, (S, 3)."""
    return np.asarray(values[:, [count - 1 for count in HORIZON_STEPS.values()]], np.float64)


def average_up_to(values: NDArray[Any]) -> Floats:
    """Mean over the steps up to each horizon; arguments as in `select_horizons`."""
    means = [values[:, :count].mean(axis=1) for count in HORIZON_STEPS.values()]
    return np.asarray(np.stack(means, axis=1), np.float64)


def any_up_to(verdicts: Bools) -> Floats:
    """1 if any step up to the horizon is positive, else 0; arguments as in `select_horizons`."""
    any_so_far = [verdicts[:, :count].any(axis=1) for count in HORIZON_STEPS.values()]
    return np.asarray(np.stack(any_so_far, axis=1), np.float64)


def average_masked_columns(outcomes: ProtocolOutcomes, average: Callable[[NDArray[Any]], Floats]) -> dict[str, Floats]:
    """(S, 3) ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``, all averaged in the same way.

    Verdicts need the steps ``before_mask`` and ``obj_col``. ``average`` makes (S, 3) at 1, 2 and 3 s of (S, 6) values
    at the steps.
    """
    return {
        "collision": average(outcomes.collision),
        "collision_before_mask": average(outcomes.step("before_mask")),
        "obj_col": average(outcomes.step("obj_col")),
        "l2": average(outcomes.l2),
    }
