"""``docs/reference/differences-from-paper.md``: what the presets ``paper`` and ``reference`` do differently, and why.

``python docs/making/differences.py`` writes it anew.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from generation.search.differences_from_paper import INTERPRETATIONS, PAPER, REFERENCE, PresetDifference

PAGE = Path(__file__).resolve().parents[1] / "reference" / "differences-from-paper.md"


def build_page() -> str:
    """The whole page."""
    return "\n".join(_page()) + "\n"


def _page() -> Iterator[str]:
    yield "# Differences from the paper"
    yield ""
    yield "*Generated from `generation/search/differences_from_paper.py` by `docs/making/differences.py`; do not edit.*"
    yield ""
    yield "What `generate --preset paper --dry-run` and `--preset reference` print: where a preset cannot follow what"
    yield "it is named after, and how open points of the paper are read ([presets](../generation.md#presets))."
    yield from _differences("`paper` and the paper's text", PAPER)
    yield from _differences("`reference` and the public code", REFERENCE)
    readings = ((each.open, each.taken, each.why) for each in INTERPRETATIONS)
    yield from _table("What the text leaves open", ("open", "taken", "tried"), readings)
    yield ""
    yield "*Tried*: kept of the first five vehicles of each of seven recordings, seed 0, 20 network calls a batch."


def _differences(heading: str, found: Sequence[PresetDifference]) -> Iterator[str]:
    rows = ((each.said, each.replacement, each.reason) for each in found)
    return _table(heading, ("source", "here", "because"), rows)


def _table(heading: str, columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield from ("", f"## {heading}", "", f"| {' | '.join(columns)} |", "|---" * len(columns) + "|")
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"


if __name__ == "__main__":
    PAGE.write_text(build_page())
