"""Checkpoints as trainers leave them: wrapped names, averaged copies beside the last step, networks that differ."""

from collections import OrderedDict
from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch
from torch import Tensor, nn

from adapters.checkpoints.cache import read_provenance
from adapters.checkpoints.checkpoint_import import import_checkpoint
from adapters.models import Model, Network
from benchmark.errors import InputError
from benchmark.weights.folders import read_checkpoint
from benchmark.weights.tensor_names import choose_tensors

HERE = "tests.adapters.checkpoints.test_copies"


def detector(classes: int) -> nn.Module:
    """What the table's entry builds of its configuration."""
    heads = {"cls_branches": nn.Linear(4, classes), "planning": nn.Linear(4, 12)}
    return nn.ModuleDict({"backbone": nn.BatchNorm1d(4), "head": nn.ModuleDict(heads), "motion": nn.Linear(4, 2)})


TEN = lambda: 10  # noqa: E731
SMALL = Network(f"{HERE}:detector", f"{HERE}:TEN", "", "bgr-mean")


@pytest.fixture(autouse=True)
def one_model(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.models.MODELS", {"small": Model("small", "", SMALL, weights="small")})


def weights(value: float = 1.0, classes: int = 10) -> dict[str, Tensor]:
    tensors = detector(classes).state_dict()
    return {name: torch.full_like(tensor, value) for name, tensor in tensors.items()}


def behind(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {prefix + name: tensor for name, tensor in tensors.items()}


def saved(path: Path, content: Any) -> Path:
    torch.save(content, path)
    return path


LAST, MEAN = weights(1.0), weights(2.0)
COUNT = torch.tensor(7)
MMCV = {f"ema_{name.replace('.', '_')}": tensor for name, tensor in LAST.items()}


@pytest.mark.parametrize(
    "content",
    [
        {"state_dict": behind("model.", MEAN), "epoch": 3, "pytorch-lightning_version": "2.5"},
        {"model": behind("_orig_mod.", MEAN)},
        {"model_state_dict": behind("module.", MEAN)},
        {"module": MEAN},
        *(
            behind(prefix, MEAN)
            for prefix in ("module._orig_mod.", "_orig_mod.module.", "model._orig_mod.module.model.")
        ),
        {name.replace("head.", "head._orig_mod."): tensor for name, tensor in MEAN.items()},
        {name.replace("backbone.", "_orig_mod.backbone."): tensor for name, tensor in MEAN.items()},
        {"n_averaged": COUNT, **behind("module.", MEAN)},
    ],
)
def test_wrappers_are_taken_off(tmp_path: Path, content: Any) -> None:
    found = read_checkpoint(saved(tmp_path / "a.pth", content))
    assert list(found.tensors) == list(MEAN) and not found.note


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"state_dict": LAST, "state_dict_ema": MEAN}, "(state_dict_ema); state_dict holds those of the last step"),
        ({"model": LAST, "model_ema": behind("module.", MEAN)}, "(model_ema); model holds"),
        ({"model": LAST, "ema": {"module": MEAN, "updates": 3}}, "(ema); model holds"),
        ({"ema": {**MEAN, "decay": 0.99}}, "averaged weights (ema)"),
        ({"ema_state_dict": {"n_averaged": COUNT, **behind("module.", MEAN)}, "state_dict": LAST}, "(ema_state_dict);"),
        # mmengine and mmcv swap both copies when they save.
        (
            {"state_dict": MEAN, "ema_state_dict": {"steps": COUNT, **behind("module.", LAST)}},
            "(state_dict); ema_state_dict holds those of the last step and is left out",
        ),
        ({"meta": {}, "state_dict": OrderedDict(MEAN | MMCV)}, f"{len(MMCV)} tensors ema_* of the last step"),
        (behind("module.", MEAN | MMCV), "(in mmcv's files the plain names)"),
        (
            {
                "state_dict": behind("model.", LAST)
                | behind("ema_model.module.", MEAN)
                | {"ema_model.n_averaged": COUNT}
            },
            f"(ema_model.*); {len(LAST)} tensors of the last step are left out",
        ),
        (behind("model_ema.", MEAN), "averaged weights (model_ema.*)"),
        # Nothing is averaged where the entry is empty, or not of the same network.
        ({"state_dict": MEAN, "state_dict_ema": None}, ""),
        ({"state_dict": MEAN, "ema": 0.999}, ""),
    ],
)
def test_averaged_weights_are_taken_and_said(tmp_path: Path, content: Any, says: str) -> None:
    imported = import_checkpoint(saved(tmp_path / "a.pth", content), cache=tmp_path / "cache")
    kept = safetensors.torch.load_file(imported.path)
    assert kept.keys() == MEAN.keys() and all(bool((tensor == 2).all()) for tensor in kept.values())
    assert says in imported.sentence() and ("averaged weights" in imported.sentence()) == bool(says)
    assert read_provenance(imported.path).source == ", ".join(filter(None, ["a.pth", imported.note]))


def test_names_that_would_become_one_stay_as_they_are() -> None:
    assert choose_tensors(["model.a", "model.model.a"]).names == {"a": "model.a", "model.a": "model.model.a"}
    assert choose_tensors(["a", "_orig_mod.a"]).names == {"a": "a", "_orig_mod.a": "_orig_mod.a"}
    # A part of a network that is called so, and buffers of no tensor of the file.
    for names in (["ema.a", "b"], ["ema_a_b", "c"], ["steps"], []):
        assert dict(choose_tensors(names).names) == {name: name for name in names} and not choose_tensors(names).note


def test_a_network_that_differs_is_told_how_and_where_it_is_judged(tmp_path: Path) -> None:
    def refused(tensors: dict[str, Tensor]) -> str:
        with pytest.raises(InputError) as refusal:
            import_checkpoint(saved(tmp_path / "a.pth", {"state_dict": tensors}), cache=tmp_path / "cache")
        assert not (tmp_path / "cache").exists() and len(str(refusal.value).splitlines()) == 1
        return str(refusal.value)

    said = refused(weights(classes=5))
    assert "2 of another shape (first: head.cls_branches.weight (5, 4) instead of (10, 4))" in said
    assert "so it was trained for other classes (head.cls_branches tells 5, not 10)" in said
    assert "eval --results FILE" in said and "eval --model NAME=http://HOST:PORT" in said
    said = refused({name: tensor for name, tensor in LAST.items() if not name.startswith(("motion", "head.plan"))})
    assert "so it has nothing of motion, head.planning, as files of an earlier stage of training" in said
    said = refused({name: tensor for name, tensor in LAST.items() if name != "motion.bias"})
    assert "1 missing (first: motion.bias); get" in said
    assert "eval --results FILE" in refused({"a": torch.zeros(1)})
