"""Words behind a command that belong to an option: what to write instead."""

from collections.abc import Collection
from pathlib import Path


def explain_stray_words(words: list[str], options: Collection[str]) -> str:
    """Sentence on words that a command takes none of, and the option among its own that the first one is for."""
    option = _find_option(words[0])
    named = f"; write {option} {words[0]}" if option in options else "; --help lists its options"
    return f"the command takes no argument {' '.join(words)}{named}"


def _find_option(word: str) -> str:
    """Option that takes such a word: a file or folder by its name, a split, a planner, else none."""
    from adapters.models import MODELS
    from adapters.planners.names import installed_planners
    from benchmark.machine.address import is_address
    from benchmark.machine.workspace import is_embedded_name, is_generated

    path = Path(word)
    if is_embedded_name(word) or path.is_dir():
        return "--data"
    if path.suffix in (".csv", ".parquet"):
        return "--plans"
    if path.suffix in (".pkl", ".json"):
        return "--results"
    if word == "val" or is_generated(word):
        return "--split"
    known = {*MODELS, *installed_planners()}
    return "--model" if word.lower() in known or ":" in word or is_address(word) else ""
