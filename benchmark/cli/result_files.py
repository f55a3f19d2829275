"""Plans that others made, as ``eval`` reads and writes them: plan files, and result files of repositories."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark import api
from benchmark.errors import InputError

if TYPE_CHECKING:
    from adapters.result_files.recognition import Recognised
    from benchmark.cli.eval_options import EvalOptions
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workspace import Workspace
    from benchmark.records.run import RunRecord
    from benchmark.runs.plan_rows import PlannerFactory


def opened_results(options: "EvalOptions") -> "list[Recognised]":
    """Result files of ``--results`` with their formats.

    The file of ``--plans`` is checked too, before anything is built.
    """
    from adapters.plan_file import read_plan_file
    from adapters.result_files.recognition import AUTO, recognise, require_format
    from adapters.result_files.writing.formats import require_writable
    from benchmark.machine.places import require_file
    from benchmark.runs.planner_facts import known_native

    plans, paths, wanted, name = options.plans, options.results, options.results_format, options.name
    if plans is not None:
        known_native(options.native, f"plan file {plans}")
        require_file(plans, "--plans", (".csv", ".parquet", ".json"))
        read_plan_file(plans)
    if options.dump_results is not None:
        require_writable(options.dump_results)
    if not paths:
        if wanted != AUTO or name is not None:
            raise InputError(f"{'--name' if name is not None else '--format'} belongs to --results; add it")
        return []
    require_format(wanted)
    known_native(options.native, f"result file {paths[0]}")
    if name is not None and (not name.strip() or not name.isprintable() or len(name) > 100):
        raise InputError("--name must be some printable text of at most 100 characters")
    return [recognise(path, wanted) for path in paths]


def planners_of_files(
    options: "EvalOptions",
    opened: "Sequence[Recognised]",
    dataset: "DataSet",
    split: str,
    scenes: tuple[str, ...],
    run_root: Path,
) -> "list[PlannerFactory]":
    """The planners of a plan file and of opened result files; what was found in them is said on stderr."""
    from adapters.plan_file import plan_file_factory
    from adapters.result_files.planner import result_file_factory

    read_as: dict[str, Any] = {"scenes": scenes, "native": options.native, "frame": options.frame}
    read_as["as_is"] = options.as_is
    found: list[Any] = []
    if options.plans is not None:
        partial = options.allow_partial
        found.append(
            plan_file_factory(options.plans, dataset, split, records=[run_root], allow_partial=partial, **read_as)
        )
    if opened:
        found.append(result_file_factory(opened, dataset, split, name=options.name, **read_as))
    for factory in found:
        for sentence in factory.sentences:
            api.tell(sentence)
    return found


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
