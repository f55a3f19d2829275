"""Commands that write cards: ``data card`` and ``leaderboard card``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_result
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from benchmark.extensions.cards.writing import CardSettings, WrittenCard

ToOption = Annotated[Path, Option("Folder for the card, its index and its metadata.", "Output")]
TitleOption = Annotated[str | None, Option("What it is called in public, if not by its name here.", "Output")]
LicenceOption = Annotated[
    str | None, Option("Identifier of its licence, such as cc-by-nc-sa-4.0; unknown if not given.", "Output")
]
UrlOption = Annotated[str | None, Option("Where it will be published.", "Output")]
PublishedOption = Annotated[str | None, Option("Day of that, YYYY-MM-DD.", "Output")]
CreatorOption = Annotated[str | None, Option("Who publishes it.", "Output")]


@dataclass(frozen=True, slots=True, kw_only=True)
class DataCardOptions:
    """Options of ``data card``."""

    root: shared.Root
    to: ToOption
    title: TitleOption = None
    licence: LicenceOption = None
    url: UrlOption = None
    published: PublishedOption = None
    creator: CreatorOption = None
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(DataCardOptions)
def data_card_command(options: DataCardOptions) -> None:
    """Write a data-set card for a hub: README.md, a Parquet index of the scenes, and Croissant metadata."""
    from benchmark.extensions.cards.writing import CardSettings
    from benchmark.machine.path_checks import require_place

    settings = CardSettings(**api.select_matching_options(CardSettings, options))
    data = api.DataSource.of(options)
    data.require()
    require_place(options.to, "--to")
    from benchmark.extensions.cards.data_card import write_data_card

    written = write_data_card(data.open(), options.to, settings, embedded=data.is_embedded)
    _print_card(written, "scene", settings, json_output=options.json_output, named=data.is_embedded)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordsCardOptions:
    """Options of ``leaderboard card``."""

    to: ToOption
    title: TitleOption = None
    licence: LicenceOption = None
    url: UrlOption = None
    published: PublishedOption = None
    creator: CreatorOption = None
    hub: Annotated[
        str | None, Option("Also write results for this data set on a hub, ORG/NAME; nothing is uploaded.", "Output")
    ] = None
    out: shared.Out = api.OUT
    records: shared.Records = None
    json_output: shared.Json = False


@command(RecordsCardOptions)
def records_card_command(options: RecordsCardOptions) -> None:
    """Write a card of results for a hub: README.md, every rate as a row of a Parquet file, and Croissant metadata."""
    from benchmark.extensions.cards.records_card import write_records_card
    from benchmark.extensions.cards.writing import CardSettings
    from benchmark.machine.path_checks import require_folder, require_place
    from benchmark.records.drives import find_drives
    from benchmark.records.run import find_records

    settings = CardSettings(**api.select_matching_options(CardSettings, options))
    for place in options.records or ():
        require_folder(place, "--records")
    require_place(options.to, "--to")
    space = api.workspace(options.out)
    folders = [folder for folder in options.records or (space.run_root(), space.drive_root()) if folder.is_dir()]
    if not folders:
        raise InputError(
            f"there are no records below {options.out}; run challenger-bench eval first, or name --records"
        )
    written = write_records_card(find_records(*folders), find_drives(*folders), options.to, settings)
    _print_card(written, "rate", settings, json_output=options.json_output)


def _print_card(
    written: "WrittenCard", rows: str, settings: "CardSettings", *, json_output: bool, named: bool = False
) -> None:
    if settings.licence is None and not named:
        api.notify(
            "warning: the licence of the card is undecided; set it with --licence (data derived from "
            "recordings stays under their terms)"
        )
    for sentence in written.left_out:
        api.notify(f"not for the hub: {sentence}")
    text = f"{pluralise(written.rows, rows)} in {written.files[1]}, beside {written.files[0].name} for a hub"
    print_result(written.as_json(), text, json_output=json_output)
