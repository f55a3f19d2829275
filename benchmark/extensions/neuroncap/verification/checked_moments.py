"""What the engine looks at when it checks a state for contact, moment by moment, as golden sets have it."""

from typing import Final

from benchmark.extensions.neuroncap.contact import EgoMoment, touched
from benchmark.extensions.neuroncap.future import future_moments
from benchmark.extensions.neuroncap.loop import Engine, Waiting, moments
from benchmark.extensions.neuroncap.poses import heading_of

CHECK_COLUMNS: Final = 7
"""Number of the state, microseconds since the recording began, x, y, heading, speed, whether anybody is touched."""
CheckRow = tuple[float, ...]


def checks_of(engine: Engine, waiting: Waiting | None, number: int) -> list[CheckRow]:
    """Checks of one state.

    Returns:
        A row of `CHECK_COLUMNS` for each moment that is looked at: up to the first contact, then those of the plan
        where futures are checked.
    """
    if waiting is None:
        return []
    rows = []
    for moment in moments(waiting.before, waiting.state, engine.switches):
        rows.append(_row(engine, moment, number))
        if rows[-1][-1]:
            break
    if engine.check_futures and waiting.plan is not None:
        ahead = future_moments(waiting.state.time_us, waiting.state.pose, waiting.plan, engine.switches)
        rows += [_row(engine, moment, number) for moment in ahead]
    return rows


def _row(engine: Engine, moment: EgoMoment, number: int) -> CheckRow:
    hit = touched(moment, engine.actors, engine.car, engine.switches) is not None
    since = moment.time_us - int(engine.recording.times[0])
    return (number, since, *moment.pose[:2, 3].tolist(), heading_of(moment.pose), moment.speed, hit)
