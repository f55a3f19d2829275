"""Reference drivers in the encounters of a record of drives: driven once for all planners, and kept beside them.

An encounter is one scene, one run and one adversary; who plans against it does not matter to the ladder.
"""

from typing import TYPE_CHECKING, Final

from benchmark.closed_loop.default_engine import DefaultRides
from benchmark.closed_loop.ladder import climbed
from benchmark.errors import InputError
from benchmark.interactions.reaction import Driver
from benchmark.machine.storage import content_key
from benchmark.records.drive_schema import LadderOutcome
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.drive_jobs import Job, Unit
from benchmark.runs.units import ResultStore

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FOLDER: Final = "ladder"
"""Beside the records of one world."""
_LOOP: Final = "benchmark.closed_loop.ladder:climbed"


def ladder_rows(data: "DataSet", job: Job, unit: Unit) -> dict[str, LadderOutcome]:
    """Rows of reference drivers in an encounter, by name."""
    store: ResultStore[dict[str, LadderOutcome]] = ResultStore(job.directory.parent / FOLDER, dict[str, LadderOutcome])
    measured = job.measured.model_dump(mode="json", exclude={"sensor", "sensor_facts"})
    code = code_sha256(type(job.maker), made_by=_LOOP)
    key = content_key("ladder", job.fingerprint, unit.scene, unit.run, measured, list(job.ladder), code)
    kept = None if job.fresh else store.get(key, unit.name)
    if kept is None:
        if not isinstance(job.maker, DefaultRides):
            raise InputError(f"reference drivers drive in the default engine alone, not in {job.measured.engine}")
        scene = data.scene(unit.scene)
        found = climbed(scene, job.maker.course(scene, unit.run), [Driver(name) for name in job.ladder])
        kept = {driver.value: outcome for driver, outcome in found.items()}
        store.put(key, kept, unit.name)
    return kept
