"""Quantities in VAD's golden sets, computed by our network from the same inputs."""

from dataclasses import replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from adapters.extensions.golden_sets.parity_set import GoldenNetwork, ParitySet, build_network, compare_frame
from adapters.extensions.golden_sets.tensors import Quantity, Tolerance, tap_features
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.selection import (
    VADBoxSelection,
    VADLineSelection,
    VADPredictions,
    select,
    select_boxes,
    select_lines,
)
from benchmark.geometry import Bools
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays

EXACT: Final = Tolerance(1e-3)
"""Every value within a thousandth of its spread: what comes before the decoders, and what comes after all others."""
BEV: Final = Tolerance(1e-4, of_spread=False)
PLAN: Final = Tolerance(1e-3, of_spread=False)
"""A millimetre."""
DECODED: Final = Tolerance(1e-2, of_spread=False, share=0.999)
"""Logits, box codes, metres of forecasts and the states they are read from."""
PLACES: Final = Tolerance(1e-3, share=0.999)
SCORES: Final = Tolerance(2.5e-3, of_spread=False)
"""Tolerance `DECODED` as it applies to sigmoids of logits."""
TOO_CLOSE: Final = 2e-5
"""Lanes whose distance from an agent is so close to the limit may be seen or not, on another processor."""
TOO_CLOSE_SCORE: Final = 1e-4
TIED: Final = 1e-3
"""Neighbours in a list whose scores are so close may have changed places."""
SAME_M: Final = 1.0
"""Boxes and lines of which a coordinate is farther apart are not the same one."""
PARTS: Final = ("motion_decoder", "motion_map_decoder", "ego_agent_decoder", "ego_map_decoder")


def compare_vad(comparison: Comparison, network: VAD, golden: ParitySet) -> None:
    """Run the frames of a golden set with carried state and compare each."""
    network.reset()
    device = next(network.parameters()).device
    for frame, stored in enumerate(golden.outputs):
        inputs = _inputs(golden, network.config, frame, device)
        with tap_features(network, "pts_bbox_head", PARTS) as taps:
            can_bus = network.ego_motion(inputs).can_bus
            predictions = network.predict(inputs)
        ours = {name: Quantity.of(tensor, EXACT) for name, tensor in taps.items()}
        ours["can_bus_seen_by_model"] = Quantity.of(can_bus, EXACT)
        undecided = _undecided_agents(network.config, predictions)
        ours |= _raw_quantities(predictions, undecided, taps)
        ours["plan"] = Quantity.of(select(network.config, predictions, inputs.command).plan, PLAN)
        ours |= _listed_boxes(select_boxes(network.config, predictions), predictions, undecided, stored)
        ours |= _listed_lines(select_lines(network.config, predictions), stored)
        compare_frame(comparison.at(f"{golden.folder.name}, frame {frame}"), golden, frame, ours)


def _inputs(golden: ParitySet, config: VADConfig, frame: int, device: torch.device) -> VADInputs:
    """One frame of the set."""
    inputs = golden.inputs
    return VADInputs(
        images=golden.camera_images(frame, config.cameras).to(device),
        lidar2img=torch.from_numpy(inputs.floats("lidar2img", config.cameras, 4, 4)).to(device),
        can_bus=torch.from_numpy(inputs.floats("can_bus", None, 18)[frame]),
        command=int(inputs.floats("ego_fut_cmd", None, config.commands)[frame].argmax()),
        scene_token=golden.recipe.scene_tokens[frame],
    )


def _undecided_agents(config: VADConfig, predictions: VADPredictions) -> Bools:
    """(A,) agents of which it hangs on the last bits which lanes they see."""
    points = predictions.map_points[-1]
    nearest = points.norm(dim=-1).argmin(1)
    lanes = points[torch.arange(len(points), device=points.device), nearest]
    distance = (lanes - predictions.agent_references[-1, :, None, :2]).norm(dim=-1)
    score = predictions.map_class_logits[-1].sigmoid().amax(-1)
    counts = score > config.lane_score - TOO_CLOSE_SCORE
    close = ((distance - config.lane_distance).abs() < TOO_CLOSE) & counts
    close_score = (score - config.lane_score).abs() < TOO_CLOSE_SCORE
    doubtful = close | (close_score & (distance < config.lane_distance + TOO_CLOSE))
    undecided: Bools = doubtful.any(1).cpu().numpy()
    return undecided


def _raw_quantities(predictions: VADPredictions, undecided: Bools, taps: dict[str, Tensor]) -> dict[str, Quantity]:
    """Everything that is not a list, under the names of the set."""
    p, of = predictions, Quantity.of
    modes = predictions.mode_logits.shape[1]
    return {
        "bev_embed": of(p.bev, BEV),
        "det_query_states": of(p.agent_states, DECODED),
        "det_init_reference": of(p.agent_first_references, EXACT),
        "det_inter_references": of(p.agent_references, PLACES),
        "map_query_states": of(p.map_states, DECODED),
        "map_init_reference": of(p.map_first_references, EXACT),
        "map_inter_references": of(p.map_references, PLACES),
        "all_cls_scores": of(p.class_logits, DECODED),
        "all_bbox_preds": of(p.box_codes, DECODED),
        "map_all_cls_scores": of(p.map_class_logits, DECODED),
        "map_all_bbox_preds": of(p.map_extents, PLACES),
        "map_all_pts_preds_last": of(p.map_points[-1], PLACES),
        "map_all_pts_preds": of(p.map_points, PLACES),
        "motion_decoder": of(taps["motion_decoder"], DECODED),
        "motion_map_decoder": of(taps["motion_map_decoder"].flatten(0, 1), DECODED, np.repeat(undecided, modes)),
        "all_traj_preds_last": of(p.mode_offsets.flatten(2), DECODED, undecided),
        "all_traj_cls_scores_last": of(p.mode_logits, DECODED, undecided),
        "ego_fut_preds": of(p.plan_offsets, PLAN),
    }


def _listed_boxes(
    boxes: VADBoxSelection, predictions: VADPredictions, undecided: Bools, stored: GoldenArrays
) -> dict[str, Quantity]:
    """Reported boxes in the order of the set."""
    trajectories = predictions.mode_offsets[boxes.agents].flatten(2)
    ours = {
        "dec_boxes_3d": Quantity.of(boxes.boxes, DECODED),
        "dec_trajs_3d": Quantity.of(trajectories, DECODED, undecided[boxes.agents.cpu().numpy()]),
        "dec_labels_3d": Quantity.of(boxes.labels, EXACT),
        "dec_scores_3d": Quantity.of(boxes.scores, SCORES),
    }
    return _reorder_ties(ours, stored, "dec_boxes_3d", "dec_scores_3d")


def _listed_lines(lines: VADLineSelection, stored: GoldenArrays) -> dict[str, Quantity]:
    """Reported map elements in the order of the set."""
    ours = {
        "dec_map_pts": Quantity.of(lines.points, PLACES),
        "dec_map_boxes": Quantity.of(lines.corners, PLACES),
        "dec_map_labels": Quantity.of(lines.labels, EXACT),
        "dec_map_scores": Quantity.of(lines.scores, SCORES),
    }
    return _reorder_ties(ours, stored, "dec_map_boxes", "dec_map_scores")


def _reorder_ties(ours: dict[str, Quantity], stored: GoldenArrays, boxes: str, scores: str) -> dict[str, Quantity]:
    """Lists in which neighbours with tied scores have the places that the set gives them."""
    listed = {name: replace(quantity, listed=True) for name, quantity in ours.items()}
    if boxes not in stored.names or scores not in stored.names:
        return listed
    own_boxes, own_scores = ours[boxes].values, ours[scores].values
    golden_boxes = stored.floats(boxes, None, own_boxes.shape[1])
    golden_scores = stored.floats(scores, None)
    if golden_boxes.shape != own_boxes.shape or golden_scores.shape != own_scores.shape:
        return listed
    apart = np.abs(golden_boxes[:, None] - own_boxes[None]).max(-1)
    apart[(np.abs(golden_scores[:, None] - own_scores[None]) > TIED) | (apart > SAME_M)] = np.inf
    order, paired = _match_pairs(apart)
    # Of two with tied scores, which is reported last and which is dropped is as arbitrary as their order.
    last = ~paired & (golden_scores < golden_scores.min(initial=1.0) + TIED)
    return {
        name: replace(
            quantity,
            values=quantity.values[order],
            undecided=last if quantity.undecided is None else last | quantity.undecided[order],
        )
        for name, quantity in listed.items()
    }


def _match_pairs(apart: NDArray[np.float64]) -> tuple[NDArray[np.int64], Bools]:
    """Nearest column for each row, closest pairs first, each column once, and whether the two are a pair at all.

    Rows without a pair get the columns that are left, in order.
    """
    count = len(apart)
    order = np.full(count, -1, np.int64)
    free = np.ones(count, np.bool_)
    for pair in np.argsort(apart, axis=None, kind="stable"):
        row, column = divmod(int(pair), count)
        if order[row] < 0 and free[column] and np.isfinite(apart[row, column]):
            order[row], free[column] = column, False
    paired = order >= 0
    order[~paired] = np.flatnonzero(free)
    return order, paired


GOLDEN: Final = GoldenNetwork(ParitySet.read, build_network, compare_vad)
