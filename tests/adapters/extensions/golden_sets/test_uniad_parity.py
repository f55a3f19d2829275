"""`verify model --model uniad`: a set made with a small network, and damaged sets."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from adapters.extensions.golden_sets.models import verify_model
from adapters.extensions.golden_sets.parity_set import ParitySet
from adapters.extensions.golden_sets.uniad import compare_uniad, frame_quantities
from adapters.networks.uniad.collision_optimiser import move_plan
from adapters.networks.uniad.model import UniAD, UniADInputs
from benchmark.errors import InputError
from benchmark.verification.checks import Check, Comparison, format_report
from benchmark.verification.filled_networks import NAMES, fill_network, have_same_names_and_shapes
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder
from tests.adapters.networks.uniad.small_uniad import SMALL, anchors, class_layer, frame
from tests.benchmark.verification.damaged import said

PARITY = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity" / "uniad"
SCENES = ("a", "a", "b")
LARGEST = 400
"""Longer arrays are stored in part."""


def filled(folder: Path) -> UniAD:
    network, golden = UniAD(SMALL, anchors()), ParitySet.read(GoldenFolder(folder))
    fill_network(Comparison(), network, golden.recipe, golden.shapes)
    return network


def make_set(folder: Path) -> Path:
    """A set whose official network is the small one."""
    folder.mkdir(parents=True)
    inputs = [frame(number) for number in range(len(SCENES))]
    (folder / "keys.json").write_text(
        json.dumps([[name, list(value.shape), ""] for name, value in UniAD(SMALL).state_dict().items()])
    )
    by_frame = {
        name: np.stack([getattr(each, name).numpy() for each in inputs]) for name in ("can_bus", "l2g_r_mat", "l2g_t")
    }
    np.savez(
        folder / "inputs.npz",
        lidar2img=inputs[0].lidar2img.numpy(),
        timestamps=np.array([each.timestamp for each in inputs]),
        command=np.array([each.command for each in inputs]),
        motion_anchors=anchors().numpy(),
        **by_frame,
    )
    image = {"shape": [6, 3, 64, 96], "valid_rows": 60}
    rules = {r"cls_branches\.1\.6\.bias$": -1.5}
    manifest: dict[str, Any] = {
        "salt": "t",
        "image": image,
        "scene_tokens": SCENES,
        "shift_rules": rules,
        "tensors": {},
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    for number in range(len(SCENES)):
        np.savez(folder / f"outputs_frame{number}.npz", nothing=np.zeros(1))
    network, golden = filled(folder), ParitySet.read(GoldenFolder(folder))
    for number, each in enumerate(inputs):
        stored = {}
        for name, values in outputs(network, golden.images(number), each, SCENES[number]).items():
            stride = -(-values.size // LARGEST)
            facts = {"shape": list(values.shape), "stride": stride}
            manifest["tensors"].setdefault(name, {})[f"frame{number}"] = facts
            whole = values.astype(np.float64)
            stored[f"{name}__stats"] = np.array([whole.mean(), whole.std(), np.abs(whole).max(initial=0.0)])
            partial = stride > 1 and name not in ("occ_seg_out_bits", "seg_outputs_classes")
            stored[f"{name}__sub" if partial else name] = values.reshape(-1)[::stride] if partial else values
        np.savez(folder / f"outputs_frame{number}.npz", **stored)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def outputs(network: UniAD, images: torch.Tensor, inputs: UniADInputs, scene: str) -> dict[str, Any]:
    fields = {name: getattr(inputs, name) for name in inputs.__slots__}
    key_frame = UniADInputs(**{**fields, "images": images, "scene_token": scene})
    with torch.inference_mode():
        seen, predictions = network.ego_motion(key_frame).can_bus, network.predict(key_frame)
        nothing = GoldenArrays(Path("none"), {})
        quantities = frame_quantities(network, predictions, seen, {}, nothing)
    arrays = {name: quantity.values for name, quantity in quantities.items()}
    for name in ("track_mem_padding_active", "seg_drivable"):
        arrays[name] = arrays[name].astype(np.bool_)
    arrays["seg_outputs_classes"] = arrays["seg_outputs_classes"][:, None]
    arrays["seg_drivable_area"] = arrays["seg_drivable_area"][0]
    arrays["occ_seg_out_area"] = arrays["occ_seg_out_area"][None]
    moved = move_plan(predictions.plan.positions_m.double().numpy(), predictions.occupancy.occupied.numpy())
    arrays["sdc_traj_before_optim"] = arrays["sdc_traj_before_optim"][None]
    arrays["sdc_traj"], arrays["col_optim_cells"] = moved.points[None].astype(np.float32), moved.cells
    # Nothing is expected of tracks where there are none.
    return {name: values for name, values in arrays.items() if values.size}


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_set(tmp_path_factory.mktemp("parity") / "dev")


def compared(folder: Path, network: UniAD | None = None) -> dict[str, Check]:
    comparison = Comparison()
    with torch.inference_mode():
        compare_uniad(comparison, network or filled(folder), ParitySet.read(GoldenFolder(folder)))
    return {check.quantity: check for check in comparison.checks()}


def changed(golden: Path, folder: Path, change: Callable[[dict[str, Any]], None], name: str = "outputs_frame1") -> Path:
    shutil.copytree(golden, folder, dirs_exist_ok=True)
    with np.load(folder / f"{name}.npz") as stored:
        arrays = {key: stored[key].copy() for key in stored.files}
    change(arrays)
    np.savez(folder / f"{name}.npz", **arrays)
    return folder


@pytest.mark.path
def test_a_network_agrees_with_itself(golden: Path) -> None:
    checks = compared(golden)
    report = format_report(list(checks.values()))
    assert all(check.ok for check in checks.values()) and "not compared" not in report, report
    for part in ("bev_embed", "track_ids", "velo_update", "seg_lane_score", "occ_ins_logits", "sdc_traj by newton"):
        assert part in " ".join(checks)
    # A set of another network stops at the names.
    (check,) = verify_model("uniad", golden)
    assert check.quantity == NAMES and not check.ok


def test_what_is_spoiled_is_found(golden: Path, tmp_path: Path) -> None:
    def spoil(arrays: dict[str, Any]) -> None:
        arrays["sdc_traj_before_optim"][0, 2, 1] += 0.002
        arrays["track_obj_idxes"][3] += 1
        arrays["occ_seg_out_bits"][17] ^= 1
        arrays["seg_bbox"][0, 2] += 5.0
        arrays["seg_drivable"][0, 0] ^= True

    checks = compared(changed(golden, tmp_path / "dev", spoil))
    failed = {name.split(" ")[0] for name, check in checks.items() if not check.ok}
    assert {"sdc_traj_before_optim", "track_obj_idxes", "occ_seg_out_bits", "seg_drivable"} <= failed
    assert failed <= {*failed, "seg_bbox"} and "bev_embed" not in failed and "track_ids" not in failed
    assert "frame 1" in checks["sdc_traj_before_optim"].note


def test_tracks_that_changed_places_are_the_same_tracks(golden: Path, tmp_path: Path) -> None:
    """Lists are ordered by scores, which may nearly tie."""

    def swap(arrays: dict[str, Any]) -> None:
        for kind in ("boxes_3d", "scores_3d", "labels_3d"):
            arrays[f"track_{kind}"][[0, 1]] = arrays[f"track_{kind}"][[1, 0]]
        arrays["track_ids"][[0, 1]] = arrays["track_ids"][[1, 0]]
        for name in list(arrays):
            if name.startswith(("motion_", "occ_ins", "occ_mask")):
                del arrays[name]

    checks = compared(changed(golden, tmp_path / "dev", swap))
    assert all(check.ok for check in checks.values()), format_report(list(checks.values()))


def test_another_number_of_tracks_fails_without_a_crash(golden: Path) -> None:
    network = filled(golden)
    with torch.no_grad():
        class_layer(network).bias.add_(3.0)
    failed = {name for name, check in compared(golden, network).items() if not check.ok}
    assert "track_ids" in failed and any(name.startswith("shape of") for name in failed)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("manifest.json", b"{}"),
        ("manifest.json", b"[]"),
        ("manifest.json", b'{"salt": "t"}'),
        ("inputs.npz", b"PK"),
        ("outputs_frame0.npz", b""),
        ("keys.json", b'{"a": 3}'),
    ],
)
def test_damaged_sets_are_told(golden: Path, tmp_path: Path, name: str, content: bytes) -> None:
    folder = Path(shutil.copytree(golden, tmp_path / "dev"))
    (folder / name).write_bytes(content)
    assert "golden set" in said(partial(verify_model, "uniad"), folder)


def test_odd_inputs_and_absent_sets_are_told(golden: Path, tmp_path: Path) -> None:
    odd = changed(golden, tmp_path / "a", lambda arrays: arrays.update(command=np.array([0, 1, 3])), "inputs")
    with pytest.raises(ValueError, match="past 2"):
        compared(odd)
    few = changed(
        golden, tmp_path / "b", lambda arrays: arrays.update(motion_anchors=anchors()[:, :5].numpy()), "inputs"
    )
    with pytest.raises(InputError, match="motion_anchors"):
        compared(few)
    (tmp_path / "empty").mkdir()
    for folder, says in ((tmp_path / "nowhere", "no golden set"), (tmp_path / "empty", r"no manifest\.json")):
        with pytest.raises(InputError, match=says):
            verify_model("uniad", folder)


@pytest.mark.skipif(not PARITY.is_dir(), reason="no shared material beside the repository")
def test_the_published_set_is_read() -> None:
    golden = ParitySet.read(GoldenFolder(PARITY / "dev"))
    assert len(golden.outputs) == 4 and golden.stored("track_ids", 1).shape == [19]
    with torch.device("meta"):
        network = UniAD(SMALL)
    assert not have_same_names_and_shapes(Comparison(), network, golden.shapes)
