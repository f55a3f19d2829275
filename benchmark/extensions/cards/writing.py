"""Card on disk: ``README.md`` with a YAML head (JSON, needs no package), Parquet index, ``build_croissant.json``."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any, Final

from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.extensions.cards.croissant import (
    PAGES,
    UNKNOWN,
    DataSetDescription,
    IndexColumn,
    build_croissant,
    parse_licence,
    write_index,
)
from benchmark.machine.storage import write_bytes, write_json
from benchmark.published import PAPER

_SIZES: Final = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def format_front_matter(fields: Mapping[str, Any]) -> str:
    """Front matter of a card, dashes included, in the given order; fields that are ``None`` or empty are left out."""
    lines = [
        f"{name}: {json.dumps(value, ensure_ascii=False, allow_nan=False)}"
        for name, value in fields.items()
        if value not in (None, "", [], {})
    ]
    return "\n".join(["---", *lines, "---", ""])


def find_size_category(rows: int) -> str:
    """Size category in which hubs put a number of rows."""
    return next((name for most, name in _SIZES if rows < most), "n>1M")


CARD_FILE: Final = "README.md"
CROISSANT_FILE: Final = "croissant.json"
CITE: Final = f'Zhiyuan Xu, Bohan Li, Huan-ang Gao, et al. "{PAPER}", 2025. https://pixtella.github.io/Challenger/'
_OURS: Final = "Card written by challenger-bench"
_TITLE: Final = re.compile(r"[^\n\r]{1,200}")
_HUB: Final = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}", re.ASCII)
_ADDRESS: Final = re.compile(r"https?://[^\s\"<>]{1,2000}")


@dataclass(frozen=True, slots=True)
class CardSettings:
    """Facts for a card that the data set itself does not hold.

    Attributes:
        title: Public name; the data set's own name if none is given.
        licence: Identifier of its licence; ``None`` where that is not decided.
        url: Where it will be published.
        published: Day of publication, ``YYYY-MM-DD``; the day of writing where none is given.
        creator: Publisher.
        hub: Data set on a hub, ``ORG/NAME``, for which results are written too; of cards of results alone.
    """

    title: str | None = None
    licence: str | None = None
    url: str | None = None
    published: str | None = None
    creator: str | None = None
    hub: str | None = None

    def __post_init__(self) -> None:
        parse_licence(self.licence)
        for option, text in (("--title", self.title), ("--creator", self.creator)):
            if text is not None and not (_TITLE.fullmatch(text) and text.strip()):
                raise InputError(f"{option} must be one line of at most 200 characters, got {text[:40]!r}")
        if self.url is not None and not _ADDRESS.fullmatch(self.url):
            raise InputError(f"--url must begin with http:// or https:// and contain no spaces, got {self.url[:80]!r}")
        if self.published is not None:
            try:
                date.fromisoformat(self.published)
            except ValueError as wrong:
                raise InputError(f"--published must be a day such as 2026-01-31, got {self.published!r}") from wrong
        if self.hub is not None and not _HUB.fullmatch(self.hub):
            raise InputError(f"--hub must be ORG/NAME, such as my-lab/mini-adv-3, got {self.hub[:80]!r}")

    @property
    def day(self) -> str:
        """Day of publication, or today."""
        return self.published or datetime.now(UTC).date().isoformat()


@dataclass(frozen=True, slots=True)
class WrittenCard:
    """Written files of a card, the number of rows of its index, and why records are no results for a hub."""

    files: tuple[Path, ...]
    rows: int
    left_out: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return {"files": [str(path) for path in self.files], "rows": self.rows}


def write_card(
    to: Path,
    said: DataSetDescription,
    page: Sequence[str],
    index_name: str,
    rows: str,
    columns: Sequence[IndexColumn],
    values: Sequence[Mapping[str, Any]],
    tags: Sequence[str],
) -> WrittenCard:
    """Write the files of a card, each in place of what is there, but not over a ``README.md`` that is no card of ours.

    ``page`` are lines below its head, ``rows`` is one word in the plural, ``tags`` are for hubs.
    """
    _require_own_card(to / CARD_FILE)
    index = to / index_name
    write_index(index, columns, values)
    known = said.licence if said.licence in (*PAGES, UNKNOWN) else "other"
    head = format_front_matter(
        {
            "pretty_name": said.name,
            "license": known,
            "license_name": said.licence if known != said.licence else None,
            "tags": ["croissant", *tags],
            "size_categories": [find_size_category(len(values))],
            "configs": [{"config_name": rows, "data_files": [{"split": "index", "path": index_name}], "default": True}],
        }
    )
    write_json(to / CROISSANT_FILE, build_croissant(said, index, rows, columns))
    write_bytes(to / CARD_FILE, (head + "\n".join(page) + "\n").encode())
    return WrittenCard((to / CARD_FILE, index, to / CROISSANT_FILE), len(values))


def format_footer() -> list[str]:
    """The last lines of a card: what to cite, and who wrote the card."""
    return ["## Cite", "", CITE, "", f"{_OURS} {VERSION}."]


def _require_own_card(page: Path) -> None:
    """Refuse to write over a ``README.md`` that is no card of ours."""
    try:
        theirs = page.exists() and _OURS not in page.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(f"cannot read {page}: {error.strerror or error}; name another folder with --to") from error
    if theirs:
        raise InputError(f"{page} is not a card written by challenger-bench; name another folder with --to, or move it")
