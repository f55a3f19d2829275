"""Commands ``margins`` and ``data export csv``. Help imports this module, so that the rest is imported inside."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.settings import Option, command


@dataclass(frozen=True, slots=True, kw_only=True)
class MarginsOptions:
    """Options of ``margins``."""

    out: shared.Out = api.OUT


@command(MarginsOptions)
def margins_command(options: MarginsOptions) -> None:
    """Print the near misses of all runs that margin judged."""
    from benchmark.records.run import find_records
    from challenger_margins.tables import count_near_misses

    for record, share, count in count_near_misses(find_records(api.workspace(options.out).run_root())):
        typer.echo(f"{record.planner} on {record.run.split}: {share:.1%} of {count} samples")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Options of ``data export csv``."""

    root: shared.Root
    to: Annotated[Path, Option("Folder for the files, one a scene.", "Output")]
    split: Annotated[str | None, Option("Only this split; all scenes if not given.", "Input")] = None
    out: shared.Out = api.OUT


@command(ExportOptions)
def export_csv_command(options: ExportOptions) -> None:
    """Write where everything is at each key frame: one CSV file a scene."""
    from benchmark.machine.storage import sanitise_file_name

    data = api.DataSource.of(options)
    dataset = data.open() if options.split is None else data.open_split(options.split)
    options.to.mkdir(parents=True, exist_ok=True)
    for name in dataset.scene_names(options.split):
        scene = dataset.scene(name)
        with (options.to / f"{sanitise_file_name(name)}.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["time_us", "id", "category", "x", "y", "yaw"])
            for frame in scene.keyframes.tolist():
                for agent in scene.agents.valid[:, frame].nonzero()[0].tolist():
                    place = [*scene.agents.position[agent, frame, :2], scene.agents.yaw[agent, frame]]
                    texts = [f"{value:.3f}" for value in place]
                    agents = scene.agents
                    rows.writerow([scene.timestamps_us[frame], agents.ids[agent], agents.categories[agent], *texts])
        typer.echo(f"{options.to / name}.csv")
