"""Commands that write cards: ``data card`` and ``leaderboard card``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import JsonOption, OutOption, RecordsOption, TablesOption, WorkersOption, print_json
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.extensions.cards.writing import CardSettings, WrittenCard

ToOption = Annotated[Path, typer.Option(help="Folder for the card, its index and its metadata.")]
TitleOption = Annotated[str | None, typer.Option(help="What it is called in public, if not by its name here.")]
LicenceOption = Annotated[
    str | None, typer.Option(help="Identifier of its licence, such as cc-by-nc-sa-4.0; unknown if not given.")
]
UrlOption = Annotated[str | None, typer.Option(help="Where it will be published.")]
PublishedOption = Annotated[str | None, typer.Option(help="Day of that, YYYY-MM-DD.")]
CreatorOption = Annotated[str | None, typer.Option(help="Who publishes it.")]


def data_card_command(
    root: Annotated[str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")],
    to: ToOption,
    title: TitleOption = None,
    licence: LicenceOption = None,
    url: UrlOption = None,
    published: PublishedOption = None,
    creator: CreatorOption = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Write a data-set card for a hub: README.md, a Parquet index of the scenes, and Croissant metadata."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.cli.preflight_places import require_place
    from benchmark.extensions.cards.writing import CardSettings
    from benchmark.machine.workspace import EMBEDDED_NAMES

    settings = CardSettings(title, licence, url, published, creator)
    api.worker_count(workers)
    require_root(root, tables, out)
    require_place(to, "--to")
    from benchmark.extensions.cards.data_card import write_data_card

    data = api.open_data(root, tables=tables, workers=workers, out=out)
    embedded = root in EMBEDDED_NAMES
    written = write_data_card(data, to, settings, embedded=embedded)
    _say(written, "scene", settings, json_output=json_output, named=embedded)


def records_card_command(
    to: ToOption,
    title: TitleOption = None,
    licence: LicenceOption = None,
    url: UrlOption = None,
    published: PublishedOption = None,
    creator: CreatorOption = None,
    out: OutOption = api.OUT,
    records: RecordsOption = None,
    json_output: JsonOption = False,
) -> None:
    """Write a card of results for a hub: README.md, every rate as a row of a Parquet file, and Croissant metadata."""
    from benchmark.cli.preflight_places import require_folder, require_place
    from benchmark.extensions.cards.records_card import write_records_card
    from benchmark.extensions.cards.writing import CardSettings
    from benchmark.records.drives import find_drives
    from benchmark.records.run import find_records

    settings = CardSettings(title, licence, url, published, creator)
    for place in records or ():
        require_folder(place, "--records")
    require_place(to, "--to")
    space = api.workspace(out)
    folders = [each for each in records or (space.run_root(), space.drive_root()) if each.is_dir()]
    if not folders:
        raise InputError(f"there are no records below {out}; run challenger-bench eval first, or name --records")
    written = write_records_card(find_records(*folders), find_drives(*folders), to, settings)
    _say(written, "rate", settings, json_output=json_output)


def _say(
    written: "WrittenCard", rows: str, settings: "CardSettings", *, json_output: bool, named: bool = False
) -> None:
    if settings.licence is None and not named:
        api.tell(
            "warning: the card says that its licence is not decided; --licence names one (what was made from "
            "recordings stays under their terms)"
        )
    if json_output:
        print_json(written.as_json())
    else:
        typer.echo(f"{counted(written.rows, rows)} in {written.files[1]}, beside {written.files[0].name} for a hub")
