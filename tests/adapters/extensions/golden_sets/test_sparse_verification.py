"""`verify model` for the sparse networks: a stranger's sets, wrong numbers, rows out of order, and our own rounding."""

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from adapters.extensions.golden_sets import parity_set as own_rounding
from adapters.extensions.golden_sets import sparse_quantities as sparse_order
from adapters.extensions.golden_sets.models import verify_model
from adapters.extensions.golden_sets.parity_set import (
    VerificationRun,
    add_floating_point_noise,
    choose_other_thread_count,
)
from adapters.extensions.golden_sets.sparse import GOLDEN, MODULES, MOVED, sparse_sets
from adapters.extensions.golden_sets.sparse_quantities import OTHER_ROWS, RowOrder
from adapters.models import MODELS
from benchmark.errors import InputError
from benchmark.verification.checks import AS_FAR, ROUNDING, Check, Comparison, format_report
from benchmark.verification.golden_sets import GoldenArrays
from tests.adapters.extensions.golden_sets.sparse_sets import FRAMES, change, write_set
from tests.adapters.networks.sparse.miniature import MINIATURE, filled, frame, noise


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: write_set(name, tmp_path_factory.mktemp(name) / name) for name in ("sparsedrive", "diffusiondrive")}


@pytest.fixture
def golden(originals: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(originals["sparsedrive"], tmp_path / "sparsedrive"))


def verify(folder: Path, name: str | None = None) -> list[Check]:
    return sparse_sets(MINIATURE).verify(MODELS[name or folder.name], folder)


def failures(checks: list[Check]) -> set[str]:
    return {check.quantity.split(" (")[0] for check in checks if not check.ok}


def shifted(by: float, *index: int) -> Any:
    def shift(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        changed = array.copy()
        changed[index] += by
        return changed

    return shift


@pytest.mark.path
@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_a_network_agrees_with_its_own_numbers(name: str, originals: dict[str, Path]) -> None:
    checks = verify(originals[name])
    assert not failures(checks)
    names = {check.quantity.split(" (")[0] for check in checks}
    assert {"backbone_c2", "fpn_p0", "det_cls_1", "state_period", "result_final_planning", "plan_reg"} <= names
    assert max(check.error for check in checks) < 1e-6


def test_wrong_numbers_fail_where_they_are_wrong(golden: Path) -> None:
    outputs = golden / "outputs_frame1.npz"
    change(outputs, "plan_reg", shifted(2e-3, 0, 0, 3, 2, 1))
    change(outputs, "map_reg_2", shifted(0.1, 0, 4, 1))
    change(outputs, "state_period", shifted(1, 0, 5))
    change(outputs, "det_quality_0", lambda array: array + 0.1)
    change(outputs, "result_final_planning", shifted(-0.01, 5, 0))
    statistics = json.loads((golden / "stats_full.json").read_text())
    statistics["frame0"]["det_cls_1"]["mean"] += 0.5
    (golden / "stats_full.json").write_text(json.dumps(statistics))
    checks = verify(golden)
    wrong = {"plan_reg", "map_reg_2", "state_period", "det_quality_0", "result_final_planning", "det_cls_1"}
    assert failures(checks) == wrong | {OTHER_ROWS.split(" (")[0]}
    assert "frame 1" in next(check.note for check in checks if check.quantity.startswith("plan_reg"))


@pytest.mark.parametrize(("spreads", "fails"), [(0.02, set()), (0.2, {OTHER_ROWS.split(" (")[0]})])
def test_a_few_rows_may_be_off_a_little_but_not_much(golden: Path, spreads: float, fails: set[str]) -> None:
    change(golden / "outputs_frame1.npz", "motion_cls", lambda array: shifted(spreads * array.std(), 0, 7, 0)(array))
    assert failures(verify(golden)) == fails


def test_what_modules_give_is_compared_call_by_call(golden: Path) -> None:
    network = filled(golden.name)
    given: list[torch.Tensor] = []
    network.head.det_head.anchor_encoder.register_forward_hook(lambda _module, _inputs, output: given.append(output))
    with torch.inference_mode():
        network(frame(0), noise(0))
    calls: list[dict[str, Any]] = [
        {
            "module": "head.det_head.anchor_encoder",
            "shape": [1, *output.shape],
            "mean": float(output.mean()),
            "std": float(output.std()),
            "absmax": float(output.abs().max()),
            "first": [],
        }
        for output in given
    ]
    calls.append({**calls[0], "module": "head.of.another.network"})
    (golden / "trace.json").write_text(json.dumps({"frame0": calls}))
    checks = verify(golden)
    assert not failures(checks)
    note = next(check.note for check in checks if check.quantity == MODULES)
    assert f"{len(given)} of {len(given) + 1} calls" in note
    calls[1] |= {"std": 1.01 * float(given[1].std())}
    (golden / "trace.json").write_text(json.dumps({"frame0": calls}))
    assert failures(verify(golden)) == {MODULES.split(" (")[0]}


def test_a_set_that_sorted_ties_otherwise_is_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_set("sparsedrive", tmp_path / "sparsedrive", swapped=True)
    assert {"state_det_confidence", "state_cached_instance_id"} <= failures(verify(folder)), "these were no ties"
    monkeypatch.setattr(sparse_order, "TIED", 1.0)
    assert not failures(verify(folder))


def test_rows_that_changed_places_are_found_and_counted() -> None:
    network = filled("sparsedrive")
    with torch.inference_mode():
        predictions = network.predict(frame(0))
    boxes = predictions.agents.anchors.numpy().copy()
    expected = np.arange(len(boxes))
    boxes[[3, 17]], expected[[3, 17]] = boxes[[17, 3]], expected[[17, 3]]
    # A row that is like no other is simply wrong.
    for row, by in ((3, 0.0), (5, 7.0)):
        boxes[row] += by
        order = RowOrder.of(network, predictions, GoldenArrays(Path("made.npz"), {"det_reg_5": boxes[None]}))
        assert order.agents.tolist() == expected.tolist()
        assert by or order.moved == pytest.approx(2 / len(boxes))


def test_other_names_and_shapes_end_it(golden: Path) -> None:
    keys = json.loads((golden / "keys.json").read_text())
    keys[5][1] = [1, 2, 3]
    (golden / "keys.json").write_text(json.dumps(keys))
    (check,) = verify(golden)
    assert not check.ok and keys[5][0] in check.note


def test_a_set_may_have_its_weights_beside_it_and_a_model_several_sets(golden: Path, tmp_path: Path) -> None:
    model = tmp_path / "model"
    shutil.copytree(golden, model / "mini")
    shutil.move(model / "mini" / "keys.json", model / "keys.json")
    shutil.copytree(model / "mini", model / "other")
    (model / "other" / "kept_buffers.npz").unlink()
    checks = verify(model, golden.name)
    assert not failures(checks)
    assert next(check.count for check in checks if check.quantity == MOVED) == 2 * FRAMES


DAMAGED_FILES = (
    ("manifest.json", None), ("manifest.json", "{"), ("keys.json", None), ("kept_buffers.npz", None),
    ("inputs.npz", "PK"), ("outputs_frame1.npz", None), ("stats_full.json", '{"frame0": 3}'), ("trace.json", "[]"),
)  # fmt: skip
ODD_FACTS: tuple[dict[str, Any], ...] = (
    {"model": "uniad"}, {"image_hw": [64, 96]}, {"image_hw": [64, 64]}, {"image_sha256": {"frame0": "00"}},
    {"n_frames": 0}, {"std_rules": {"(": 1.0}},
)  # fmt: skip
ODD_ARRAYS: tuple[tuple[str, str, Any], ...] = (
    ("kept_buffers.npz", "a.stranger", np.zeros(3)),
    ("inputs.npz", "frame0_projection_mat", None),
    ("inputs.npz", "frame0_timestamp", np.array([np.nan])),
    ("inputs.npz", "frame0_T_global", np.zeros((4, 4))),
    ("outputs_frame0.npz", "plan_reg", None),
    ("outputs_frame0.npz", "plan_cls", np.zeros((1, 1, 7))),
    ("outputs_frame0.npz", "det_cls_1", np.full((1, 12, 10), np.inf)),
)


def refused(folder: Path, *said: str) -> None:
    with pytest.raises(InputError) as caught:
        verify(folder)
    sentence = str(caught.value)
    assert str(folder.parent) in sentence and len(sentence.splitlines()) == 1 and all(part in sentence for part in said)


@pytest.mark.parametrize(("path", "text"), DAMAGED_FILES)
def test_damaged_files_are_said_to_be_damaged(golden: Path, path: str, text: str | None) -> None:
    (golden / path).unlink() if text is None else (golden / path).write_text(text)
    refused(golden)


@pytest.mark.parametrize("facts", ODD_FACTS, ids=str)
def test_odd_manifests_are_refused(golden: Path, facts: dict[str, Any]) -> None:
    stored = json.loads((golden / "manifest.json").read_text())
    (golden / "manifest.json").write_text(json.dumps(stored | facts))
    refused(golden)


@pytest.mark.parametrize(("file", "name", "value"), ODD_ARRAYS)
def test_odd_arrays_are_refused(golden: Path, file: str, name: str, value: Any) -> None:
    change(golden / file, name, value)
    refused(golden)


def test_diffusion_needs_its_noise_and_each_model_a_set(originals: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(originals["diffusiondrive"], tmp_path / "diffusiondrive"))
    change(folder / "inputs.npz", "frame1_diffusion_noise", None)
    refused(folder, "frame1_diffusion_noise")
    with pytest.raises(InputError, match="not a directory"):
        verify(tmp_path / "nowhere", "sparsedrive")
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    for name in ("sparsedrive", "diffusiondrive"):
        with pytest.raises(InputError, match=str(nothing)):
            verify_model(name, nothing)
    with pytest.raises(InputError, match="choose one of vad-tiny, vad-base, uniad, sparsedrive, diffusiondrive"):
        verify_model("nonsense", tmp_path)


PARITY = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity"


@pytest.mark.slow
@pytest.mark.skipif(not PARITY.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize(("size", "quantities"), [("dev", 70), ("fullres", 15)])
@pytest.mark.parametrize("name", ["sparsedrive", "diffusiondrive"])
def test_published_networks_give_what_the_official_code_gave(name: str, size: str, quantities: int) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        checks = GOLDEN.verify(MODELS[name], PARITY / name / size)
    finally:
        torch.set_num_threads(threads)
    assert all(check.ok for check in checks), format_report(checks)
    assert len(checks) > quantities and "in the same order" in checks[0].note
    plans = [check for check in checks if check.quantity.endswith("(m)")]
    assert plans and max(check.error for check in plans) < 1e-4


def verified(golden: Path) -> dict[str, Check]:
    found = add_floating_point_noise(partial(sparse_sets(MINIATURE).verify, MODELS["sparsedrive"], golden, "cpu"))
    return {check.quantity.split(" (")[0]: check for check in found}


def test_a_network_agrees_and_an_error_is_an_error(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks = verified(golden)
    assert {check.verdict for check in checks.values()} == {"ok"}
    moves = [check.moved for check in checks.values() if check.moved]
    assert moves and max(moves) < 0.01, "images that hardly differ move something, and not much"
    # Two threads on a busy machine wait for each other for seconds.
    monkeypatch.setattr(own_rounding, "choose_other_thread_count", torch.get_num_threads)
    change(golden / "outputs_frame1.npz", "plan_reg", shifted(2e-3, 0, 0, 0, 1, 1))
    wrong = verified(golden)["plan_reg"]
    assert wrong.verdict == "FAIL" and not wrong.passes
    assert "images changed by 1e-07 move it by" in wrong.note and "another number of threads by" in wrong.note


def test_an_error_as_large_as_what_rounding_moves_says_so(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding is made as large as an amplifying network makes it; the error is what that does to a plan."""
    monkeypatch.setattr(own_rounding, "IMAGE_NOISE", 0.03)
    monkeypatch.setattr(own_rounding, "choose_other_thread_count", torch.get_num_threads)
    moved = verified(golden)["plan_reg"].moved
    assert moved is not None and moved > 1e-3
    change(golden / "outputs_frame1.npz", "plan_reg", shifted(2 * moved, 0, 0, 0, 1, 1))
    close = verified(golden)["plan_reg"]
    assert close.verdict == ROUNDING and close.passes and not close.ok
    assert close.note.startswith(f"{ROUNDING}: images changed by 0.03 move it by")
    change(golden / "outputs_frame1.npz", "plan_reg", shifted(3 * AS_FAR * moved, 0, 0, 0, 1, 1))
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
