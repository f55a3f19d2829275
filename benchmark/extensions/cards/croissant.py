"""Croissant metadata (ML Commons, version 1.0) with the fields of its responsible-AI extension."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from benchmark.extensions.cards.columns import CROISSANT_TYPE, Column
from benchmark.extensions.cards.licences import UNKNOWN, licence_page
from benchmark.machine.storage import file_sha256

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
class Described:
    """Statements about a data set as a whole.

    Attributes:
        licence: Identifier of its licence, or ``unknown``.
        published: Day of that, ``YYYY-MM-DD``.
        version: Of its content.
        responsible: Fields of the responsible-AI extension by name without prefix, one text or several.
    """

    name: str
    description: str
    licence: str
    url: str | None
    published: str | None
    version: str
    cite: str
    creator: str | None
    keywords: tuple[str, ...]
    responsible: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)


def croissant(said: Described, index: Path, rows: str, columns: Sequence[Column]) -> dict[str, Any]:
    """Croissant metadata (JSON-LD) of a data set whose index is one Parquet file.

    Args:
        index: The file, which must be there; it is named relative to the metadata beside it.
        rows: What a row is, one word in the plural.
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
        "license": None if said.licence == UNKNOWN else licence_page(said.licence),
        "datePublished": said.published,
        "creator": None if said.creator is None else {"@type": "sc:Organization", "name": said.creator},
    }
    return {
        "@context": dict(CONTEXT),
        "@type": "sc:Dataset",
        "conformsTo": list(CONFORMS_TO),
        "name": said.name,
        "description": said.description,
        "version": said.version,
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
