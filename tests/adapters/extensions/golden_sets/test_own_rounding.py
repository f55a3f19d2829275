"""``verify model --noise``: what our own rounding moves is told from what is wrong."""

import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from adapters.extensions.golden_sets import parity_set as own_rounding
from adapters.extensions.golden_sets.parity_set import (
    VerificationRun,
    add_floating_point_noise,
    choose_other_thread_count,
)
from adapters.extensions.golden_sets.sparse import sparse_sets
from adapters.models import MODELS
from benchmark.verification.checks import AS_FAR, ROUNDING, Check, Comparison, format_report
from tests.adapters.extensions.golden_sets.sparse_sets import change, write_set
from tests.adapters.networks.sparse.miniature import MINIATURE, filled


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set("sparsedrive", tmp_path_factory.mktemp("golden") / "sparsedrive")


@pytest.fixture
def golden(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "sparsedrive"))


def verified(golden: Path) -> dict[str, Check]:
    found = add_floating_point_noise(partial(sparse_sets(MINIATURE).verify, MODELS["sparsedrive"], golden, "cpu"))
    return {check.quantity.split(" (")[0]: check for check in found}


def shifted(by: float) -> Any:
    def shift(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        moved = array.copy()
        moved.reshape(-1)[3] += by
        return moved

    return shift


def test_a_network_agrees_and_an_error_is_an_error(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks = verified(golden)
    assert {check.verdict for check in checks.values()} == {"ok"}
    moves = [check.moved for check in checks.values() if check.moved]
    assert moves and max(moves) < 0.01, "images that hardly differ move something, and not much"
    # Two threads on a busy machine wait for each other for seconds.
    monkeypatch.setattr(own_rounding, "choose_other_thread_count", torch.get_num_threads)
    change(golden / "outputs_frame1.npz", "plan_reg", shifted(2e-3))
    wrong = verified(golden)["plan_reg"]
    assert wrong.verdict == "FAIL" and not wrong.passes
    assert "images changed by 1e-07 move it by" in wrong.note and "another number of threads by" in wrong.note


def test_an_error_as_large_as_what_rounding_moves_says_so(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding is made as large as an amplifying network makes it; the error is what that does to a plan."""
    monkeypatch.setattr(own_rounding, "IMAGE_NOISE", 0.03)
    monkeypatch.setattr(own_rounding, "choose_other_thread_count", torch.get_num_threads)
    moved = verified(golden)["plan_reg"].moved
    assert moved is not None and moved > 1e-3
    change(golden / "outputs_frame1.npz", "plan_reg", shifted(2 * moved))
    close = verified(golden)["plan_reg"]
    assert close.verdict == ROUNDING and close.passes and not close.ok
    assert close.note.startswith(f"{ROUNDING}: images changed by 0.03 move it by")
    change(golden / "outputs_frame1.npz", "plan_reg", shifted(3 * AS_FAR * moved))
    assert verified(golden)["plan_reg"].verdict == "FAIL"


def test_a_run_leaves_threads_and_network_as_they_were() -> None:
    network, usual, images = filled("sparsedrive"), torch.get_num_threads(), torch.ones(1, 3, 64, 64)
    with torch.inference_mode(), VerificationRun(image_noise=1e-7, threads=choose_other_thread_count()).varied(network):
        noisy: list[torch.Tensor] = []
        hook = network.img_backbone.register_forward_pre_hook(lambda _module, inputs: noisy.append(inputs[0]))
        assert torch.get_num_threads() == choose_other_thread_count() != usual or torch.get_num_threads() != usual
        network.img_backbone(images)
        hook.remove()
    assert torch.get_num_threads() == usual and len(network.img_backbone._forward_pre_hooks) == 0
    assert torch.equal(images, torch.ones_like(images)) and 0 < float((noisy[0] - 1).abs().max()) < 1e-6


def compared(*errors: float, wrong: tuple[bool, ...] = (False, False)) -> Comparison:
    made = Comparison()
    made.remembers = True
    made.errors("numbers", np.array(errors), 0.01)
    made.verdicts("verdicts", np.array(wrong))
    return made


def test_movements_are_differences_of_errors_value_by_value() -> None:
    plain = compared(0.001, 0.05)
    assert plain.moved_by(compared(0.001, 0.02)) == {"numbers": pytest.approx(0.03), "verdicts": 0.0}
    assert plain.moved_by(compared(0.001, 0.05, wrong=(True, False)))["verdicts"] == 1.0
    assert plain.moved_by(compared(0.05))["numbers"] == np.inf, "another number of rows"
    assert plain.moved_by(Comparison())["numbers"] == np.inf
    unheard = Comparison()
    unheard.errors("numbers", np.array([1.0]), 1.0)
    assert unheard.moved_by(plain) == {}


def test_verdicts_of_checks() -> None:
    def check(error: float, moved: float | None, count: int = 5) -> Check:
        return Check("q", error, 0.01, count, moved=moved)

    assert [check(0.02, moved).verdict for moved in (None, 0.0, 0.001, 0.01)] == ["FAIL", "FAIL", "FAIL", ROUNDING]
    assert check(0.001, 5.0).verdict == "ok"
    assert check(float("nan"), np.inf).verdict == "FAIL" and check(float("inf"), np.inf).verdict == ROUNDING
    assert check(0.02, 1.0, count=0).verdict == "FAIL"
    text = format_report([check(0.02, 0.01), check(0.001, 0.0)])
    assert "own floating-point" in text and f"1 of 2 quantities agree, 1 {ROUNDING}" in text
    assert "own floating-point" not in format_report([check(0.02, None)])
    assert check(0.02, 0.01).as_json()["verdict"] == ROUNDING and "verdict" not in check(0.02, None).as_json()
    assert check(float("inf"), float("inf")).as_json()["moved"] is None
