"""Names and times of generated scenes in the tables: what the devkit's readers need where recordings have variants.

The devkit lists scenes by their first time and fails on equal ones; its readers of CAN bus and maps, and NeuroNCAP,
take only names of four digits.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from benchmark.datasets.split_names import compute_shifts_us

_NUMBERS: Final = range(2001, 10_000)
"""Beyond nuScenes' scenes, and so beyond those of which the devkit hides the CAN bus or the route."""


@dataclass(frozen=True, slots=True)
class SceneNumber:
    """Name of a scene in the tables, and by how much its times are later than its recording's, microseconds."""

    name: str
    shift_us: int


def number_scenes(times: Mapping[str, tuple[int, int]], taken: Collection[str] = ()) -> dict[str, SceneNumber]:
    """Number the scenes of a root, sorted by name, whatever the order in which they are written.

    Args:
        times: First and last time of each scene in its recording, microseconds, by name.
        taken: Names that are not given, such as those of the recordings.

    Returns:
        Numbers by name; the shifts are `compute_shifts_us`. None where there are more scenes than numbers.
    """
    shifts = compute_shifts_us([(name, first, last) for name, (first, last) in times.items()])
    free = [name for name in (f"scene-{number}" for number in _NUMBERS) if name not in taken]
    if len(times) > len(free):
        return {}
    return {name: SceneNumber(row, shifts.get(name, 0)) for name, row in zip(sorted(times), free)}
