"""``docs/reference/limits.md``: what a file or a message of others may be at most, from the code.

``python docs/making/limits.py`` writes it anew.
"""

from dataclasses import fields
from pathlib import Path
from typing import Any

from benchmark.untrusted import files
from benchmark.untrusted.files import Limits, format_bytes

PAGE = Path(__file__).resolve().parents[1] / "reference" / "limits.md"
_USUAL: dict[str, Any] = {each.name: each.default for each in fields(Limits)}


def build_page() -> str:
    """The whole page."""
    return f"""# Limits of foreign files

*Generated from `benchmark/untrusted/files.py` by `docs/making/limits.py`; do not edit.*

What a file or a message of others may be at most ([hostile input](../hostile-input.md)). Values are rows, entries,
members of an archive or pixels. An empty cell stands for the usual limit: {_USUAL["values"]:,} values,
{_USUAL["depth"]} containers within containers, {format_bytes(_USUAL["line_bytes"])} in a line and
{format_bytes(_USUAL["content_bytes"])} unpacked. What is read by a child process may cost
{format_bytes(_USUAL["memory_bytes"])} of memory and {_USUAL["cpu_s"]} s of CPU time; a result file more, by its size.

| kind | constant | file | values | depth | line | unpacked |
|---|---|--:|--:|--:|--:|--:|
{"".join(_row(name, limits) for name, limits in vars(files).items() if isinstance(limits, Limits))}"""


def _row(name: str, limits: Limits) -> str:
    unusual = {each: value for each, usual in _USUAL.items() if (value := getattr(limits, each)) != usual}
    sizes = {each: format_bytes(value) for each, value in unusual.items() if each.endswith("_bytes")}
    values = f"{unusual['values']:,}" if "values" in unusual else ""
    cells = (
        *(limits.what, f"`{name}`", sizes["file_bytes"], values, str(unusual.get("depth", ""))),
        *(sizes.get(each, "") for each in ("line_bytes", "content_bytes")),
    )
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    PAGE.write_text(build_page())
