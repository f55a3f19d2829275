"""Which record an adversarial run is compared with, noted in the run's own record."""

from pathlib import Path

from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.unchanged import unchanged_candidates, unchanged_record
from benchmark.records.run import RunRecord, with_facts
from benchmark.records.run_schema import UnchangedFacts
from benchmark.records.store import ROWS_FILE


def with_partner(record: RunRecord, out: Path, elsewhere: str | None = None) -> RunRecord:
    """Note the record of the same planner on the unchanged recordings, if there is one.

    Args:
        record: A record; nobody else may write to its directory (`benchmark.machine.storage.only_writer`).
        out: Folder of run directories.
        elsewhere: Name of the data set that has the unchanged recordings, if it is another one.

    Returns:
        The record, which names its partner; of recordings and without a partner as it is.

    Raises:
        InputError: If it cannot be written.
    """
    if not has_adversaries(record):
        return record
    found = unchanged_record(record, unchanged_candidates(out, [record], elsewhere), elsewhere)
    if found is None:
        return record
    partner = UnchangedFacts(data=found.run.data, split=found.run.split, samples=found.run.files[ROWS_FILE])
    return with_facts(record, unchanged=partner)
