"""The command ``data review``: scenes looked at by hand, verdicts recorded beside the split."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import print_json
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True, kw_only=True)
class DataReviewOptions:
    """Options of ``data review``."""

    root: shared.Root = "mini"
    split: Annotated[
        str | None, Option("Only this split; also adv or val-r that was generated from the data set.", "Input")
    ] = None
    verdicts: Annotated[
        Path | None, Option("Record the verdicts of this .csv or .json file, without a page.", "Input")
    ] = None
    show: Annotated[bool, Option("Only say which verdicts stand.", "Output", names="--list")] = False
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    sample: Annotated[int | None, Option("Look at so many scenes, drawn by --seed.", "Input", min=1)] = None
    seed: shared.Seed = 0
    inspector: Annotated[str, Option("Who looks, if that shall stand beside the verdicts.")] = ""
    port: Annotated[
        int, Option("Port of the page on 127.0.0.1; 0 takes a free one.", "Execution", min=0, max=65535)
    ] = 0
    browser: Annotated[bool, Option("Also open the page in the browser.", names="--open")] = False
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(DataReviewOptions)
def data_review_command(options: DataReviewOptions) -> None:
    """Look at each scene on a local page and accept or reject it; rejected scenes are judged and written no more."""
    from benchmark.machine.path_checks import require_file

    data, named = api.DataSource.of(options), parse_name_list(options.scenes)
    of_page = options.show or options.sample is not None or options.browser or named or options.limit
    if options.verdicts is not None and of_page:
        raise InputError("--verdicts records a whole file without the page; leave the options of the page out")
    require_file(options.verdicts, "--verdicts", (".csv", ".json"))
    data.require() if options.split is None else data.require_split(options.split)
    dataset = data.open() if options.split is None else data.open_split(options.split)
    if options.verdicts is not None:
        _record_file(dataset, options.verdicts)
    elif not options.show:
        _show_page(
            dataset,
            options.split,
            named,
            (options.limit, options.sample, options.seed),
            options.inspector,
            options.port,
            browser=options.browser,
        )
    _print_verdicts(api.open_data(dataset.root, tables=dataset.version), options.split, json_output=options.json_output)


def _record_file(dataset: "DataSet", path: Path) -> None:
    from benchmark.datasets.split_reviews import record_verdicts, require_scenes, scene_tokens
    from benchmark.records.review import REVIEW_FILE, Verdict, check_verdict
    from benchmark.untrusted.verdicts import read_verdicts

    verdicts = read_verdicts(path)
    tokens = {reviewed.name: reviewed.token for reviewed in dataset.review().judged} | scene_tokens(dataset.root)
    require_scenes(verdicts, tokens, path, dataset.root)
    checked: dict[str, Verdict | None] = {
        name: check_verdict({"token": tokens[name], **members}, f"{path}: the verdict on {name}")
        for name, members in verdicts.items()
    }
    record_verdicts(dataset.root, checked)
    api.notify(f"{pluralise(len(checked), 'verdict')} recorded in {dataset.root / REVIEW_FILE}")


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
    from benchmark.datasets.scene_names import resolve_names
    from benchmark.extensions.review.inspection import Inspection, draw_scenes_to_inspect
    from benchmark.extensions.review.server import ReviewServer

    limit, sample, seed = drawn
    known, named = dataset.review(split).present, resolve_names(dataset.provenance(), named or ()) or None
    unknown = sorted(set(named or ()) - set(known))
    if unknown:
        raise InputError(f"{dataset.root} has no scene {unknown[0]}; it has {', '.join(known[:3])} ...")
    names = draw_scenes_to_inspect([name for name in known if named is None or name in named][:limit], sample, seed)
    if not names:
        raise InputError(f"{dataset.root} has no scene to review")
    with ReviewServer(Inspection(dataset, names, inspector), port) as server:
        api.notify(f"{pluralise(len(names), 'scene')} to review: {server.url}")
        api.notify("the page is served to this machine only; end the review with Finish on the page, or Ctrl-C here")
        if browser:
            import webbrowser

            webbrowser.open(server.url)
        try:
            server.serve_until_done()
        except KeyboardInterrupt:
            api.notify("ended; every verdict is recorded")


def _print_verdicts(dataset: "DataSet", split: str | None, *, json_output: bool) -> None:
    from benchmark.records.review import REVIEW_FILE

    review = dataset.review(split)
    if json_output:
        rows = {reviewed.name: {"verdict": reviewed.verdict, "reason": reviewed.reason} for reviewed in review.judged}
        facts = None if review.facts is None else review.facts.model_dump(mode="json")
        print_json({"file": str(dataset.root / REVIEW_FILE), "review": facts, "verdicts": rows})
        return
    for reviewed in review.judged:
        typer.echo(f"{reviewed.verdict}: {reviewed.name}{f': {reviewed.reason}' if reviewed.reason else ''}")
    typer.echo(f"{split or 'all scenes'} of {dataset.root}: {review.sentence()}")
