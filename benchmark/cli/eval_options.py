"""Settings of ``eval``."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.settings import Option


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalOptions:
    """Options of ``eval``."""

    EXTENDED: ClassVar = ("planner",)

    RARE: ClassVar = (
        *("tables", "categories", "results_format", "name", "native", "frame", "as_is", "dump_results", "unchanged"),
        *("precision", "image_format", "sample_limit", "memory_limit", "explain_protocols", "cameras", "driving_side"),
    )

    model: shared.Models = ()
    split: shared.Splits = ("val", "adv")
    data: shared.Data = "mini"
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    plans: Annotated[Path | None, Option("Plan file (CSV, Parquet, JSON) instead of a model.", "Input")] = None
    results: Annotated[
        tuple[Path, ...] | None,
        Option("Result file that a planner's own repository wrote, or a folder of them; may be repeated.", "Input"),
    ] = None
    out: shared.Out = api.OUT
    json_output: shared.Json = False
    dry_run: shared.DryRun = False
    protocol: Annotated[
        tuple[str, ...] | None,
        Option(
            "Tables to print: a protocol, native, pdm or all; may be repeated. Judges that are not standard join.",
            "Output",
        ),
    ] = None
    by: shared.By = None
    wide: shared.Wide = False
    verbose: shared.Verbose = False
    allow_partial: Annotated[
        bool, Option("Print rates even where the planner failed on samples; --plans may lack rows.", "Output")
    ] = False
    checkpoint: shared.Checkpoint = None
    device: shared.NetworkDevices = None
    as_published: shared.AsPublished = None
    workers: shared.Workers = 0
    seed: shared.Seed = 0
    shard: shared.Shard = None
    tables: shared.Tables = None
    categories: shared.Categories = None
    driving_side: shared.DrivingSide = None
    cameras: shared.Cameras = None
    results_format: Annotated[
        str, Option("With --results: auto tells it by content (docs/your-results.md).", "Input", names="--format")
    ] = "auto"
    name: Annotated[
        str | None, Option("Name of the planner in records and tables, if not its own or the file's.", "Input")
    ] = None
    native: Annotated[
        str | None,
        Option("With --plans or --results: the protocol of the repository that the planner comes from.", "Input"),
    ] = None
    frame: shared.PlanFrame = None
    as_is: Annotated[
        bool,
        Option(
            "With --plans or --results: judge plans as they stand, even if they fit far better otherwise; marked.",
            "Input",
        ),
    ] = False
    dump_results: Annotated[str | None, Option("Also write the plans as a repository's result file.", "Output")] = None
    unchanged: Annotated[
        str | None,
        Option(
            "Data set whose recordings the scenes of --split were made from, where --data lacks them: Adv-nuSc.",
            "Input",
            metavar="<root>",
        ),
    ] = None
    precision: shared.Precision = None
    image_format: shared.ImageFormat = None
    sample_limit: shared.SampleLimit = None
    memory_limit: shared.MemoryLimit = None
    explain_protocols: Annotated[
        bool, Option("Where each protocol differs from exact, why, and pictures of it.", "Output")
    ] = False

    @staticmethod
    def from_record(members: "Mapping[str, Any]") -> "dict[str, Any] | None":
        """Settings of a run record."""
        from benchmark.cli.record_settings import read_eval_options

        return read_eval_options(members)
