"""The command ``data review``: scenes looked at by hand, verdicts recorded beside the split."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    JsonOption,
    LimitOption,
    OutOption,
    ScenesOption,
    SeedOption,
    TablesOption,
    WorkersOption,
    name_list,
    print_json,
)
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def data_review_command(
    root: Annotated[
        str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")
    ] = "mini",
    split: Annotated[
        str | None, typer.Option(help="Only this split; also adv or val-r that was generated from the data set.")
    ] = None,
    verdicts: Annotated[
        Path | None, typer.Option(help="Record the verdicts of this .csv or .json file, without a page.")
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="Only say which verdicts stand.")] = False,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    sample: Annotated[int | None, typer.Option(min=1, help="Look at so many scenes, drawn by --seed.")] = None,
    seed: SeedOption = 0,
    inspector: Annotated[str, typer.Option(help="Who looks, if that shall stand beside the verdicts.")] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page on 127.0.0.1; 0 takes a free one.")] = 0,
    browser: Annotated[bool, typer.Option("--open", help="Also open the page in the browser.")] = False,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Look at each scene on a local page and accept or reject it; rejected scenes are judged and written no more."""
    from benchmark.cli.preflight_data_sets import require_data, require_root
    from benchmark.cli.preflight_places import require_file

    api.worker_count(workers)
    named = name_list(scenes)
    if verdicts is not None and (show or sample is not None or browser or named or limit):
        raise InputError("--verdicts records a whole file; leave the options of the page out")
    require_file(verdicts, "--verdicts", (".csv", ".json"))
    if split is None:
        require_root(root, tables, out)
    else:
        require_data(root, tables, split, out)
    dataset = api.open_data(root, tables=tables, workers=workers, out=out)
    if split is not None:
        dataset = api.open_split(dataset, split, out, workers=workers)
    if verdicts is not None:
        _record_file(dataset, verdicts)
    elif not show:
        _show_page(dataset, split, named, (limit, sample, seed), inspector, port, browser=browser)
    _say(api.open_data(dataset.root, tables=dataset.version), split, json_output=json_output)


def _record_file(dataset: "DataSet", path: Path) -> None:
    """Record the verdicts of a file; all of them or none."""
    from benchmark.datasets.reviewed import record_verdicts, require_scenes, scene_tokens
    from benchmark.records.review import REVIEW_FILE, Verdict, checked_verdict
    from benchmark.untrusted.verdicts import read_verdicts

    said = read_verdicts(path)
    tokens = {each.name: each.token for each in dataset.review().judged} | scene_tokens(dataset.root)
    require_scenes(said, tokens, path, dataset.root)
    checked: dict[str, Verdict | None] = {
        name: checked_verdict({"token": tokens[name], **members}, f"{path}: the verdict on {name}")
        for name, members in said.items()
    }
    record_verdicts(dataset.root, checked)
    api.tell(f"{counted(len(checked), 'verdict')} recorded in {dataset.root / REVIEW_FILE}")


def _show_page(
    dataset: "DataSet",
    split: str | None,
    named: Sequence[str] | None,
    drawn: tuple[int | None, int | None, int],
    inspector: str,
    port: int,
    *,
    browser: bool,
) -> None:
    """Show the page until the inspector is done."""
    from benchmark.extensions.review.inspection import Inspection, drawn_for_inspection
    from benchmark.extensions.review.server import ReviewServer

    limit, sample, seed = drawn
    known = dataset.review(split).present
    unknown = sorted(set(named or ()) - set(known))
    if unknown:
        raise InputError(f"{dataset.root} has no scene {unknown[0]}; it has {', '.join(known[:3])} ...")
    names = drawn_for_inspection([name for name in known if named is None or name in named][:limit], sample, seed)
    if not names:
        raise InputError(f"{dataset.root} has no scene to look at")
    with ReviewServer(Inspection(dataset, names, inspector), port) as server:
        api.tell(f"{counted(len(names), 'scene')} to look at: {server.url}")
        api.tell("the page answers on this machine alone; Finish on it, or Ctrl-C here, ends the review")
        if browser:
            import webbrowser

            webbrowser.open(server.url)
        try:
            server.serve_until_done()
        except KeyboardInterrupt:
            api.tell("ended; every verdict is recorded")


def _say(dataset: "DataSet", split: str | None, *, json_output: bool) -> None:
    """What stands now."""
    from benchmark.records.review import REVIEW_FILE

    review = dataset.review(split)
    if json_output:
        rows = {each.name: {"verdict": each.verdict, "reason": each.reason} for each in review.judged}
        facts = None if review.facts is None else review.facts.model_dump(mode="json")
        print_json({"file": str(dataset.root / REVIEW_FILE), "review": facts, "verdicts": rows})
        return
    for each in review.judged:
        typer.echo(f"{each.verdict}: {each.name}{f': {each.reason}' if each.reason else ''}")
    typer.echo(f"{split or 'all scenes'} of {dataset.root}: {review.sentence()}")
