"""`challenger-bench verify hub`: the rules of files for hubs, against what the hub's client and a schema say."""

from pathlib import Path, PurePosixPath
from typing import Final

from benchmark.errors import InputError
from benchmark.extensions.cards.every_eval_ever import check_document
from benchmark.extensions.cards.hub_results import check_entries
from benchmark.untrusted.text_files import read_json, read_yaml
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet

_EXPECTED: Final = "expected.json"


def _compare(comparison: Comparison, golden: GoldenFolder) -> None:
    """Files of one kind, by the folder that each lies in: ``valid`` ones are accepted, all others refused."""
    stored = golden.facts(_EXPECTED)
    is_hub = "huggingface_hub" in stored
    for name, expected in sorted(stored["files"].items()):
        place = PurePosixPath(name)
        if place.is_absolute() or ".." in place.parts or not (golden.path / place).is_file():
            raise ValueError(f"{name} is not in it")
        valid = place.parts[0] == "valid"
        if is_hub:
            entries = _read_entries(golden.path / place)
            accepted = entries is not None
            if valid:
                same = [str(value) for *_, value in entries or ()] == [
                    str(float(value)) for value in expected["values"]
                ]
                comparison.verdicts("values of valid files", not same, where=name)
        else:
            accepted = _is_document(golden.path / place)
        verdict = "accepted" if valid else "refused"
        comparison.verdicts(f"{place.parts[0]} files {verdict}", accepted != valid, where=name)


def _read_entries(path: Path) -> list[tuple[str, str, float]] | None:
    try:
        return check_entries(read_yaml(path))
    except (InputError, ValueError):
        return None


def _is_document(path: Path) -> bool:
    try:
        check_document(read_json(path))
    except (InputError, ValueError):
        return False
    return True


GOLDEN: Final = GoldenSet(
    name="hub",
    files=(_EXPECTED,),
    compare=(_compare,),
    holds="files of results that are valid and invalid",
)
