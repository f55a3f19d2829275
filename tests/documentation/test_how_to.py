"""Modules that how-to pages print work as they stand there."""

import re
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch

import benchmark
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from benchmark.datasets.roots import DataSet
from benchmark.machine.extension import import_reference
from benchmark.protocols.exact import ExactProtocol
from generation.sources.mini import TownSettings
from tests.benchmark.cli.cli_runs import run_main

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "how-to"


def printed(page: str) -> dict[str, str]:
    """Modules that a page prints, by the name in their first line."""
    blocks = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", (FOLDER / page).read_text(), re.DOTALL)
    return dict(blocks)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = TownSettings(val_scenes=1, width=96, height=54, frames="keyframes", version=1)
    data: DataSet = benchmark.open_data(
        benchmark.build_town(tmp_path_factory.mktemp("how-to") / "town", settings, workers=1)
    )
    return Path(data.root)


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Writes a module into the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(name: str, text: str) -> None:
        (tmp_path / name).write_text(text)

    return write


NET = """
import torch


class Net(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.steps = torch.nn.Parameter(torch.zeros(6))

    def forward(self, image):
        return torch.stack([self.steps + 0.0 * image.float().mean(), torch.zeros(6)], 1)
"""


def test_checkpoints_of_another_architecture_are_evaluated(town: Path, desk: Callable[[str, str], None]) -> None:
    modules = printed("my-checkpoint.md")
    own = "replace(VADConfig.base(), bev_rows=150, bev_columns=150)"
    small = "replace(VADConfig.miniature(), bev_rows=16, rotation_centre=(12.0, 8.0))"
    assert own in modules["my_vad.py"], "the page changes sizes of a published network"
    desk("my_vad.py", modules["my_vad.py"].replace(own, small))
    desk("my_net.py", modules["my_net.py"])
    network = VAD(replace(VADConfig.miniature(), bev_rows=16, rotation_centre=(12.0, 8.0)))
    torch.save({"state_dict": network.state_dict()}, "my_vad.pth")
    desk("my_model.py", NET)
    torch.save({"steps": torch.arange(1.0, 7.0)}, "my_net.pt")
    torch.save({"state_dict": VAD(VADConfig.miniature()).state_dict()}, "other.pth")
    for model, file in (("my_vad:MyVAD", "my_vad.pth"), ("my_net:MyNet", "my_net.pt")):
        said = run_main("eval", "--data", town, "--split", "val", "--model", model, "--checkpoint", file, "--json")
        assert said.code == 0, said.err
        assert said.json[0]["failed"] == 0 and said.json[0]["samples"] > 0
    refused = run_main("eval", "--data", town, "--split", "val", "--model", "my_vad:MyVAD", "--checkpoint", "other.pth")
    assert refused.code == 2 and "load" in refused.err


def test_numbers_from_records_and_a_judge_as_printed(
    town: Path, desk: Callable[[str, str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    modules = printed("add-a-metric.md")
    data = benchmark.open_data(town)
    benchmark.evaluate(data, "val", benchmark.load_planner("constant-velocity"), Path("challenger-out", "runs"))
    exec(modules["junctions.py"], {})
    assert capsys.readouterr().out.startswith("constant-velocity on val: collides within 2 s on ")
    desk("near.py", modules["near.py"])
    offers = import_module("near").OFFERS
    assert set(offers) <= set(vars(import_module("benchmark.machine.extension"))["OFFERS"]), "a kind that there is"
    judge = import_reference(offers["judge"]["near"])()
    truths = data.truth(data.scene_names("val")[0])
    standing = np.zeros((len(truths), 6, 2))
    near, exact = judge.evaluate(truths, standing), ExactProtocol().evaluate(truths, standing)
    assert (near.collision >= exact.collision).all() and near.collision.sum() > exact.collision.sum()
    assert judge.name == "near" and judge.version > 0
