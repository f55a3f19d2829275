"""The head of a card as hubs read it: YAML between lines of dashes. JSON values are YAML, so no package is needed."""

import json
from collections.abc import Mapping
from typing import Any, Final

_SIZES: Final = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def front_matter(fields: Mapping[str, Any]) -> str:
    """Front matter of a card, dashes included, in the given order; fields that are ``None`` or empty are left out."""
    lines = [
        f"{name}: {json.dumps(value, ensure_ascii=False, allow_nan=False)}"
        for name, value in fields.items()
        if value not in (None, "", [], {})
    ]
    return "\n".join(["---", *lines, "---", ""])


def size_category(rows: int) -> str:
    """Size category in which hubs put a number of rows."""
    return next((name for most, name in _SIZES if rows < most), "n>1M")
