"""The generated reference is what the code says now, and describes every field."""

import runpy
from pathlib import Path

from tests.whole_product import needs_extensions

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = runpy.run_path(str(ROOT / "docs" / "making" / "reference.py"))


@needs_extensions
def test_the_pages_of_the_reference_are_current() -> None:
    folder = ROOT / "docs" / "reference"
    pages = REFERENCE["reference_pages"]()
    stale = [name for name, text in pages.items() if (folder / name).read_text() != text]
    assert not stale, "run python docs/making/reference.py"
    assert all(REFERENCE["GENERATED"] in text.splitlines()[:3] for text in pages.values())


def test_every_field_of_a_file_is_described_where_it_is_declared() -> None:
    assert not REFERENCE["missing_descriptions"](), "add a line to the section Attributes of the class"
