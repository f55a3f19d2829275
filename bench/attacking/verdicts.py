"""What became of a variant: answered, harmless, other input, or one of the ways to fall."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Final

from bench.attacking.children import HANG_S, MEMORY_BYTES, CommandOutcome
from bench.attacking.targets import Target

_LONGEST_SENTENCE: Final = 1200
_BEFORE: Final = re.compile(
    r"warning: |splits? [\w ,-]+(; the default is |, the default; )|[\w .-]+: \d+ of \d+ "
    r"|the model server at \S+ (is gone|returns plans with)\b"
)


class Verdict(StrEnum):
    """Outcomes; the first four are fine."""

    ANSWERED = "answered"
    SAME = "same numbers"
    OTHER_INPUT = "other input, other numbers"
    UNCHANGED = "unchanged"
    TRACEBACK = "traceback"
    HANG = "hang over 20 s"
    MEMORY = "over 2 GB"
    DEATH = "death"
    WROTE = "wrote something"
    UNCLEAR = "unclear answer"
    SILENT = "silently other numbers"


FINE: Final = (Verdict.ANSWERED, Verdict.SAME, Verdict.OTHER_INPUT, Verdict.UNCHANGED)
FALLEN: Final = tuple(each for each in Verdict if each not in FINE)


def fall(ended: CommandOutcome) -> Verdict | None:
    """How a command fell, whatever it was given; ``None`` where it ended by itself, within its limits."""
    if ended.peak_bytes > MEMORY_BYTES:
        return Verdict.MEMORY
    if ended.cpu_s > HANG_S or ended.wall_s > ended.patience_s:
        return Verdict.HANG
    if ended.code < 0:
        return Verdict.DEATH
    return Verdict.TRACEBACK if "Traceback (most recent call last)" in ended.err else None


def verdict(
    target: Target,
    ended: CommandOutcome,
    valid_numbers: str,
    out: Path,
    places: tuple[Path, ...],
    *,
    may_be_valid: bool,
) -> Verdict:
    """Classify what became of a file.

    Args:
        target: What was attacked.
        ended: How the command ended.
        valid_numbers: What it finds in the valid input; empty where it refuses that too.
        out: Folder that the command might write to; nothing is in it before.
        places: Paths of which a refusal must name one.
        may_be_valid: Whether the variant may be a valid input with a content of its own.

    Returns:
        The worst that can be said.
    """
    if (fallen := fall(ended)) is not None:
        return fallen
    if ended.code == 0:
        return _accepted(target, ended, valid_numbers, out, may_be_valid=may_be_valid)
    if not target.keeps_work and any(path.is_file() for path in out.rglob("*")):
        if f"{out}/" not in ended.err:
            return Verdict.WROTE
        # A search that found nothing, as it might with other weights, and names the file that says why.
        return Verdict.OTHER_INPUT if may_be_valid else Verdict.SILENT
    if ended.code == 1 and target.lists_faults:
        return Verdict.ANSWERED if is_fault_list(ended.out, places) else Verdict.UNCLEAR
    return Verdict.ANSWERED if ended.code == 2 and is_one_sentence(ended.err, places) else Verdict.UNCLEAR


def _accepted(target: Target, ended: CommandOutcome, valid_numbers: str, out: Path, *, may_be_valid: bool) -> Verdict:
    try:
        numbers = target.numbers(ended, out)
    except ValueError:
        return Verdict.UNCLEAR
    if numbers == valid_numbers:
        return Verdict.SAME
    if target.lists_faults and "warning: " in ended.out:
        return Verdict.ANSWERED
    return Verdict.OTHER_INPUT if may_be_valid else Verdict.SILENT


def door_verdict(ended: CommandOutcome, out: Path, *, keeps_work: bool = False) -> Verdict:
    """Classify what became of a command line: 0 is fine, 1 is spoken of, 2 a sentence and nothing written.

    Args:
        ended: How the command ended.
        out: Folder that it might write to; nothing was in it before.
        keeps_work: Whether what is written there may be finished work.

    Returns:
        The worst that can be said.
    """
    if (fallen := fall(ended)) is not None:
        return fallen
    if ended.code == 0:
        return Verdict.OTHER_INPUT
    if ended.code == 1:
        return Verdict.ANSWERED if (ended.out + ended.err).strip() else Verdict.UNCLEAR
    if ended.code != 2 or not is_sentence(ended.err):
        return Verdict.UNCLEAR
    wrote = any(path.is_file() for path in out.rglob("*"))
    return Verdict.WROTE if wrote and not keeps_work and f"{out}/" not in ended.err else Verdict.ANSWERED


def is_fault_list(said: str, places: tuple[Path, ...]) -> bool:
    """Whether faults are printable lines that name the input, or quantities that differ."""
    names_it = any(str(place) in said for place in places) or "FAIL" in said
    return all(map(str.isprintable, said.splitlines())) and names_it


def is_one_sentence(said: str, places: tuple[Path, ...]) -> bool:
    """Whether a refusal is one printable sentence that names a path; warnings and progress may come before it."""
    return is_sentence(said) and any(str(place) in said.splitlines()[-1] for place in places)


def is_sentence(said: str) -> bool:
    """Whether a refusal is one printable sentence; warnings and progress may come before it."""
    *before, last = said.splitlines() or [""]
    if not all(map(_BEFORE.match, before)) or not said.endswith("\n"):
        return False
    return last.startswith("error: ") and len(last) <= _LONGEST_SENTENCE and last.isprintable()
