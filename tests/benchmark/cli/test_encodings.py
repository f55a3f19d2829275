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
ENCODINGS = ("ascii", "iso8859-15", "gbk")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town"))


def printed(encoding: str, *arguments: str | Path) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "benchmark", *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | {"PYTHONIOENCODING": encoding},
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_models_and_eval_print_their_tables(encoding: str, town: Path, tmp_path: Path) -> None:
    on = "--data", town, "--out", tmp_path, "--workers", "1"
    for command in (("models",), ("eval", "--model", "constant-velocity", "--model", "idm", *on)):
        done = printed(encoding, *command)
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
