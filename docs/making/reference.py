"""Pages of ``docs/reference``, made from the code: settings, formats, protocols and fields.

``python docs/making/reference.py`` writes them anew. Descriptions are those of the docstrings of what they describe.
"""

import dataclasses
import importlib
import inspect
import pkgutil
import re
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

import numpy as np
import typer
from pydantic import BaseModel

FOLDER: Final = Path(__file__).resolve().parents[1] / "reference"
GENERATED: Final = "*Generated from the code by `python docs/making/reference.py`; do not edit.*"
RUN, SHEETS = "runs/<data>/<split>/<planner>", "sheets/<data>/<split>"
DRIVES: Final = "drives/<data>/<split>/<settings>/<planner>"
FILES: Final = (
    ("Run records", f"`{RUN}/run.json`", "eval", "benchmark.records.run_schema:RunFacts"),
    ("Run records", "`samples.jsonl` beside it, a row a sample", "eval", "benchmark.records.row_schema:SampleRow"),
    ("Run records", "`summary.json` beside it", "eval", "benchmark.records.run_schema:RunSummary"),
    ("Run records", "`reproduction.json` beside it", "reproduce", "benchmark.records.reproduction:Reproduction"),
    ("Records of drives", f"`{DRIVES}/drive.json`", "drive", "benchmark.records.drive_schema:DriveFacts"),
    (
        "Records of drives",
        f"`{DRIVES}/drives.jsonl`, a row a drive",
        "drive",
        "benchmark.records.drive_schema:EpisodeRow",
    ),
    ("Records of drives", "`summary.json` beside it", "drive", "benchmark.records.drive_schema:DriveSummary"),
    ("Generated splits", "`attempts.jsonl`, a row a tried vehicle", "generate", "benchmark.records.attempts:Attempt"),
    ("Generated splits", "`judgements.json`", "generate", "benchmark.datasets.scene_assessments:AssessmentsFile"),
    ("Generated splits", "`review.json`", "data review", "benchmark.records.review:ReviewFile"),
    ("Generated splits", "a frozen split", "generate --freeze", "generation.splits.format:FrozenSplit"),
    ("Generated splits", "`manifest.json` of a package", "data pack", "generation.splits.packing:PackageManifest"),
    ("Scene sheets", f"`{SHEETS}/split.json`", "sheets", "benchmark.records.scene_pages:SplitPage"),
    ("Scene sheets", f"`{SHEETS}/scenes/<scene>/sheet.json`", "sheets", "benchmark.records.scene_pages:ScenePage"),
    ("Scene sheets", "`rounds.json` beside it", "sheets --rounds", "benchmark.records.scene_pages:RefinementTrace"),
    ("Measurements", "`ablation.json`", "ablate", "benchmark.records.ablation:AblationReport"),
    ("Measurements", "costs of a planner", "eval", "benchmark.records.planner_cost:PlannerCost"),
    ("Measurements", "`quality.json`", "quality", "benchmark.records.quality:QualityFacts"),
    ("Measurements", "`subjects.jsonl`", "quality", "benchmark.records.quality:SubjectRow"),
    ("Measurements", "`videos.jsonl`", "quality", "benchmark.records.quality:VideoRow"),
    ("Challenges", "`verdict.json`", "challenge check", "benchmark.records.challenge:EntryVerdict"),
    ("Challenges", "`scores-<name>.json`", "challenge score", "benchmark.records.challenge:ChallengeScores"),
)
"""Files of JSON below ``--out`` or a data set's root: chapter, name, command, model."""


def reference_pages() -> dict[str, str]:
    """Text of each page by its file name."""
    return {
        "settings.md": _page("Reference: settings", _settings()),
        "formats.md": _page("Reference: formats", _formats()),
        "protocols.md": _page("Reference: protocols", _protocols()),
        "fields.md": _page("Reference: fields", _fields()),
    }


def missing_descriptions() -> list[str]:
    """Fields of files that their docstrings do not describe, as ``Class.field``."""
    models = dict.fromkeys(model for *_, reference in FILES for model in _models_below(_resolve(reference)))
    return [f"{model.__name__}.{name}" for model in models for name, _, text in _rows(model) if not text]


def _page(title: str, lines: Iterable[str]) -> str:
    return "\n".join([f"# {title}", "", GENERATED, "", *lines]).rstrip() + "\n"


def _resolve(reference: str) -> Any:
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield from ("| " + " | ".join(heads) + " |", "|" + "---|" * len(heads))
    for row in rows:
        yield "| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in row) + " |"
    yield ""


def _settings() -> Iterator[str]:
    """Settings of commands that help does not list."""
    yield from (
        "Settings of commands that their help does not list: as flags, by `--set NAME=VALUE` or in a file",
        "([settings](../settings.md)).",
    )
    for name, command in _commands():
        context = command.make_context(name, [], resilient_parsing=True)
        rows = []
        for parameter in command.params:
            if parameter.hidden:
                parameter.hidden = False
                option, text = parameter.get_help_record(context)
                parameter.hidden = True
                rows.append((f"`{parameter.name}`", f"`{' '.join(option.split())}`", text))
        yield from ("", f"## {name}", "")
        yield from _table(("name", "option", "meaning"), rows)


def _commands(command: Any = None, path: str = "") -> Iterator[tuple[str, Any]]:
    """Commands with rare settings, by the words that lead to them."""
    from benchmark.cli.app import app
    from benchmark.cli.settings import list_rare_settings

    group = typer.main.get_command(app) if command is None else command
    if list_rare_settings(getattr(group.callback, "settings", object)):
        yield path, group
    for name, inner in getattr(group, "commands", {}).items():
        yield from _commands(inner, f"{path} {name}".strip())


def _formats() -> Iterator[str]:
    """Files of JSON, and the tables of a data set."""
    yield from (
        "Files that commands write and read, below `--out` or in the root of a data set. A field that a file lacks",
        "has its default; an unknown field is refused. Tables of a [data set](#tables-of-a-data-set) stand last.",
        "",
    )
    yield from _table(
        ("file", "written by", "content"),
        [(name, f"`{command}`", _link(_resolve(reference))) for _, name, command, reference in FILES],
    )
    shown: set[Any] = set()
    for chapter in dict.fromkeys(chapter for chapter, *_ in FILES):
        yield from (f"## {chapter}", "")
        for _, _, _, reference in (file for file in FILES if file[0] == chapter):
            for model in _models_below(_resolve(reference)):
                if model not in shown:
                    shown.add(model)
                    yield from _model_section(model)
    yield from _data_set_tables()


def _model_section(model: Any) -> Iterator[str]:
    yield from (f"### {model.__name__}", "", _markdown(" ".join(_prose(model).split())), "")
    rows = ((f"`{name}`", kind, _markdown(text)) for name, kind, text in _rows(model))
    yield from _table(("field", "type", "meaning"), rows)


def _data_set_tables() -> Iterator[str]:
    from benchmark.datasets.schema.tables import SCHEMA

    yield from (
        "## Tables of a data set",
        "",
        "Fields of nuScenes' tables that are read; rows may have others ([data sets](../data.md)).",
        "",
    )
    for table, fields in SCHEMA.items():
        yield from (f"### {table}.json", "")
        rows = (
            (
                f"`{name}`",
                f"{field.kind.words}{', unique' if field.unique else ''}",
                f"`{field.target}`" if field.target else "",
            )
            for name, field in fields.items()
        )
        yield from _table(("field", "must be", "row of"), rows)


def _models_below(model: Any) -> Iterator[Any]:
    """A model, and all those that its fields are made of, each once."""
    found: dict[Any, None] = {}

    def visit(kind: Any) -> None:
        if _is_model(kind):
            if kind not in found:
                found[kind] = None
                for _, annotation in _annotations(kind):
                    visit(annotation)
        else:
            for part in get_args(kind):
                visit(part)

    visit(model)
    yield from found


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and (issubclass(kind, BaseModel) or dataclasses.is_dataclass(kind))


def _annotations(model: Any) -> Iterator[tuple[str, Any]]:
    """Names as files have them, and types."""
    hints = typing.get_type_hints(model, include_extras=True)
    if issubclass(model, BaseModel):
        for name, field in model.model_fields.items():
            yield field.alias or name, hints[name]
    else:
        for member in dataclasses.fields(model):
            yield member.name, hints[member.name]


def _rows(model: Any) -> Iterator[tuple[str, str, str]]:
    """Name, type and meaning of each field."""
    names = {field.alias: name for name, field in getattr(model, "model_fields", {}).items() if field.alias}
    for name, annotation in _annotations(model):
        yield name, _type_words(annotation), _meaning(model, names.get(name, name), annotation)


def _meaning(model: Any, name: str, annotation: Any) -> str:
    """What the docstrings say of a field: its line, else the sentences that name it, else of what kind it is."""
    for cls in model.__mro__:
        if (line := _attributes(cls).get(name)) is not None:
            return line
    sentences = [
        sentence
        for cls in model.__mro__
        for sentence in re.split(r"(?<=[.;]) ", " ".join(_prose(cls).split()))
        if f"``{name}``" in sentence
    ]
    if sentences:
        return f"{' '.join(sentences).rstrip(';.')}."
    models = list(_models_in(annotation))
    return _first_sentence(models[0]) if models else ""


def _models_in(annotation: Any) -> Iterator[Any]:
    if _is_model(annotation):
        yield annotation
    else:
        for part in get_args(annotation):
            yield from _models_in(part)


def _doc(cls: Any) -> str:
    """A docstring that somebody wrote: dataclasses make one of their signature."""
    text = cls.__dict__.get("__doc__") or ""
    ours = cls.__module__.partition(".")[0] in ("benchmark", "generation", "adapters", "leaderboard")
    return inspect.cleandoc(text) if ours and not text.startswith(f"{cls.__name__}(") else ""


def _prose(cls: Any) -> str:
    return _doc(cls).partition("\nAttributes:")[0].strip()


def _first_sentence(cls: Any) -> str:
    return " ".join(re.split(r"(?<=\.)\s", _prose(cls), maxsplit=1)[0].split())


def _attributes(cls: Any) -> dict[str, str]:
    """Lines of the section ``Attributes`` of a docstring, by name."""
    section = _doc(cls).partition("\nAttributes:\n")[2]
    entries = re.findall(r"^    (\w+): (.*(?:\n     +.*)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


_WORDS: Final[Mapping[Any, str]] = {
    str: "text",
    int: "whole number",
    float: "number",
    bool: "true or false",
    type(None): "null",
    Any: "any",
    dict: "object",
    list: "list",
    tuple: "list",
}


def _type_words(annotation: Any) -> str:
    """A type in the words of JSON."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_words(parts[0])
    if _is_model(annotation):
        return _link(annotation)
    if isinstance(annotation, type) and issubclass(annotation, StrEnum):
        parts, origin = tuple(annotation), Literal
    if origin is Literal:
        return ", ".join(f"`{part}`" if part != "" else "empty" for part in parts)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_type_words, parts))) if len(parts) < 4 else "any"
    if origin is list or (origin is tuple and parts[1:] == (...,)):
        return f"list of {_type_words(parts[0])}"
    if origin is tuple:
        return f"[{', '.join(map(_type_words, parts))}]"
    if origin is dict:
        return f"{_type_words(parts[1])} by name"
    return _WORDS[annotation]


def _link(model: Any) -> str:
    return f"[{model.__name__}](#{model.__name__.lower()})"


def _markdown(text: str) -> str:
    """A docstring's text in Markdown; pages of docs/ in letters of code, which become links on the site."""
    plain = text.replace("``None``", "null").replace("``", "`")
    return re.sub(r"(?<![`\w/])docs/[\w./-]+\.md", r"`\g<0>`", plain)


def _protocols() -> Iterator[str]:
    """Every protocol of the registry."""
    from benchmark.pdm import definition as pdm
    from benchmark.protocols import LEAVING_OUT, MAXIMA, PROTOCOLS, STANDARD, find_masking_protocols

    ours = list(dict.keys(PROTOCOLS))
    masking = find_masking_protocols()
    yield from (
        "Definitions of collision and L2 by which plans are judged; [metrics](../metrics.md) says how to read them.",
        "*Always*: judges every run; the others on request (`--protocol`). *Cut short*: counts samples whose recording",
        "ends within 3 s. *Recorded ego*: what happens to what it collides with by the same rule. *Maximum*: the rate",
        "at a horizon is any contact up to it; other official protocols take values at the step or means.",
        "",
    )

    def about(name: str) -> tuple[str, ...]:
        protocol = PROTOCOLS[name]
        excluded = "sample left out" if name in LEAVING_OUT else "step masked" if name in masking else ""
        return (
            f"[`{name}`](#{_module_name(protocol)})",
            str(protocol.version),
            _yes(name in STANDARD),
            _yes(protocol.counts_incomplete),
            excluded,
            _yes(name in MAXIMA or name == "exact"),
            _markdown(_first_sentence(type(protocol)).partition(";")[0].partition(": see")[0].rstrip(".")),
        )

    heads = ("name", "version", "always", "cut short", "recorded ego", "maximum", "definition")
    rows = [about(name) for name in ours]
    pdm_row = (
        f"`{pdm.PDM}`",
        str(pdm.VERSION),
        "yes",
        "",
        "",
        "",
        f"{pdm.DEFINITION}, see [driving scores](../pdm.md)",
    )
    yield from _table(heads, [*rows, pdm_row])
    for module in dict.fromkeys(type(PROTOCOLS[name]).__module__ for name in ours):
        own = importlib.import_module(module)
        yield from (f"## {module.rpartition('.')[2].replace('_', '-')}", "", f"`{module.replace('.', '/')}.py`", "")
        yield from (_markdown(inspect.cleandoc(own.__doc__ or "")), "")


def _module_name(protocol: Any) -> str:
    return str(type(protocol).__module__.rpartition(".")[2].replace("_", "-"))


def _yes(holds: bool) -> str:
    return "yes" if holds else ""


def _fields() -> Iterator[str]:
    """Columns of frames and tables."""
    from benchmark.constants import HORIZON_STEPS
    from benchmark.metrics.frames import COLUMNS, ROW_FIELDS
    from benchmark.protocols.contract import COLUMN_MEANINGS
    from benchmark.records.row_schema import SampleRow

    meanings = {name: text for name, _, text in _rows(SampleRow)}
    horizons = ", ".join(f"`{horizon}`" for horizon in HORIZON_STEPS)
    yield from (
        "## samples_frame",
        "",
        "`benchmark.samples_frame(record)`: one row a sample ([from Python](../python.md)). The mean of a number's",
        "column is the published rate of that protocol and horizon.",
        "",
    )
    rows = [(f"`{name.removesuffix('_token')}`", _markdown(meanings[name])) for name in ROW_FIELDS]
    rows += [
        (f"`<protocol> {column} <horizon>`", f"{COLUMN_MEANINGS[column]} Horizons: {horizons}.") for column in COLUMNS
    ]
    yield from _table(("column", "meaning"), rows)
    yield from _rate_columns()
    yield from _table_files()
    yield from _table_columns()
    yield from _index_columns()


def _rate_columns() -> Iterator[str]:
    from benchmark.pdm.totals import DrivenPlan
    from benchmark.protocols import PROTOCOLS
    from benchmark.protocols.contract import COLUMN_MEANINGS
    from benchmark.records.driving import SUB_SCORES

    of_none = np.zeros((0, 6, 2))
    columns: dict[str, list[str]] = {}
    for name in dict.keys(PROTOCOLS):
        protocol = PROTOCOLS[name]
        for column in protocol.sample_values(protocol.evaluate([], of_none)):
            columns.setdefault(column, []).append(name)
    yield from (
        "## Rates of a run",
        "",
        "`protocols.<name>.columns` of `summary.json`, at `1s`, `2s`, `3s` and `avg`.",
        "",
    )
    every = len(dict.keys(PROTOCOLS))
    yield from _table(
        ("column", "meaning", "protocols"),
        [
            (f"`{column}`", COLUMN_MEANINGS[column], "all" if len(names) == every else ", ".join(names))
            for column, names in columns.items()
        ],
    )
    yield from (
        "## Driving scores of a run",
        "",
        "`driving.columns` in `summary.json` ([definition](../pdm.md)), each as `mean` and share of `ones`. `score` is",
        "the total, `score_without_ec` leaves EC out; `filtered_` ones count as 1 what the recorded driver fails too.",
        "",
    )
    meanings = _attributes(DrivenPlan)
    rows = [(f"`{name}`", _markdown(meanings[name])) for name in SUB_SCORES]
    yield from _table(("column", "meaning"), rows)


def _table_files() -> Iterator[str]:
    from benchmark.report.cells import CellSource
    from benchmark.report.table import Table

    yield from (
        "## Files of tables",
        "",
        "CSV has the heads below, each as `head | group`, numbers as they are shown and nothing for a dash. JSON has:",
        "",
    )
    members = Table("", "", (), ()).as_json()
    said = _attributes(Table)
    yield from _table(("member", "meaning"), [(f"`{name}`", _markdown(said[name])) for name in members])
    yield from ("and of each cell with a number:", "")
    facts = _attributes(CellSource)
    yield from _table(("member", "meaning"), [(f"`{name}`", _markdown(text)) for name, text in facts.items()])


def _table_columns() -> Iterator[str]:
    """Columns of the tables whose heads do not depend on the records."""
    import leaderboard.tables
    from leaderboard.frame.runs import DataSetRuns
    from leaderboard.tables.collision import collision_table

    yield from (
        "## Columns of tables",
        "",
        "Heads by group, of the tables whose columns do not depend on the records. `95 % of` is an interval.",
        "",
    )
    rows = [("collision", _heads(list(zip(*_grouped(collision_table(DataSetRuns("", ()), "exact"))))))]
    for module in pkgutil.iter_modules(leaderboard.tables.__path__):
        tables = _specifications(importlib.import_module(f"leaderboard.tables.{module.name}"))
        rows += [(_TABLE_NAMES.get(module.name, module.name.replace("_", " ")), _heads(columns)) for columns in tables]
    yield from _table(("table of", "columns"), rows)


_TABLE_NAMES: Final = {"contents": "consistency", "effect": "effect (the main table)"}


def _grouped(table: Any) -> tuple[Sequence[str], Sequence[str]]:
    labels = [label for label, span in table.groups for _ in range(span)] or [""] * len(table.columns)
    return table.columns, labels


def _specifications(module: Any) -> Iterator[list[tuple[str, str]]]:
    """Lists of columns in a module, without those that are parts of others."""
    from leaderboard.frame.specification import TableColumn

    found = [
        [(column.key, column.group) for column in value]
        for value in vars(module).values()
        if isinstance(value, list) and value and isinstance(value[0], TableColumn)
    ]
    yield from (one for one in found if not any(set(one) < set(other) for other in found))


def _heads(columns: Sequence[tuple[str, str]]) -> str:
    groups: dict[str, list[str]] = {}
    for head, group in columns:
        groups.setdefault(group, []).append(f"`{head}`")
    return "; ".join(f"{f'*{group}*: ' if group else ''}{', '.join(heads)}" for group, heads in groups.items())


def _index_columns() -> Iterator[str]:
    from benchmark.extensions.cards.data_card import SCENE_COLUMNS
    from benchmark.extensions.cards.records_card import RATE_COLUMNS

    for name, command, columns in (
        ("scenes.parquet", "data card", SCENE_COLUMNS),
        ("rates.parquet", "leaderboard card", RATE_COLUMNS),
    ):
        yield from (f"## {name}", "", f"Written by `{command}` ([cards](../extensions/cards.md)).", "")
        yield from _table(("column", "type", "meaning"), [(f"`{c.name}`", c.kind, c.meaning) for c in columns])


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file_name, text in reference_pages().items():
        (FOLDER / file_name).write_text(text)
