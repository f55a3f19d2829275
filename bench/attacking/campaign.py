"""The campaign: which variant has which number, what became of each, and a list that is gone on with."""

import importlib
import json
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from typing import Final

from bench.attacking.children import CommandOutcome, run_command
from bench.attacking.targets import TARGETS, NamedVariant, Target, replace_content
from bench.attacking.valid import make_valid
from bench.attacking.verdicts import FINE, Verdict, verdict
from benchmark.errors import InputError
from tests.benchmark.untrusted.mutations import FORMS

RESULTS: Final = "results-{seed}.jsonl"
_SHOWN: Final = 400
_IMPORTED: Final = (
    "adapters.plan_file", "adapters.registry", "adapters.result_files.planner", "benchmark.cli.app",
    "benchmark.datasets.schema", "benchmark.runs.rescoring", "generation.pipeline.split",
    "generation.diffusion.checkpoint", "generation.render.pictures", "generation.sources.importing",
    "leaderboard.build", "nuscenes.map_expansion.map_api", "nuscenes.nuscenes", "pandas", "torch._dynamo",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a variant, as it is kept.

    Attributes:
        number: Of the attack.
        kind: Row of the table.
        command: What was attacked.
        name: How, and in which file.
        verdict: One of `Verdict`.
        code: Exit code.
        cpu_s: Processor time.
        wall_s: Time on the wall.
        peak_mb: Largest memory in use.
        said: Last words on standard error.
    """

    number: int
    kind: str
    command: str
    name: str
    verdict: str
    code: int
    cpu_s: float
    wall_s: float
    peak_mb: int
    said: str

    @classmethod
    def of(cls, number: int, kind: str, command: str, name: str, found: Verdict, ended: CommandOutcome) -> "Result":
        """That of a command that ended."""
        measured = round(ended.cpu_s, 2), round(ended.wall_s, 2), ended.peak_bytes >> 20
        message = "\n".join(ended.err.strip().splitlines()[-3:])[-_SHOWN:]
        return cls(number, kind, command, name, found.value, ended.code, *measured, message)


class Attempts:
    """What is tried of one seed, by number, below a folder with valid files; run by `run_campaign`.

    Attributes:
        folder: It.
        seed: Says with a number what is tried.
        valid: Folder of the valid files.
        results: Name of the list of results.
    """

    def __init__(self, folder: Path, seed: int, results: str) -> None:
        self.folder, self.seed, self.results = folder.resolve(), seed, results.format(seed=seed)
        preload()
        self.valid = make_valid(self.folder)

    def kinds(self, count: int) -> list[str]:
        """The kind of each number; of so many at least, if there are."""
        raise NotImplementedError

    def run(self, number: int) -> Result:
        """Try one, and say what became of it; leaves nothing behind."""
        raise NotImplementedError


class Campaign(Attempts):
    """Attacks on files, and what the commands find in those that are valid."""

    def __init__(self, folder: Path, seed: int, targets: tuple[Target, ...] = TARGETS) -> None:
        super().__init__(folder, seed, RESULTS)
        self.compute_targets = targets
        self.numbers: dict[str, str] = {}

    def kinds(self, count: int) -> list[str]:
        """Every target in turn."""
        return [target.kind for target in self.compute_targets] * count

    def attack(self, number: int) -> tuple[Target, str, NamedVariant]:
        """What is attacked, which file of it, and how: what somebody thought of and what chance does in turn."""
        target = self.compute_targets[number % len(self.compute_targets)]
        turn = number // len(self.compute_targets)
        chance = Random(f"{self.seed}/{number}")
        file = self._file(target, chance)
        # All of the named ones come, in an order of the seed.
        order = Random(f"{self.seed}/{target.name}").sample(target.named, len(target.named))
        if turn % 2 == 0 and turn // 2 < len(order):
            return target, file, order[turn // 2]
        mutation = chance.choice(FORMS[target.form])

        def change(_: Path, attacked: Path) -> None:
            replace_content(attacked, mutation.change(attacked.read_bytes(), chance))

        name = f"{mutation.name} in {file or target.copied}"
        return target, file, NamedVariant(name, change, mutation.may_be_valid or target.other_files)

    def _file(self, target: Target, chance: Random) -> str:
        if not target.files:
            return ""
        whole = self.valid / target.copied
        files = sorted(whole.glob(chance.choice(target.files)))
        return chance.choice(files).relative_to(whole).as_posix()

    def run(self, number: int) -> Result:
        """Make a variant, give it to its command, and say what became of it; leaves nothing behind."""
        target, file, variant = self.attack(number)
        case = self.folder / f"case-{self.seed}-{number}"
        copy = self.copied(target, case)
        before = listing(copy)
        variant.change(copy, copy / file if file else copy)
        changed = listing(copy)
        if changed == before:
            outcome, ended = Verdict.UNCHANGED, CommandOutcome(0, "", "", 0.0, 0.0, 1.0, 0)
        else:
            ended = self._ended(target, case)
            places, valid_numbers = (copy, self.valid), "" if ended.code else self._valid_numbers(target)
            outcome = verdict(target, ended, valid_numbers, case / "out", places, may_be_valid=variant.may_be_valid)
            if outcome in FINE and listing(copy) != changed and not (target.rewrites and ended.code == 0):
                outcome = Verdict.WROTE
        shutil.rmtree(case)
        return Result.of(number, target.kind, target.command, variant.name, outcome, ended)

    def copied(self, target: Target, case: Path) -> Path:
        """A copy of the valid input, in a folder of its own."""
        shutil.rmtree(case, ignore_errors=True)
        case.mkdir(parents=True)
        valid, given = self.valid / target.copied, case / target.copied
        (shutil.copytree if valid.is_dir() else shutil.copy)(valid, given)
        return given

    def _ended(self, target: Target, case: Path) -> CommandOutcome:
        places = {"in": case / target.copied, "valid": self.valid, "out": case / "out"}
        return run_command([argument.format(**places) for argument in target.arguments], case)

    def _valid_numbers(self, target: Target) -> str:
        """What a command finds in the valid input; empty where it refuses it, as weights of a made-up model."""
        if target.name not in self.numbers:
            case = self.folder / f"case-{self.seed}-valid"
            self.copied(target, case)
            ended = self._ended(target, case)
            if ended.code not in (0, 2) or "Traceback" in ended.err:
                raise InputError(f"{target.name} fails on what is valid: {ended.err.strip()[-_SHOWN:]}; mend it first")
            self.numbers[target.name] = target.numbers(ended, case / "out") if ended.code == 0 else ""
            shutil.rmtree(case)
        return self.numbers[target.name]


def listing(given: Path) -> list[tuple[str, int, int]]:
    """Every file of an input with size and time of change."""
    files = sorted(path for path in given.rglob("*") if path.is_file()) if given.is_dir() else [given]
    return [(str(path), path.lstat().st_size, path.lstat().st_mtime_ns) for path in files if path.is_file()]


def preload() -> None:
    """Import what commands import, once: every child is a copy of this process."""
    for name in _IMPORTED:
        importlib.import_module(name)


def known_results(path: Path) -> dict[int, Result]:
    """Results of an earlier command; a last line that was cut off is left out."""
    results: dict[int, Result] = {}
    if path.is_file():
        for line in path.read_text().splitlines():
            try:
                result = Result(**json.loads(line))
            except (ValueError, TypeError):
                continue
            results[result.number] = result
    return results


def run_campaign(campaign: Attempts, numbers: Iterable[int], *, again: bool = False) -> Iterator[Result]:
    """Run attacks, and keep what became of them below the campaign's folder.

    Args:
        campaign: The attacks.
        numbers: Which ones.
        again: Whether also those that have a result.

    Yields:
        A result for each, kept ones included.
    """
    path = campaign.folder / campaign.results
    known = {} if again else known_results(path)
    began = time.monotonic()
    for done, number in enumerate(numbers):
        if number not in known:
            known[number] = campaign.run(number)
            with path.open("a") as stream:
                stream.write(json.dumps(asdict(known[number])) + "\n")
        if sys.stderr.isatty():
            print(f"\r{done + 1} variants, {time.monotonic() - began:.0f} s", end="", file=sys.stderr, flush=True)
        yield known[number]
