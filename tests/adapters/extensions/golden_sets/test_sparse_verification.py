"""`verify model` for the sparse networks: sets of a stranger, wrong numbers, wrong descriptions, rows out of order."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from adapters.extensions.golden_sets import sparse_quantities as sparse_order
from adapters.extensions.golden_sets.models import verify_model
from adapters.extensions.golden_sets.sparse import MODULES, MOVED, sparse_sets
from adapters.extensions.golden_sets.sparse_quantities import OTHER_ROWS, RowOrder
from adapters.models import MODELS
from benchmark.errors import InputError
from benchmark.verification.checks import Check
from benchmark.verification.golden_sets import GoldenArrays
from tests.adapters.extensions.golden_sets.sparse_sets import change, write_set
from tests.adapters.networks.sparse.miniature import MINIATURE, filled, frame, noise


@pytest.fixture(scope="module", params=["sparsedrive", "diffusiondrive"])
def original(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(request.param, tmp_path_factory.mktemp(request.param) / request.param)


@pytest.fixture
def golden(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / original.name))


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


def by_spreads(number: float) -> Any:
    return lambda array: shifted(number * array.std(), 0, 7, 0)(array)


def test_a_network_agrees_with_its_own_numbers(golden: Path) -> None:
    checks = verify(golden)
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
    checks = verify(golden)
    assert failures(checks) == {"plan_reg", "map_reg_2", "state_period", "det_quality_0", "result_final_planning"} | {
        OTHER_ROWS.split(" (")[0]
    }
    note = next(check.note for check in checks if check.quantity.startswith("plan_reg"))
    assert "frame 1" in note


def test_a_few_rows_may_be_off_a_little_but_not_much(golden: Path) -> None:
    outputs = golden / "outputs_frame1.npz"
    change(outputs, "motion_cls", by_spreads(0.02))
    assert not failures(verify(golden))
    change(outputs, "motion_cls", by_spreads(0.2))
    assert failures(verify(golden)) == {OTHER_ROWS.split(" (")[0]}


def test_statistics_of_what_is_not_stored_count(golden: Path) -> None:
    statistics = json.loads((golden / "stats_full.json").read_text())
    statistics["frame2"]["det_cls_1"]["mean"] += 0.5
    (golden / "stats_full.json").write_text(json.dumps(statistics))
    assert failures(verify(golden)) == {"det_cls_1"}


def test_what_modules_give_is_compared_call_by_call(golden: Path) -> None:
    network = filled(golden.name)
    given: list[torch.Tensor] = []
    module = network.head.det_head.anchor_encoder
    handle = module.register_forward_hook(lambda _module, _inputs, output: given.append(output))
    with torch.inference_mode():
        network(frame(0), noise(0))
    handle.remove()
    calls = [
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
    boxes[[3, 17]] = boxes[[17, 3]]
    order = RowOrder.of(network, predictions, GoldenArrays(Path("made.npz"), {"det_reg_5": boxes[None]}))
    expected = np.arange(len(boxes))
    expected[[3, 17]] = expected[[17, 3]]
    assert order.agents.tolist() == expected.tolist()
    assert order.moved == pytest.approx(2 / len(boxes))
    boxes[5] += 7
    order = RowOrder.of(network, predictions, GoldenArrays(Path("made.npz"), {"det_reg_5": boxes[None]}))
    assert order.agents.tolist() == expected.tolist(), "a row that is like no other is simply wrong"


def test_other_names_and_shapes_end_it(golden: Path) -> None:
    keys = json.loads((golden / "keys.json").read_text())
    keys[5][1] = [1, 2, 3]
    (golden / "keys.json").write_text(json.dumps(keys))
    checks = verify(golden)
    assert [check.ok for check in checks] == [False]
    assert keys[5][0] in checks[0].note


def test_a_set_may_have_its_weights_beside_it_and_a_model_several_sets(golden: Path, tmp_path: Path) -> None:
    model = tmp_path / "model"
    shutil.copytree(golden, model / "mini")
    shutil.move(model / "mini" / "keys.json", model / "keys.json")
    shutil.copytree(model / "mini", model / "other")
    (model / "other" / "kept_buffers.npz").unlink()
    checks = verify(model, golden.name)
    assert not failures(checks)
    frames = next(check.count for check in checks if check.quantity == MOVED)
    assert frames == 8


def broken(path: str, text: str | None) -> Any:
    def change_file(folder: Path) -> None:
        if text is None:
            (folder / path).unlink()
        else:
            (folder / path).write_text(text)

    return change_file


def manifest(**values: Any) -> Any:
    def change_manifest(folder: Path) -> None:
        stored = json.loads((folder / "manifest.json").read_text())
        (folder / "manifest.json").write_text(json.dumps(stored | values))

    return change_manifest


def arrays(file: str, name: str, value: Any) -> Any:
    return lambda folder: change(folder / file, name, value)


@pytest.mark.parametrize(
    "damage",
    [
        broken("manifest.json", None),
        broken("manifest.json", "{"),
        broken("keys.json", None),
        broken("kept_buffers.npz", None),
        broken("inputs.npz", "PK"),
        broken("outputs_frame2.npz", None),
        broken("stats_full.json", '{"frame0": 3}'),
        broken("trace.json", "[]"),
        manifest(model="uniad"),
        manifest(image_hw=[64, 96]),
        manifest(image_hw=[64, 64]),
        manifest(image_sha256={"frame0": "00"}),
        manifest(n_frames=0),
        manifest(std_rules={"(": 1.0}),
        arrays("kept_buffers.npz", "a.stranger", np.zeros(3)),
        arrays("inputs.npz", "frame0_projection_mat", None),
        arrays("inputs.npz", "frame0_timestamp", np.array([np.nan])),
        arrays("inputs.npz", "frame0_T_global", np.zeros((4, 4))),
        arrays("outputs_frame0.npz", "plan_reg", None),
        arrays("outputs_frame0.npz", "plan_cls", np.zeros((1, 1, 7))),
        arrays("outputs_frame0.npz", "det_cls_1", np.full((1, 12, 10), np.inf)),
    ],
)
def test_damaged_sets_are_said_to_be_damaged(golden: Path, damage: Any) -> None:
    damage(golden)
    with pytest.raises(InputError) as caught:
        verify(golden)
    assert str(golden.parent) in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a directory"):
        verify(tmp_path / "nowhere", "sparsedrive")


def test_diffusion_needs_its_noise(tmp_path: Path) -> None:
    folder = write_set("diffusiondrive", tmp_path / "diffusiondrive")
    change(folder / "inputs.npz", "frame1_diffusion_noise", None)
    with pytest.raises(InputError, match="frame1_diffusion_noise"):
        verify(folder)


def test_one_command_verifies_these_networks_too(tmp_path: Path) -> None:
    for name in ("sparsedrive", "diffusiondrive"):
        with pytest.raises(InputError, match=str(tmp_path)):
            verify_model(name, tmp_path)
    with pytest.raises(InputError, match="choose one of vad-tiny, vad-base, uniad, sparsedrive, diffusiondrive"):
        verify_model("nonsense", tmp_path)
