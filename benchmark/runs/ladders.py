"""Reference drivers in the encounters of a record of drives: driven once for all planners, and kept beside them.

An encounter is one scene, one run and one adversary; who plans against it does not matter to the ladder.
"""

from typing import TYPE_CHECKING, Final

from benchmark.closed_loop.default_engine import DefaultRides
from benchmark.closed_loop.ladder import LadderOutcome, climbed
from benchmark.errors import InputError
from benchmark.interactions.reaction import Driver
from benchmark.machine.storage import content_key
from benchmark.records.drive_schema import LadderRow
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.drive_jobs import Job, Unit
from benchmark.runs.units import ResultStore
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FOLDER: Final = "ladder"
"""Beside the records of one world."""
DECIMALS: Final = 6
_LOOP: Final = "benchmark.closed_loop.ladder:climbed"


def ladder_rows(data: "DataSet", job: Job, unit: Unit) -> dict[str, LadderRow]:
    """Rows of reference drivers in an encounter, by name."""
    store: ResultStore[dict[str, LadderRow]] = ResultStore(job.directory.parent / FOLDER, dict[str, LadderRow])
    measured = job.measured.model_dump(mode="json", exclude={"sensor", "sensor_facts"})
    code = code_sha256(type(job.maker), made_by=_LOOP)
    key = content_key("ladder", job.fingerprint, unit.scene, unit.run, measured, list(job.ladder), code)
    kept = None if job.fresh else store.get(key, unit.name)
    if kept is None:
        if not isinstance(job.maker, DefaultRides):
            raise InputError(f"reference drivers drive in the default engine alone, not in {job.measured.engine}")
        scene = data.scene(unit.scene)
        found = climbed(scene, job.maker.course(scene, unit.run), [Driver(name) for name in job.ladder])
        kept = {each.driver.value: _row(scene, each) for each in found}
        store.put(key, kept, unit.name)
    return kept


def _row(scene: Scene, outcome: LadderOutcome) -> LadderRow:
    seconds = None if outcome.seconds is None else round(outcome.seconds, DECIMALS)
    agent = None if outcome.agent is None else scene.agents.ids[outcome.agent]
    return LadderRow(
        survives=outcome.survives, seconds=seconds, agent=agent, kind=outcome.kind, at_fault=outcome.at_fault
    )
