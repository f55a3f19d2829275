"""``eval --results`` and ``eval --dump-results``: result files of planners' repositories, read and written."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from benchmark import api
from benchmark.errors import InputError

if TYPE_CHECKING:
    from adapters.result_files.planner import ResultFileFactory
    from adapters.result_files.recognition import Recognised
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workspace import Workspace
    from benchmark.records.run import RunRecord


class ReadAs(TypedDict):
    """How plans of a file are read, whatever it says: what ``--frame`` and ``--as-is`` say."""

    frame: Literal["lidar", "ego"] | None
    as_is: bool


def opened_results(
    paths: Sequence[Path] | None, wanted: str, name: str | None, native: str | None, dump: str | None
) -> "list[Recognised]":
    """Open the result files that were named, before anything is built.

    Args:
        paths: Files and folders, or none.
        wanted: What ``--format`` says.
        name: What ``--name`` says.
        native: What ``--native`` says.
        dump: What ``--dump-results`` says.

    Returns:
        The files with their formats.

    Raises:
        InputError: If a file is broken, options contradict each other, or there is no such format or protocol.
    """
    from adapters.result_files.recognition import AUTO, recognise, require_format
    from adapters.result_files.writing.formats import require_writable
    from benchmark.runs.planner_facts import known_native

    if dump is not None:
        require_writable(dump)
    if not paths:
        if wanted != AUTO or name is not None:
            raise InputError(f"{'--name' if name is not None else '--format'} belongs to --results; add it")
        return []
    require_format(wanted)
    known_native(native, f"result file {paths[0]}")
    if name is not None and (not name.strip() or not name.isprintable() or len(name) > 100):
        raise InputError("--name must be some printable text of at most 100 characters")
    return [recognise(path, wanted) for path in paths]


def results_planner(
    opened: "Sequence[Recognised]",
    dataset: "DataSet",
    split: str,
    *,
    scenes: tuple[str, ...],
    name: str | None,
    native: str | None,
    read_as: ReadAs,
) -> "ResultFileFactory":
    """The planner of opened result files; says what was found in them."""
    from adapters.result_files.planner import result_file_factory

    factory = result_file_factory(opened, dataset, split, scenes=scenes, name=name, native=native, **read_as)
    for sentence in factory.sentences:
        api.tell(sentence)
    return factory


def write_dumps(
    records: "Sequence[RunRecord]", dataset: "DataSet", split: str, name: str | None, space: "Workspace"
) -> list[str]:
    """Write the plans of records as result files, if asked to; what was written, in words."""
    if name is None:
        return []
    from adapters.result_files.samples import samples_of_data
    from adapters.result_files.writing.formats import write_results

    samples = samples_of_data(dataset, split)
    runs = space.run_root()
    written = [
        write_results(record, samples, name, space.out / "result-files" / record.directory.relative_to(runs) / name)
        for record in records
    ]
    return [f"result files: {', '.join(map(str, written))}"]
