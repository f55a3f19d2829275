"""A stationary, a frontal and a side scenario for any recording, in NeuroNCAP's form: what a newcomer can run offline.

All three meet the recorded ego where it was six seconds after the start, if it drives as it did. The numbers are this
project's; nothing here compares with NeuroNCAP's own scenarios.
"""

from typing import Final

import numpy as np

from benchmark.extensions.neuroncap.recording import Recording
from benchmark.extensions.neuroncap.scenarios import STEP_S, Jitter, Scenario, ScenarioActor
from benchmark.geometry import Floats

START_FRAME: Final = 4
PRIMING_STEPS: Final = 2
DURATION_S: Final = 8.0
MEETING_FRAMES: Final = 12
"""From the start to the meeting."""
LEAST_DRIVEN_M: Final = 15.0
"""An ego that comes no further than this until then meets nobody."""
_CANDIDATES: Final = 3
"""Cars of the recording of which one is drawn."""
_CROSSING_M_S: Final = 6.0
_CROSSING_S: Final = 5.0
"""Before and after the meeting."""


def own_scenarios(recording: Recording) -> dict[str, Scenario]:
    """Scenarios of a recording by family; none where it is too short, has no car, or its ego hardly moves."""
    meeting = START_FRAME + MEETING_FRAMES
    cars = tuple(actor.uuid for actor in recording.actors if actor.kind == "car")[:_CANDIDATES]
    if not cars or meeting + MEETING_FRAMES // 2 >= len(recording.times):
        return {}
    if float(np.hypot(*(recording.path[meeting] - recording.path[START_FRAME])[:2])) < LEAST_DRIVEN_M:
        return {}
    yaw = float(recording.path[meeting, 2])
    place, seconds = recording.poses[meeting, :3, 3], (recording.times - recording.times[0]) / 1e6
    stands = (np.array([0.0, float(seconds[-1])]), np.stack([place, place]))
    oncoming = _oncoming(recording, seconds, meeting)
    aside = _CROSSING_M_S * _CROSSING_S * np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    crosses = (seconds[meeting] + np.array([-_CROSSING_S, _CROSSING_S]), np.stack([place - aside, place + aside]))
    return {
        "stationary": _scenario(cars, *stands, yaw, Jitter(3.0, 1.0, yaw, 0.5)),
        "frontal": _scenario(cars, *oncoming, yaw + np.pi, Jitter(3.0, 0.75, yaw)),
        "side": _scenario(cars, *crosses, yaw + np.pi / 2, Jitter(1.0, 0.5, yaw + np.pi / 2)),
    }


def _oncoming(recording: Recording, seconds: Floats, meeting: int) -> tuple[Floats, Floats]:
    """Times and places of an actor that comes the ego's way backwards, as fast as the ego came.

    Beyond the end of the recording the way goes on straight; it begins so far ahead that it does not appear from
    nothing.
    """
    times = seconds[START_FRAME] - 1.0 + np.arange(0.0, DURATION_S + 3.0)
    asked = 2 * seconds[meeting] - times
    places = np.column_stack([np.interp(asked, seconds, column) for column in recording.poses[:, :3, 3].T])
    last = (recording.poses[-1, :3, 3] - recording.poses[-2, :3, 3]) / STEP_S
    return times, places + np.maximum(asked - seconds[-1], 0.0)[:, None] * last


def _scenario(cars: tuple[str, ...], times: Floats, positions: Floats, yaw: float, jitter: Jitter) -> Scenario:
    target = ScenarioActor(
        mode="override",
        uuids=cars,
        drawn=True,
        is_target=True,
        times=times,
        positions=positions,
        initial_yaw=yaw,
        jitter=jitter,
    )
    return Scenario(START_FRAME, PRIMING_STEPS, DURATION_S, start_jitter=1, actors=(target,))
