"""Scenes that a planner fails, from the columns of a record."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from benchmark.errors import InputError
from benchmark.geometry import Bools
from benchmark.protocols import protocol as definition_of
from benchmark.records.row_schema import SampleRow
from benchmark.records.rows import columns_of

if TYPE_CHECKING:
    from benchmark.records.columns import RowColumns

_FAILURES: Final = "failures of scenes"


def scene_failures(rows: "Sequence[SampleRow] | RowColumns", protocol: str) -> dict[str, bool | None]:
    """Which scenes a planner fails: those with a counted sample that collides at any step.

    Returns:
        Scene name to verdict, by name; ``None`` where no verdict is possible: no counted sample whose collisions are
        known, or no contact but the planner raised on a sample that could have shown one.
    """
    definition_of(protocol)
    columns = columns_of(rows)
    if (_FAILURES, protocol) not in columns.kept:
        judged = columns.values("judged")
        unjudged = next((place for place in columns.planned.tolist() if protocol not in judged[place]), None)
        if unjudged is not None:
            raise InputError(
                f"scene {columns.values('scene')[unjudged]} was not judged by protocol {protocol!r}; run "
                "challenger-bench rescore"
            )
        columns.kept[_FAILURES, protocol] = scenes_with(columns, protocol, columns.collides(protocol))
    return dict(columns.kept[_FAILURES, protocol])


def scenes_with(columns: "RowColumns", protocol: str, hits: Bools) -> dict[str, bool | None]:
    """Which scenes have one of some colliding samples; verdicts as of `scene_failures`.

    Args:
        columns: Of R rows, all of them judged by the protocol.
        hits: (R,) the samples, of those that count and collide.
    """
    counted, unknown = columns.counted(protocol), _unknown(columns, protocol)
    return {
        scene: _fails(hits[places], counted[places], unknown[places])
        for scene, places in sorted(columns.places_of_scenes.items())
    }


def _fails(hits: Bools, counted: Bools, unknown: Bools) -> bool | None:
    if hits.any():
        return True
    return None if unknown.any() or not counted.any() else False


def _unknown(columns: "RowColumns", protocol: str) -> Bools:
    """(R,) whether the planner raised on a sample that could have shown a contact."""
    could = columns.flags("complete")
    if definition_of(protocol).counts_incomplete:
        could = could | columns.flags("recorded")
    return columns.failed & could
