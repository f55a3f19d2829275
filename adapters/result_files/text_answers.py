"""Answers of language models: OmniDrive, OpenDriveVLA, GPT-Driver; what cannot be read is skipped and said."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.result_files.contract import ROUNDED, FileFrame, FilePlans, ResultFormat, find_rows, read_numbers, refuse
from adapters.result_files.samples import RecordedSamples
from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.untrusted.files import to_one_line

SUFFIX: Final = "_trajectory"
_NUMBER: Final = r"\s*([-+]?(?:\d{1,9}(?:\.\d{0,18})?|\.\d{1,18}))\s*"
_PAIR: Final = re.compile(rf"\({_NUMBER},{_NUMBER}(?:,[^()]*)?\)")
_PLAN: Final = re.compile(r"\[PT\b([^\[\]]*)\]")
_LIST: Final = re.compile(rf"\[(?:\({_NUMBER},{_NUMBER}\),?)+\]")
_SPACE: Final = re.compile(r"\s+")
_LONGEST_ANSWER: Final = 20_000
NO_PLAN: Final = "no trajectory"


def read_omnidrive(path: Path, content: Mapping[str, Any], samples: RecordedSamples) -> FilePlans:
    """Plans of a folder of OmniDrive's answers, in the order of their time.

    `content` is the JSON of each file by its name, which is the token. Samples without a plan of six waypoints are
    skipped, as by its own evaluation.
    """
    rows = find_rows(path, list(content), samples)
    plans: dict[int, Floats] = {}
    skipped = {}
    for row in rows[np.argsort(samples.timestamps_us[rows], kind="stable")].tolist():
        token = samples.tokens[row]
        match = _PLAN.search(_first_answer(path, content[token], token))
        pairs = read_pairs(match[1]) if match else []
        if len(pairs) == PLAN_STEPS:
            plans[row] = np.array(pairs)
        else:
            skipped[token] = _describe_skip(len(pairs)) if match else NO_PLAN
    return _collect_plans(path, FileFrame.EGO, plans, skipped)


def read_conversation(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of OpenDriveVLA's ``plan_conv.json``; short ones are completed as its own reader completes them.

    An answer without any pair is skipped, and of different answers to one question the last one counts.
    """
    answers: dict[str, str] = {}
    duplicates = 0
    for number, line in enumerate(content, start=1):
        name, answer = line.get("id"), line.get("answer")
        answer = answer[0] if isinstance(answer, list) and answer else answer
        if not isinstance(name, str) or not isinstance(answer, str) or len(answer) > _LONGEST_ANSWER:
            refuse(path, "shape", f"line {number} has no id and answer of ordinary length", "make the file again")
        token = name.removesuffix(SUFFIX)
        duplicates += token in answers
        answers[token] = answer
    rows = find_rows(path, list(answers), samples)
    plans: dict[int, Floats] = {}
    skipped, repaired = {}, 0
    for row, (token, text) in zip(rows.tolist(), answers.items()):
        pairs = read_pairs(text)
        if not pairs:
            skipped[token] = NO_PLAN
            continue
        repaired += len(pairs) != PLAN_STEPS
        plans[row] = np.array([*pairs, *[pairs[-1]] * PLAN_STEPS][:PLAN_STEPS])
    return _collect_plans(path, FileFrame.LIDAR, plans, skipped, duplicates=duplicates, repaired=repaired)


def read_modes(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of OpenDriveVLA's dictionaries: the first mode."""
    rows = find_rows(path, [name.removesuffix(SUFFIX) for name in content], samples)
    plans = {}
    for row, (name, modes) in zip(rows.tolist(), content.items()):
        first = modes[0] if isinstance(modes, list) and modes else None
        plans[row] = read_numbers(path, first, f"the first mode of {name}", (PLAN_STEPS, 2))
    return _collect_plans(path, FileFrame.LIDAR, plans, {})


def read_gptdriver(path: Path, content: Any, samples: RecordedSamples) -> FilePlans:
    """Plans of GPT-Driver's texts: the last line of each. A last line that is no list of six pairs is skipped."""
    rows = find_rows(path, list(content), samples)
    plans: dict[int, Floats] = {}
    skipped = {}
    for row, (token, text) in zip(rows.tolist(), content.items()):
        if not isinstance(text, str) or len(text) > _LONGEST_ANSWER:
            refuse(path, "shape", f"the answer of sample {token} is not an ordinary text", "make the file again")
        last = _SPACE.sub("", (text.strip().splitlines() or [""])[-1])
        pairs = read_pairs(last) if _LIST.fullmatch(last) else []
        if len(pairs) == PLAN_STEPS:
            plans[row] = np.array(pairs)
        else:
            skipped[token] = _describe_skip(len(pairs)) if pairs else NO_PLAN
    return _collect_plans(path, FileFrame.LIDAR, plans, skipped)


def read_pairs(text: str) -> list[tuple[float, float]]:
    """Every pair of numbers in parentheses; further numbers of one are left out."""
    return [(float(x), float(y)) for x, y in _PAIR.findall(text)]


def _describe_skip(count: int) -> str:
    return f"{count} waypoints"


def _first_answer(path: Path, held: Any, token: str) -> str:
    first = held[0] if isinstance(held, list) and held else None
    answer = first.get("A") if isinstance(first, dict) and "Q" in first else None
    answer = answer[0] if isinstance(answer, list) and answer else answer
    if not isinstance(answer, str):
        refuse(path, "shape", f"file {to_one_line(token, 64)} is not a list of questions and answers", "make it again")
    return answer


def _collect_plans(
    path: Path,
    frame: FileFrame,
    plans: dict[int, Floats],
    skipped: dict[str, str],
    *,
    duplicates: int = 0,
    repaired: int = 0,
) -> FilePlans:
    if not plans:
        refuse(path, "no_plan", f"none of its {len(skipped)} answers holds a plan", "run the planner again")
    rows = np.array(list(plans), np.int64)
    return FilePlans(
        frame,
        rows,
        np.array(list(plans.values())),
        "tokens",
        "each sample by its token",
        skipped,
        duplicates=duplicates,
        repaired=repaired,
    )


OMNIDRIVE: Final = ResultFormat("omnidrive", "OmniDrive (a folder)", "omnidrive", read_omnidrive, ROUNDED)
CONVERSATION: Final = ResultFormat(
    "opendrivevla-conversation", "OpenDriveVLA (plan_conv.json)", "opendrivevla", read_conversation, ROUNDED
)
MODES: Final = ResultFormat("opendrivevla", "OpenDriveVLA (pred_trajs_dict.json)", "opendrivevla", read_modes, ROUNDED)
GPTDRIVER: Final = ResultFormat("gptdriver-text", "GPT-Driver (the answers)", "agent-driver", read_gptdriver, ROUNDED)
