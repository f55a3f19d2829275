"""Golden sets made from a network that runs in a moment, and changed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from adapters.extensions.golden_sets.sparse import trace_modules
from adapters.extensions.golden_sets.sparse_quantities import RowOrder, frame_quantities, map_quantities
from adapters.networks.sparse.boxes import KeyframeMotion
from adapters.networks.sparse.decoder import InstanceMemory
from adapters.networks.sparse.model import SparseMemory, pose_of
from benchmark.verification.golden_sets import GoldenArrays
from tests.adapters.networks.sparse.miniature import MINIATURE, filled, frame, noise, recipe

FRAMES = 2
"""The second sees the first."""


def write_set(name: str, folder: Path, swapped: bool = False) -> Path:
    """A golden set of the miniature, made by itself; `swapped` as if two remembered boxes had been sorted otherwise."""
    folder.mkdir(parents=True)
    network = filled(name)
    made = recipe()
    keys = [[key, list(value.shape), "float32"] for key, value in network.state_dict().items()]
    (folder / "keys.json").write_text(json.dumps(keys))
    manifest: dict[str, Any] = {
        "model": name,
        "salt": "mini",
        "std_rules": made.std_rules,
        "kept_buffers": list(made.kept_buffers),
    }
    manifest |= {"image_hw": [MINIATURE.image_height_px, MINIATURE.image_width_px], "n_frames": FRAMES}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert isinstance(made.kept_buffers, dict)
    np.savez(folder / "kept_buffers.npz", **{key: np.array(v, np.float32) for key, v in made.kept_buffers.items()})
    inputs: dict[str, Any] = {}
    statistics: dict[str, Any] = {}
    for number in range(FRAMES):
        given, before = frame(number), network.memory
        inputs |= {
            f"frame{number}_projection_mat": given.projections.numpy()[None],
            f"frame{number}_image_wh": np.tile([MINIATURE.image_width_px, MINIATURE.image_height_px], (1, 6, 1)),
            f"frame{number}_timestamp": np.array([given.timestamp_s]),
            f"frame{number}_T_global": given.global_T_lidar.numpy(),
            f"frame{number}_gt_ego_fut_cmd": np.eye(3)[[given.command]],
        }
        if name == "diffusiondrive":
            inputs[f"frame{number}_diffusion_noise"] = noise(number).numpy()[None]
        with torch.inference_mode(), trace_modules(network, []) as trace:
            predictions = network.predict(given, noise(number))
        if swapped and number == 0:
            network.memory = _with_two_swapped(network.memory)
        order = RowOrder.of(network, predictions, GoldenArrays(folder, {}))
        fresh = KeyframeMotion.between(before.pose, pose_of(given), torch.device("cpu")).fresh if before else None
        found = map_quantities(trace.maps["img_backbone"], trace.maps["img_neck"])
        found |= frame_quantities(network, predictions, order, given.command, fresh)
        arrays = {key: quantity.values for key, quantity in found.items()}
        statistics[f"frame{number}"] = {"det_cls_1": _statistic(arrays["det_cls_1"])}
        arrays["det_cls_1"] = arrays["det_cls_1"][:, ::2]
        arrays["fpn_p0"] = arrays["fpn_p0"][:, ::8, ::4, ::4]
        np.savez(folder / f"outputs_frame{number}.npz", **arrays)
    np.savez(folder / "inputs.npz", **inputs)
    (folder / "stats_full.json").write_text(json.dumps(statistics))
    return folder


def _with_two_swapped(memory: SparseMemory | None) -> SparseMemory:
    assert memory is not None
    places = torch.arange(MINIATURE.remembered_anchors)
    places[[2, 3]] = places[[3, 2]]
    agents = memory.agents
    swapped = InstanceMemory(
        agents.features[places], agents.anchors[places], agents.confidence[places], agents.rows[places]
    )
    return replace(memory, agents=swapped, tracks=replace(memory.tracks, ids=memory.tracks.ids[places]))


def change(path: Path, name: str, value: Any) -> None:
    """Put another array into an npz file, or with ``None`` none."""
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays[name] = value(arrays[name]) if callable(value) else value
    np.savez(path, **{key: array for key, array in arrays.items() if array is not None})


def _statistic(values: NDArray[Any]) -> dict[str, Any]:
    return {
        "shape": list(values.shape),
        "mean": float(values.mean()),
        "std": float(values.std(ddof=1)),
        "absmax": float(np.abs(values).max()),
        "first": values.reshape(-1)[:4].tolist(),
    }
