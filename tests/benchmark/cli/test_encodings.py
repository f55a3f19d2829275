"""Commands on terminals that cannot show all of their text: it is replaced, never the end of the command."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.cli.app import replace_unencodable_characters
from benchmark.report.cells import MINIATURE_MARK
from leaderboard.frame import rows
from tests.benchmark.edited_roots import small_town

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town"))


def test_eval_prints_its_table(town: Path, tmp_path: Path) -> None:
    models = ("--model", "constant-velocity", "--model", "idm")
    on = ("--data", str(town), "--out", str(tmp_path), "--workers", "1")
    command = [sys.executable, "-m", "benchmark", "eval", *models, *on]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONIOENCODING": "ascii"}, capture_output=True, check=False
    )
    assert done.returncode == 0 and b"Traceback" not in done.stderr, done.stderr.decode()
    assert b"constant-velocity" in done.stdout


def test_every_mark_of_a_table_is_replaced_by_another_character(monkeypatch: pytest.MonkeyPatch) -> None:
    marks = rows.PRIVILEGED_MARK, rows.STALE_MARK, rows.REPRODUCED_MARK, rows.CAVEAT_MARK, MINIATURE_MARK
    out = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(out, "ascii", write_through=True))
    replace_unencodable_characters()
    sys.stdout.write("".join(marks))
    assert len(set(out.getvalue())) == len(marks)
    out.seek(0)
    sys.stdout.write("a – b × Å ∞ 漢\n")
    assert out.getvalue().decode() == "a - b x A inf ?\n"


@pytest.mark.parametrize("encoding", ["iso8859-15", "gbk"])
def test_no_mark_ends_a_command_in_another_encoding(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(out, encoding, write_through=True))
    replace_unencodable_characters()
    sys.stdout.write("†¶✓█░ é ∞ 漢")
    assert out.getvalue().decode(encoding)
