"""Pages about the project that a list or the code must agree with: limits of foreign files, studies."""

import re
import runpy
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_page_of_limits_is_current() -> None:
    made = runpy.run_path(str(DOCS / "making" / "limits.py"))
    assert made["PAGE"].read_text() == made["build_page"](), "run python docs/making/limits.py"


def test_the_list_of_studies_has_one_short_row_for_each() -> None:
    folder = DOCS / "studies"
    rows = re.findall(r"^\| \[[^\]]+\]\(([\w-]+)\.md\) \| (.+) \|$", (folder / "README.md").read_text(), re.MULTILINE)
    assert sorted(name for name, _ in rows) == sorted({path.stem for path in folder.glob("*.md")} - {"README"})
    for name, conclusion in rows:
        assert 0 < len(conclusion.split()) <= 20, name
