"""What ``challenger-bench reproduce`` prints: published numbers beside ours, and the verdict on each."""

from typing import Final

from benchmark.records.reproduction import UNITS, ComparedNumber, Reproduction
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table, table_of

_NAMES: Final = {"collision": "collision (%)", "l2": "L2 (m)", "samples": "samples"}


def reproduction_table(found: Reproduction) -> Table:
    """One row for each number."""
    sources = list(dict.fromkeys(number.source for number in found.numbers))
    rows = [_row(number, sources.index(number.source) + 1) for number in found.numbers]
    wrong = sum(not number.ok for number in found.numbers)
    verdict = "reproduced" if found.reproduced else f"not reproduced: {wrong} of {len(rows)} numbers differ"
    return table_of(
        f"reproduction-{found.planner.name}",
        f"{found.planner.name} on {found.data.name}, {found.split}, protocol {found.protocol} (version "
        f"{found.version}): {found.of}",
        ("", "number", "at", "expected", "ours", "difference", "allowed", "from"),
        rows,
        notes=(*(f"{place}: {source}." for place, source in enumerate(sources, 1)), f"Verdict: {verdict}."),
        text_columns=3,
    )


def _row(number: ComparedNumber, source: int) -> tuple[str, ...]:
    digits = 0 if number.column == "samples" else 3
    ours = UNDEFINED if number.ours is None else f"{number.ours:.{digits}f}"
    # Adding zero makes minus zero zero.
    apart = UNDEFINED if number.difference is None else f"{round(number.difference, digits) + 0.0:+.{digits}f}"
    allowed = f"{number.allowed:g}" if UNITS[number.column] else "none"
    return (
        "ok" if number.ok else "FAIL",
        _NAMES[number.column],
        number.horizon,
        f"{number.published:.{digits}f}",
        ours,
        apart,
        allowed,
        str(source),
    )
