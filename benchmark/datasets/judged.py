"""``judgements.json`` beside the tables: what is said of each scene of a generated root.

It is no part of the data set's fingerprint and can be made from the tracks again: a better definition makes no other
data set. Roots without it are judged when somebody asks (`benchmark.fairness.data_sets`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from benchmark.datasets.tables import variant_folders
from benchmark.machine.storage import canonical_json, read_json
from benchmark.records.judgement import DEFINITION, SceneJudgement, SplitRealism
from benchmark.records.store import validated
from benchmark.records.stored import Stored
from benchmark.untrusted.limits import RECORD

JUDGEMENTS_FILE: Final = "judgements.json"

Judgements = Mapping[str, tuple[SceneJudgement, ...]]
"""By scene name, one for each adversary."""


class JudgementsFile(Stored):
    """The file.

    Attributes:
        schema_version: Version of the format.
        scenes: By scene name, one judgement for each adversary.
        realism: Of all adversaries of the data set together, if somebody looked.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    scenes: dict[str, tuple[SceneJudgement, ...]]
    realism: SplitRealism | None = None


def judgements_text(scenes: Judgements, realism: SplitRealism | None = None) -> str:
    """The content of the file.

    Args:
        scenes: Judgements by scene name.
        realism: Of all adversaries together.

    Returns:
        JSON text, the same for the same judgements.
    """
    said = {name: [each.model_dump(mode="json") for each in judged] for name, judged in scenes.items()}
    told = None if realism is None else realism.model_dump(mode="json")
    return canonical_json({"schema": 1, "scenes": said, "realism": told}) + "\n"


def read_judgements(folder: Path) -> dict[str, tuple[SceneJudgement, ...]]:
    """Read the judgements of one root.

    Args:
        folder: Its version folder.

    Returns:
        Judgements by scene name; none where there is no file, or of scenes that were judged by other definitions.

    Raises:
        InputError: If the file is damaged.
    """
    found = read_judgements_file(folder)
    return {
        name: judged
        for name, judged in (found.scenes if found is not None else {}).items()
        if judged and all(each.definition == DEFINITION for each in judged)
    }


def read_judgements_file(folder: Path) -> JudgementsFile | None:
    """Read the whole file of one root.

    Args:
        folder: Its version folder.

    Returns:
        What it says, or ``None`` where there is none.

    Raises:
        InputError: If it is damaged.
    """
    path = folder / JUDGEMENTS_FILE
    if not path.is_file():
        return None
    return validated(
        JudgementsFile.model_validate,
        read_json(path, RECORD),
        lambda where, why: f"{path} is damaged at {where}: {why}; delete it, and data stats judges the scenes anew",
    )


def stored_judgements(root: Path, version: str) -> dict[str, tuple[SceneJudgement, ...]]:
    """The judgements of a data set that lies in one root or in several.

    Args:
        root: Of the data set.
        version: Version folder.

    Returns:
        Judgements by the names that the data set gives its scenes.

    Raises:
        InputError: If a file is damaged.
    """
    folders = variant_folders(root)
    if not folders:
        return read_judgements(root / version)
    return {
        f"{folder}/{name}": judged
        for folder in folders
        for name, judged in read_judgements(root / folder / version).items()
    }


def stored_realism(root: Path, version: str) -> SplitRealism | None:
    """How real the adversaries of a data set move, as whoever built it found.

    Args:
        root: Of the data set.
        version: Version folder.

    Returns:
        It, or ``None`` where nobody looked.

    Raises:
        InputError: If the file is damaged.
    """
    folders = variant_folders(root)
    # Every variant says the same of all of them.
    found = read_judgements_file((root / folders[0] if folders else root) / version)
    return None if found is None else found.realism
