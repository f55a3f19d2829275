"""The comparison of readers with an exported root, without the packages."""

import json
import sys
from pathlib import Path

import pytest

from bench import clients
from bench.clients import Client, count_root, main, read_root
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.extensions.exchange.borrowed_names import export_nuscenes
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

PYTHON = Path(sys.executable)
COUNTS = {"scenes": 1, "frames": 2, "boxes": 6, "agents": 4, "maps": 4}
"""Of a scene of a second with three cars."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    write_root(tmp_path_factory.mktemp("recorded") / "root", [short_scene(seconds=1.0)])
    return next(tmp_path_factory.getbasetemp().glob("recorded*/root"))


def client(program: str) -> Client:
    return Client("a-reader", ("a-package==1.*",), program)


def test_counts_are_those_of_the_tables(root: Path, tmp_path: Path) -> None:
    data = NuScenesData.open(root)
    (exported,) = export_nuscenes(data, data.scene_names(), tmp_path / "to")
    assert count_root(exported.folder) == COUNTS


def test_a_reader_answers_last_or_its_error_is_told(tmp_path: Path) -> None:
    program = "import json, sys; print('loading'); print(json.dumps({'scenes': len(sys.argv) - 2}))"
    assert read_root(PYTHON, client(program), tmp_path) == {"scenes": 4}
    assert read_root(PYTHON, client("raise KeyError('scene-9901')"), tmp_path) == "KeyError: 'scene-9901'"
    assert read_root(PYTHON, client("raise SystemExit(3)"), tmp_path) == "exit code 3"


@pytest.mark.parametrize(("frames", "code"), [(2, 0), (3, 1)])
def test_a_number_that_differs_is_an_exit_code(
    root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    frames: int,
    code: int,
) -> None:
    found = json.dumps({"scenes": 1, "frames": frames})
    monkeypatch.setattr(clients, "CLIENTS", (client(f"import sys; assert 'to' in sys.argv[1]; print('''{found}''')"),))
    monkeypatch.setattr(clients, "make_environment", lambda *_: PYTHON)
    assert main(["--data", str(root), "--split", "val", "--folder", str(tmp_path / "to")]) == code
    told = capsys.readouterr().out
    assert "a-reader" in told and "AssertionError" in told
    assert main(["--data", str(root), "--split", "val", "--folder", str(root.parent)]) == 2
