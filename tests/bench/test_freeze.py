"""The freeze: two trees that do the same are equal, differences are found, and every command is in the table."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bench.freeze import differences
from bench.freezing.cases import CASES, NOT_FROZEN, left_out
from bench.freezing.numbers import numbers_in
from bench.freezing.tree import PACKAGES
from bench.freezing.walk import walked

ROOT = Path(__file__).resolve().parents[2]


def test_every_command_and_every_choice_has_a_case_or_a_reason() -> None:
    assert not left_out(walked())
    assert all(NOT_FROZEN.values())


def test_a_command_or_choice_without_a_case_is_named() -> None:
    few = [case for case in CASES.values() if case.name not in ("verify-pdm", "drive-neuroncap", "quality")]
    assert left_out(walked(), few) == [
        "no case has quality",
        "no case has verify pdm",
        "no case has --engine neuroncap@code",
        "no case has --engine neuroncap@paper",
    ]
    assert "serve is no command, or a case has it" not in left_out(walked())


def said(code: int = 0, head: str = "drawn", rate: float = 0.5, key: str = "rate", file: str = "a.csv") -> str:
    return f"exit code {code}\n" + json.dumps({key: rate, "says": f"{head} in 3 scenes: {file}"}) + f"\n{head} 4 of 5\n"


def test_numbers_leave_sentences_out_and_nothing_else() -> None:
    same = numbers_in(said())
    assert numbers_in(said(head="shown to nobody")) == same
    for other in (said(code=1), said(rate=0.25), said(key="share"), said(file="b.csv")):
        assert numbers_in(other) != same
    assert numbers_in(said().replace("4 of 5", "4 of 6")) != same
    assert numbers_in('{"a": [1, null]}\n{"a": [true]}\n') != numbers_in('{"a": [1, null]}\n{"a": [false]}\n')
    assert numbers_in("| idm | 1.5e-3 |") == numbers_in("| IDM, | 1.5e-3 |") != numbers_in("| idm | 1.6e-3 |")


@pytest.mark.parametrize("numbers", [False, True])
def test_what_differs_is_named(numbers: bool) -> None:
    def of(text: str) -> dict[str, dict[str, list[str]]]:
        return {"case": {"eval": [text, numbers_in(text)]}}

    assert differences(of(said()), of(said()), numbers=numbers) == []
    assert differences(of(said()), of(said(rate=0.25)), numbers=numbers) == ["case"]
    more = {"case": {**of(said())["case"], "other.json": ["a", "a"]}}
    assert differences(of(said()), more, numbers=numbers) == ["case"]
    assert differences(of(said()), of(said(head="shown")), numbers=numbers) == ([] if numbers else ["case"])


def commit(tree: Path) -> None:
    for command in (("init", "-q"), ("add", "-A"), ("-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a")):
        subprocess.run(["git", *command], cwd=tree, check=True)


@pytest.mark.slow
def test_two_cases_of_a_changed_tree(tmp_path: Path) -> None:
    start = tmp_path / "start"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, start / package, ignore=shutil.ignore_patterns("__pycache__"))
    rules = start / "benchmark/extensions/challenge/rules.py"
    rules.write_text(rules.read_text().replace("no contact", "never a contact"))
    commit(start)

    def frozen(*cases: str, numbers: bool) -> subprocess.CompletedProcess[str]:
        places = ["--start", str(start), "--golden", str(tmp_path / "none")]
        command = [sys.executable, str(ROOT / "bench/freeze.py"), *places, "--only", *cases]
        command += ["--numbers"] if numbers else []
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = frozen("challenge-rules", "verify-results", numbers=False)
    assert done.returncode == 1 and "equal    verify-results" in done.stdout, done.stdout + done.stderr
    assert "differs  challenge-rules" in done.stdout and "never a contact" in done.stdout
    assert frozen("challenge-rules", numbers=True).returncode == 0
