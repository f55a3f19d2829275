"""A network that runs in a moment, its inputs, and golden sets made from it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from adapters.extensions.golden_sets.sparse_order import Order
from adapters.extensions.golden_sets.sparse_quantities import frame_quantities, map_quantities
from adapters.extensions.golden_sets.sparse_trace import traced
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.decoder import Remembered
from adapters.networks.sparse.keyframe_pose import KeyframeMotion
from adapters.networks.sparse.model import DiffusionDrive, Memory, SparseDrive, SparseInputs, SparseNetwork, pose_of
from benchmark.verification.golden import GoldenArrays
from benchmark.verification.synthetic_weights import WeightsRecipe, seeded_normal

MINIATURE = SparseConfig(
    image_height_px=64,
    image_width_px=128,
    backbone_blocks=(1, 1, 1, 1),
    backbone_width=4,
    channels=32,
    heads=4,
    hidden_channels=32,
    planner_hidden_channels=32,
    stages=3,
    anchors=24,
    remembered_anchors=14,
    lines=9,
    remembered_lines=4,
    points_per_line=4,
    samples_per_height=2,
    interaction_blocks=1,
    watched_agents=5,
    watched_lines=3,
    reported_boxes=8,
    reported_lines=6,
)
TIMES_S = (0.0, 0.5, 1.0, 30.0)
"""The last frame comes when memory is stale."""


def recipe() -> WeightsRecipe:
    anchors = seeded_normal("boxes", (MINIATURE.anchors, 11), "mini") * ([8.0] * 2 + [1.0] * 9)
    return WeightsRecipe(
        salt="mini",
        std_rules={r"\.scale$": 0.2, r"instance_feature$": 0.5, r"learnable_fc\.weight$": 0.03, r"cls_branch": 0.2},
        kept_buffers={
            "head.det_head.instance_bank.anchor": anchors.astype(np.float32).tolist(),
            "head.map_head.instance_bank.anchor": (8 * seeded_normal("lines", (MINIATURE.lines, 8), "mini")).tolist(),
        },
    )


def filled(name: str, config: SparseConfig = MINIATURE, **settings: Any) -> SparseNetwork:
    kinds: dict[str, type[SparseDrive] | type[DiffusionDrive]] = {
        "sparsedrive": SparseDrive,
        "diffusiondrive": DiffusionDrive,
    }
    network = kinds[name](config, **settings)
    shapes = {key: tuple(value.shape) for key, value in network.state_dict().items()}
    state = recipe().state(shapes)
    network.load_state_dict({key: torch.from_numpy(np.asarray(value)) for key, value in state.items()}, strict=True)
    return network


def projections() -> NDArray[np.float32]:
    """Six cameras at the lidar origin that look round in a circle."""
    found = []
    for angle in np.deg2rad([90, 30, 150, 270, 210, 330]):
        forward = np.array([np.cos(angle), np.sin(angle), 0])
        right = np.array([np.sin(angle), -np.cos(angle), 0])
        rows = np.stack([64 * forward + 50 * right, 32 * forward + [0, 0, -40], forward])
        matrix = np.eye(4)
        matrix[:3, :3] = rows
        found.append(matrix)
    return np.array(found, np.float32)


def frame(number: int, scene_token: str = "scene") -> SparseInputs:
    height, width = MINIATURE.image_height_px, MINIATURE.image_width_px
    coarse = seeded_normal(f"input:image:coarse:frame{number}", (6, 3, height // 16, width // 16), "mini")
    fine = seeded_normal(f"input:image:fine:frame{number}", (6, 3, height, width), "mini")
    images = (np.kron(coarse, np.ones((16, 16))) + 0.5 * fine).astype(np.float32)
    turn, cosine, sine = 0.1 * number, np.cos(0.1 * number), np.sin(0.1 * number)
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = [[cosine, -sine], [sine, cosine]], (600 + 3 * turn, 1600 - 5 * number)
    return SparseInputs(
        images=torch.from_numpy(images),
        projections=torch.from_numpy(projections()),
        timestamp_s=1.5e9 + TIMES_S[number],
        global_T_lidar=torch.from_numpy(pose),
        command=number % 3,
        scene_token=scene_token,
    )


def noise(number: int) -> torch.Tensor:
    return torch.from_numpy(seeded_normal(f"noise{number}", (6, 6, 2), "mini")).float()


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
    manifest |= {"image_hw": [MINIATURE.image_height_px, MINIATURE.image_width_px], "n_frames": len(TIMES_S)}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert isinstance(made.kept_buffers, dict)
    np.savez(folder / "kept_buffers.npz", **{key: np.array(v, np.float32) for key, v in made.kept_buffers.items()})
    inputs: dict[str, Any] = {}
    statistics: dict[str, Any] = {}
    for number in range(len(TIMES_S)):
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
        with torch.inference_mode(), traced(network, []) as trace:
            predictions = network.predict(given, noise(number))
        if swapped and number == 0:
            network.memory = _with_two_swapped(network.memory)
        order = Order.of(network, predictions, GoldenArrays(folder, {}))
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


def _with_two_swapped(memory: Memory | None) -> Memory:
    assert memory is not None
    places = torch.arange(MINIATURE.remembered_anchors)
    places[[2, 3]] = places[[3, 2]]
    agents = memory.agents
    swapped = Remembered(
        agents.features[places], agents.anchors[places], agents.confidence[places], agents.rows[places]
    )
    return replace(memory, agents=swapped, tracks=replace(memory.tracks, ids=memory.tracks.ids[places]))


def change(path: Path, name: str, value: Any) -> None:
    """Put another array into an npz file, or with ``None`` none."""
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays[name] = value(arrays[name]) if callable(value) else value
    np.savez(path, **{key: array for key, array in arrays.items() if array is not None})


def without_memory_across_scenes() -> SparseConfig:
    return replace(MINIATURE, memory_crosses_scenes=False)


def _statistic(values: NDArray[Any]) -> dict[str, Any]:
    return {
        "shape": list(values.shape),
        "mean": float(values.mean()),
        "std": float(values.std(ddof=1)),
        "absmax": float(np.abs(values).max()),
        "first": values.reshape(-1)[:4].tolist(),
    }
