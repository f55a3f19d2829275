"""The definition ``nuscenes-pdm``: its name, its version, what it is not, and its numbers.

The sub-scores are those of NAVSIM v2 (`docs/pdm.md` has the whole definition and the official code's quirks that it
keeps). It is not NAVSIM's score: see ``NOTE``, which stands under every table.
"""

from typing import Final

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M, EGO_WIDTH_M

PDM: Final = "pdm"
"""Its name in ``--protocol``."""
DEFINITION: Final = "nuscenes-pdm"
VERSION: Final = 2
NOTE: Final = (
    "nuscenes-pdm: sub-scores of NAVSIM's PDM family on plans for nuScenes; 3 s instead of 4, no traffic lights, the "
    "ego of nuScenes, the route is the recorded path and the reference of EP the recorded future: its numbers "
    "are not comparable to numbers published for NAVSIM"
)

DT_S: Final = 0.1
STATES: Final = 31
"""Of a motion: now and 3 s in steps of 0.1 s."""
STATES_PER_WAYPOINT: Final = 5
HISTORY_ROWS: Final = 14
"""Of the past, in front of the states when comfort is judged: -1.5 to -0.2 s (-0.1 s is missing, as officially)."""

LENGTH_M: Final = EGO_LENGTH_M
WIDTH_M: Final = EGO_WIDTH_M
CENTER_AHEAD_M: Final = EGO_CENTER_FROM_REAR_AXLE_M
WHEELBASE_M: Final = 3.089
"""Of nuPlan's car: used by the tracker of the official code for every vehicle, and by our bicycle model."""
COMFORT_CENTER_AHEAD_M: Final = 1.461
"""Centre of nuPlan's car ahead of its rear axle: where the official code measures comfort for every vehicle."""

(
    X,
    Y,
    HEADING,
    SPEED,
    SIDE_SPEED,
    ACCELERATION,
    SIDE_ACCELERATION,
    STEERING,
    STEERING_RATE,
    YAW_RATE,
    YAW_ACCELERATION,
) = range(11)
"""Columns of a state: rear axle, global; velocity and acceleration along and across the body; angles in radians."""
STATE_COLUMNS: Final = 11
