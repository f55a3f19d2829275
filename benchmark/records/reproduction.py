"""Whether a planner gave the numbers that are published of it: ``reproduction.json`` in the directory of that run.

It marks other runs of the same version, wherever their records stand: the same weights, the same code, the same
options. A seed is no part of a version, nor is the data set.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from benchmark.machine.storage import content_key, read_json, write_json
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DataFacts, PlannerFacts
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored

REPRODUCTION_FILE: Final = "reproduction.json"
UNITS: Final = {"collision": "%", "l2": "m", "samples": ""}
_NO_OPTIONS: Final = frozenset({"checkpoint"})
"""Settings that are no options: the name of a file, whose hash is beside it."""


class ComparedNumber(Stored):
    """One published number and ours; ``source`` is where the published one stands.

    ``column`` is ``collision`` in per cent, ``l2`` in metres, or ``samples``, how many were counted; ``horizon`` is
    ``1s``, ``2s``, ``3s``, ``avg``, empty for ``samples``. Of several published values it is the nearest to ours, which
    is null where the run has none.

    Attributes:
        published: The published value.
        ours: Ours.
        allowed: Largest difference that counts as equal.
    """

    column: Literal["collision", "l2", "samples"]
    horizon: str
    published: float
    ours: float | None
    allowed: float = Field(ge=0)
    source: str

    @property
    def difference(self) -> float | None:
        """Ours less the published one."""
        return None if self.ours is None else self.ours - self.published

    @property
    def ok(self) -> bool:
        """Whether it is the published number, as far as that is allowed."""
        # A value on the border is inside, despite floating-point noise.
        return self.ours is not None and abs(self.ours - self.published) <= self.allowed * (1 + 1e-9)


class Reproduction(Stored):
    """Outcome of one attempt to reproduce published numbers, of ``of`` in words; ``record`` is the run's content id.

    Attributes:
        planner: Which planner ran.
        data: On which data set.
        split: On which split.
        protocol: Protocol of the numbers.
        version: Of the protocol.
        numbers: Every number beside the published one.
    """

    planner: PlannerFacts
    data: DataFacts
    split: str
    protocol: str
    version: int
    record: str
    of: str
    numbers: list[ComparedNumber]

    @property
    def reproduced(self) -> bool:
        """Whether every number is the published one."""
        return bool(self.numbers) and all(number.ok for number in self.numbers)


def version_key(planner: PlannerFacts) -> str:
    """Key of a planner version: name, weights, code and options."""
    options = {name: value for name, value in planner.settings.items() if name not in _NO_OPTIONS}
    return content_key("version", planner.name, planner.weights_sha256, planner.code_sha256, options)


def write_reproduction(directory: Path, found: Reproduction) -> None:
    """Put it beside the record that it is about; raises `InputError` if the disk refuses."""
    write_json(directory / REPRODUCTION_FILE, found.model_dump(mode="json"))


def find_reproductions(roots: Iterable[Path]) -> list[Reproduction]:
    """Every attempt to reproduce numbers below some folders, which need not exist, in the order of their paths."""
    paths = dict.fromkeys(path for root in roots for path in sorted(root.rglob(REPRODUCTION_FILE)))
    return [_read(path) for path in paths]


def with_reproductions(records: Sequence[RunRecord], found: Iterable[Reproduction]) -> list[RunRecord]:
    """Records that know whether their version of the planner reproduced its published numbers."""
    reproduced: dict[str, str] = {}
    failed = set()
    for reproduction in found:
        key = version_key(reproduction.planner)
        if reproduction.reproduced:
            reproduced[key] = f"{reproduction.of} (on {reproduction.data.name}, {reproduction.split})"
        else:
            failed.add(key)
    # A version must reproduce its numbers everywhere to count as reproduced.
    known = {key: sentence for key, sentence in reproduced.items() if key not in failed}
    return [replace(record, reproduced=known.get(version_key(record.run.planner))) for record in records]


def _read(path: Path) -> Reproduction:
    return validate_stored(
        Reproduction.model_validate,
        read_json(path),
        lambda where, why: (
            f"{path} is not a valid reproduction record: {where or 'the whole file'}: {why}; run challenger-bench "
            "reproduce again or delete it"
        ),
    )
