"""`verify import-123d` on the golden sets, where they lie beside the repository, and that it can fail."""

import json
import shutil
from pathlib import Path

import pytest

from benchmark.errors import InputError
from generation.extensions.logs123d.verification import GOLDEN

SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden" / "123d"


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize("name", ["av2", pytest.param("town", marks=pytest.mark.slow)])
def test_logs_maps_and_roots_agree_with_what_py123d_reads(name: str) -> None:
    checks = GOLDEN.verify(SHARED / name)
    assert not [check for check in checks if not check.ok]
    assert len(checks) > 70 and (name != "town" or any("round trip" in check.quantity for check in checks))


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared material beside the repository")
def test_a_wrong_value_is_found(tmp_path: Path) -> None:
    shutil.copytree(SHARED / "av2" / "logs", tmp_path / "logs")
    expected = json.loads((SHARED / "av2" / "expected.json").read_text())
    (log,) = expected["logs"].values()
    log["frames"][5]["boxes"]["items"][0]["center"][2] += 1e-4
    log["cameras"]["camera.pcam_f0"]["matrix"][0][0] += 1e-4
    (tmp_path / "expected.json").write_text(json.dumps(expected))
    failed = {check.quantity for check in GOLDEN.verify(tmp_path) if not check.ok}
    assert {"boxes: position", "cameras: matrix"} <= failed
    assert failed <= {"boxes: position", "cameras: matrix", "root: annotations: position"}


def test_a_set_without_logs_is_refused(tmp_path: Path) -> None:
    (tmp_path / "expected.json").write_text("{}")
    with pytest.raises(InputError, match="logs"):
        GOLDEN.verify(tmp_path)
