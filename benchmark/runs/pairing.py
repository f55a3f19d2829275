"""Which record an adversarial run is compared with, noted in the run's own record."""

from pathlib import Path

from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.unchanged_records import find_unchanged_candidates, find_unchanged_record
from benchmark.records.run import RunRecord, with_facts
from benchmark.records.run_schema import UnchangedFacts
from benchmark.records.store import ROWS_FILE


def name_partner(record: RunRecord, out: Path, elsewhere: str | None = None) -> RunRecord:
    """Name in a record its partner: the record of the same planner on the unchanged recordings, if there is one.

    Records of recordings stay as they are. ``elsewhere`` names the data set that has the unchanged recordings, if it is
    another one. The caller must be the only writer of the directory (`benchmark.machine.storage.lock_folder`).
    """
    if not has_adversaries(record):
        return record
    unchanged = find_unchanged_record(record, find_unchanged_candidates(out, [record], elsewhere), elsewhere)
    if unchanged is None:
        return record
    partner = UnchangedFacts(data=unchanged.run.data, split=unchanged.run.split, samples=unchanged.run.files[ROWS_FILE])
    return with_facts(record, unchanged=partner)
