"""The guide stays short: words in all, lines of a page."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MOST_WORDS = 40_000
MOST_LINES = 250
MOST_LINES_OF_AN_ANSWER = 60
PACKAGES = ("adapters", "benchmark", "generation", "leaderboard")


def written_pages() -> list[Path]:
    """README, docs/ and pages in folders of extensions, without what commands and scripts write."""
    docs = ROOT / "docs"
    pages = [path for path in sorted(docs.rglob("*.md")) if docs / "results" not in path.parents]
    own = [path for package in PACKAGES for path in sorted((ROOT / package / "extensions").rglob("*.md"))]
    return [ROOT / "README.md", *(path for path in pages if not is_generated(path)), *own]


def is_generated(page: Path) -> bool:
    """Whether one of the first lines of a page says so."""
    return any(line.startswith("*Generated ") for line in page.read_text().splitlines()[:5])


def test_the_guide_has_at_most_forty_thousand_words() -> None:
    words = {path.relative_to(ROOT).as_posix(): len(path.read_text().split()) for path in written_pages()}
    longest = sorted(words, key=lambda name: -words[name])[:10]
    assert sum(words.values()) <= MOST_WORDS, (
        f"{sum(words.values())} words are written by hand, {MOST_WORDS} are allowed; the longest pages: "
        f"{', '.join(f'{name} {words[name]}' for name in longest)}"
    )


def test_no_page_is_too_long() -> None:
    lines = {path: len(path.read_text().splitlines()) for path in written_pages()}
    answers = {path for path in lines if path.parent.name in ("how-to", "studies")}
    long = {
        path.relative_to(ROOT).as_posix(): count
        for path, count in lines.items()
        if count > (MOST_LINES_OF_AN_ANSWER if path in answers else MOST_LINES)
    }
    assert not long, f"at most {MOST_LINES} lines, of how-to pages and studies {MOST_LINES_OF_AN_ANSWER}: {long}"


def test_the_generated_reference_is_not_counted() -> None:
    counted = {path.name for path in written_pages()}
    assert "README.md" in counted and "my-checkpoint.md" in counted
    assert not counted & {"formats.md", "protocols.md", "fields.md"}
