"""The golden set beside this repository, if it is there; and what the verification finds in a set that is changed."""

import json
import shutil
from pathlib import Path

import pytest

from adapters.extensions.golden_sets.result_files import GOLDEN as RESULTS
from adapters.result_files.writing.formats import WRITERS
from adapters.result_files.writing.pickles import write_pickle
from benchmark.errors import InputError
from tests.benchmark.cli.cli_runs import refusal

GOLDEN = Path(__file__).resolve().parents[5] / "shared" / "golden" / "result_files"
needs_golden = pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden set is not here")


def test_the_built_in_set_agrees() -> None:
    checks = RESULTS.verify()
    assert len(checks) == 2 + len(WRITERS) and all(check.ok for check in checks), checks


@needs_golden
def test_every_file_gives_what_it_must() -> None:
    checks = RESULTS.verify(GOLDEN)
    assert len(checks) > 25
    assert [check for check in checks if not check.ok] == []
    refusals = next(check for check in checks if check.quantity == "refusals by category")
    assert refusals.count >= 20
    assert sum(check.count for check in checks if check.quantity == "uniad obj_box_col") > 5000


@needs_golden
def test_a_changed_set_does_not_agree_and_without_objects_the_rest_is_compared(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(GOLDEN, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    kept = {entry["name"]: entry for entry in manifest["files"]}
    kept["law_out"]["category"], kept["law_out"]["also_ok"] = "frame", []
    kept["agentdriver_numpy2"]["order"] = "proven"
    manifest["files"] = [kept[name] for name in ("law_out", "agentdriver_numpy2", "gptdriver_traj")]
    (folder / "manifest.json").chmod(0o644)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    checks = {check.quantity: check for check in RESULTS.verify(folder)}
    assert {name for name, check in checks.items() if not check.ok} == {"orders", "refusals by category"}
    assert "law_out, refused as no_plan" in checks["refusals by category"].note
    assert "no verdicts on scene-0553" in checks["commands of samples"].note


def test_what_is_no_set_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert "no facts.npz" in refusal("verify", "results", "--golden", tmp_path / "empty")
    write_pickle(tmp_path / "x", 1)
    with pytest.raises(InputError):
        RESULTS.verify(tmp_path / "x")
