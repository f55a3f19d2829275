"""``challenger-bench models``: every planner with what it needs, in 80 columns."""

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from typer.testing import CliRunner

from adapters.checkpoints.cache import Provenance, write_weights
from adapters.models import MODELS, miniatures, published_models
from adapters.planner_listing import known_planners, planners_table, planners_text
from benchmark.cli.app import app
from benchmark.report.cells import RANKS_NOTHING


def test_every_planner_is_there_and_says_what_it_needs(tmp_path: Path) -> None:
    point = EntryPoint("theirs", "their_package.planner:Theirs", "challenger_bench.adapters")
    *own, last = known_planners(tmp_path, {"theirs": point})
    assert last.name == "theirs" and "their_package.planner:Theirs" in planners_table((*own, last)).markdown()
    found = {each.name: each for each in own}
    assert set(found) == {model.name for model in MODELS.values()}
    assert all(each.sees and each.gpu for each in found.values())
    for name in miniatures():
        assert found[name].weights == "packaged" and found[name].miniature and found[name].here
    for name in published_models():
        assert found[name].weights == "missing" and not found[name].here
    assert found["vad-base"].also == ("vad",) and found["uniad-ipopt"].extra == "[uniad]"


def test_what_is_missing_is_told_with_how_to_get_it_in_80_columns(tmp_path: Path) -> None:
    text = planners_text(known_planners(tmp_path, {}), 80)
    assert all(len(line) <= 80 for line in text.splitlines())
    assert all(f"challenger-bench weights fetch {name}" in text for name in published_models())
    words = " ".join(text.split())
    assert "VAD_tiny.pth" in text and "--anchors motion_anchor_infos_mode6.pkl" in words
    assert "licence: not stated for the weights; code MIT" in words
    assert f"{RANKS_NOTHING}" in words and "vad is short for vad-base" in words
    provenance = Provenance(
        model="vad-tiny",
        source="VAD_tiny.pth",
        source_sha256="0" * 64,
        normalisation="bgr-mean",
        normalisation_from="publication",
        licence="a licence",
        number_types=("float32",),
        tool="0",
    )
    write_weights(tmp_path / "vad-tiny.safetensors", {}, provenance)
    found = known_planners(tmp_path, {})
    assert next(each.weights for each in found if each.name == "vad-tiny") == "imported"
    text = planners_text(found, 80)
    assert "weights fetch vad-tiny" not in text and "weights fetch vad-base" in text


def test_the_command_prints_it_and_json_has_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path))
    assert "constant-velocity" in CliRunner().invoke(app, ["models"]).stdout
    rows = json.loads(CliRunner().invoke(app, ["models", "--json"]).stdout)
    assert {row["name"] for row in rows} >= {model.name for model in MODELS.values()}
    assert {row["weights"] for row in rows} >= {"packaged", "missing", "none needed"}
