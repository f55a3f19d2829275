"""Croissant metadata (ML Commons 1.0, responsible-AI fields), index columns, and licence identifiers of hubs."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, write_bytes

PAGES: Final[Mapping[str, str]] = {
    "apache-2.0": "https://www.apache.org/licenses/LICENSE-2.0",
    "mit": "https://opensource.org/license/mit",
    "cc0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "cc-by-4.0": "https://creativecommons.org/licenses/by/4.0/",
    "cc-by-sa-4.0": "https://creativecommons.org/licenses/by-sa/4.0/",
    "cc-by-nc-4.0": "https://creativecommons.org/licenses/by-nc/4.0/",
    "cc-by-nc-sa-4.0": "https://creativecommons.org/licenses/by-nc-sa/4.0/",
}
UNKNOWN: Final = "unknown"
OTHER: Final = "other"
_IDENTIFIER: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]{0,99}")


def parse_licence(text: str | None) -> str:
    """Identifier of the licence that a user means; ``unknown`` where none is given."""
    if text is None:
        return UNKNOWN
    if not _IDENTIFIER.fullmatch(text):
        raise InputError(f"--licence {text!r} is not a licence identifier; give one such as cc-by-nc-sa-4.0, or other")
    return text.lower()


def find_licence_page(identifier: str) -> str:
    """Where a licence is to be read; the identifier itself where that is not known here."""
    return PAGES.get(identifier, identifier)


Kind = Literal["text", "count", "number", "truth"]
CROISSANT_TYPE: Final[Mapping[Kind, str]] = {
    "text": "sc:Text",
    "count": "sc:Integer",
    "number": "sc:Float",
    "truth": "sc:Boolean",
}


@dataclass(frozen=True, slots=True)
class IndexColumn:
    """One column of an index, whose name has the unit, if any, and whose values may be null."""

    name: str
    kind: Kind
    meaning: str


def write_index(path: Path, columns: Sequence[IndexColumn], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as a Parquet file, in place of the present one; a row has a value or ``None`` for each column."""
    import pyarrow
    from pyarrow import parquet

    types = {"text": pyarrow.string(), "count": pyarrow.int64(), "number": pyarrow.float64(), "truth": pyarrow.bool_()}
    schema = pyarrow.schema([(column.name, types[column.kind]) for column in columns])
    values = {column.name: [row[column.name] for row in rows] for column in columns}
    stream = io.BytesIO()
    parquet.write_table(pyarrow.table(values, schema=schema), stream)
    write_bytes(path, stream.getvalue())


def format_column_rows(columns: Sequence[IndexColumn]) -> list[str]:
    """Rows of a Markdown table of the columns."""
    return ["| column | type | meaning |", "|---|---|---|"] + [
        f"| `{column.name}` | {column.kind} | {column.meaning} |" for column in columns
    ]


CONFORMS_TO: Final = ("http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0")
CONTEXT: Final[Mapping[str, Any]] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The standard's own."""


@dataclass(frozen=True, slots=True)
class DataSetDescription:
    """Statements about a data set; `licence` is an identifier or ``unknown``, `published` a day ``YYYY-MM-DD``.

    `responsible` are fields of the responsible-AI extension, without prefix.
    """

    name: str
    description: str
    licence: str
    url: str | None
    published: str
    version: str
    cite: str
    creator: str | None
    keywords: tuple[str, ...]
    responsible: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)


def build_croissant(said: DataSetDescription, index: Path, rows: str, columns: Sequence[IndexColumn]) -> dict[str, Any]:
    """Croissant metadata (JSON-LD) of a data set whose index, one present Parquet file, is named relative to it.

    ``rows`` is one word in the plural.
    """
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{rows}/{column.name}",
            "name": column.name,
            "description": column.meaning,
            "dataType": CROISSANT_TYPE[column.kind],
            "source": {"fileObject": {"@id": index.name}, "extract": {"column": column.name}},
        }
        for column in columns
    ]
    file = {
        "@type": "cr:FileObject",
        "@id": index.name,
        "name": index.name,
        "description": f"One row for each of the {rows}.",
        "contentUrl": index.name,
        "contentSize": f"{index.stat().st_size} B",
        "encodingFormat": "application/x-parquet",
        "sha256": file_sha256(index),
    }
    optional = {
        "url": said.url,
        "license": None if said.licence == UNKNOWN else find_licence_page(said.licence),
        "creator": None if said.creator is None else {"@type": "sc:Organization", "name": said.creator},
    }
    return {
        "@context": dict(CONTEXT),
        "@type": "sc:Dataset",
        "conformsTo": list(CONFORMS_TO),
        "name": said.name,
        "description": said.description,
        "version": said.version,
        "datePublished": said.published,
        "citeAs": said.cite,
        "keywords": list(said.keywords),
        "isLiveDataset": False,
        **{name: value for name, value in optional.items() if value is not None},
        **{
            f"rai:{name}": list(text) if isinstance(text, tuple) else text
            for name, text in sorted(said.responsible.items())
        },
        "distribution": [file],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": rows,
                "name": rows,
                "description": f"One row for each of the {rows}.",
                "field": fields,
            }
        ],
    }
