"""`challenger-bench verify model --model uniad`: quantities and collision optimisation, with synthetic weights.

The optimisation runs alone, from stored occupancy, and behind the whole network.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Final

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.golden_sets.parity_set import GoldenNetwork, ParitySet, build_network, compare_frame
from adapters.extensions.golden_sets.tensors import Quantity, Tolerance, tap_features
from adapters.networks.layers.deformable_decoder import extent_corners
from adapters.networks.uniad.collision_optimiser import Solver, cost, move_plan, nearby_cells
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_masks import INSIDE, paste_masks, rank_masks
from adapters.networks.uniad.model import UniAD, UniADInputs
from adapters.networks.uniad.occupancy import ATTENDED_ABOVE
from adapters.networks.uniad.planning import UniADPredictions
from adapters.networks.uniad.tracking import Boxes, decode_instances, select_strongest_boxes
from benchmark.geometry import Bools, Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays

EXACT: Final = Tolerance(1e-3)
"""Every value within a thousandth of its spread."""
BEV: Final = Tolerance(1e-4, of_spread=False)
PLAN: Final = Tolerance(1e-3, of_spread=False)
"""A millimetre."""
DECODED: Final = Tolerance(1e-2, of_spread=False, share=0.999)
"""Logits, box codes, metres and states that many layers of random weights have stirred."""
SHARES: Final = Tolerance(1e-3, of_spread=False, share=0.999)
"""Quantities from 0 to 1 over the bird's-eye view."""
SCORES: Final = Tolerance(1e-3, of_spread=False)
MASKS: Final = Tolerance(0.1)
"""Values of masks: the specification calls them the least stable, and a few are thirty times the spread."""
CORNERS: Final = Tolerance(1e-2)
TOO_CLOSE_OCCUPANCY: Final = 1e-4
"""Cells so close to the limit of occupancy may be occupied or not, on another processor."""
TOO_CLOSE_SEEN: Final = 5e-5
"""Likewise cells that attend to a vehicle or do not."""
TOO_CLOSE_MASK: Final = 2e-2
"""Likewise cells at the rim of a mask."""


def frame_quantities(
    network: UniAD, predictions: UniADPredictions, seen: Tensor, taps: Mapping[str, Tensor], stored: GoldenArrays
) -> dict[str, Quantity]:
    """Quantities of a frame by golden names, lists in golden order; `seen` is the (18,) CAN bus vector."""
    p = predictions
    quantities = {name: Quantity.of(tensor, EXACT) for name, tensor in taps.items()}
    quantities["can_bus_seen_by_model"] = Quantity.of(seen, EXACT)
    quantities["bev_embed"] = Quantity.of(p.bev, BEV)
    positions = network.pts_bbox_head.positional_encoding().T
    quantities["bev_pos"] = Quantity.of(positions.reshape(-1, *network.config.grid.shape), EXACT)
    quantities |= _decoder(network, p)
    quantities |= _track_quantities(network, p)
    order = _match_ids(p.tracks.track_ids, stored, "track_ids")
    quantities |= _boxes(network, p, order, stored)
    quantities |= _map(p)
    quantities |= _masks(network, p, stored)
    quantities |= _motion(p, order)
    quantities |= _occupancy(p, order, stored)
    quantities["plan_mlp_fuser"] = Quantity.of(p.plan.fused, EXACT)
    quantities["plan_attn"] = Quantity.of(p.plan.attended, EXACT)
    quantities["sdc_traj_before_optim"] = Quantity.of(p.plan.positions_m, PLAN)
    return quantities


def _decoder(network: UniAD, p: UniADPredictions) -> dict[str, Quantity]:
    detections, of = p.detections, Quantity.of
    return {
        "all_cls_scores": of(detections.class_logits, DECODED),
        "cls_scores_last": of(detections.class_logits[-1], DECODED),
        "all_bbox_preds": of(detections.box_codes, DECODED),
        "bbox_preds_last": of(detections.box_codes[-1], DECODED),
        "last_ref_points": of(detections.reference_logits, DECODED),
        "query_feats": of(detections.states, DECODED),
        "past_traj_preds_last": of(network.pts_bbox_head.past_offsets(detections.states[-1]), DECODED),
    }


def _track_quantities(network: UniAD, p: UniADPredictions) -> dict[str, Quantity]:
    after, following, of = p.after, p.next_instances, Quantity.of
    fresh, active = network.config.queries + 1, p.after.track_ids >= 0
    return {
        "velo_update_ref_pts": of(p.moved_references, DECODED),
        "track_obj_idxes": of(after.track_ids, EXACT),
        "track_scores": of(after.scores, SCORES),
        "track_disappear_time": of(after.frames_asleep, EXACT),
        "track_save_period": of(after.frames_to_save, EXACT),
        "track_ref_pts": of(after.reference_logits, DECODED),
        "track_output_embedding_active_after_memory": of(after.states[active], DECODED),
        "track_mem_padding_active": of(after.memory_empty[active].byte(), EXACT),
        "track_mem_bank_active": of(after.memory[active], DECODED),
        "next_query_tail": of(following.queries[fresh:], DECODED),
        "next_ref_pts": of(following.reference_logits, DECODED),
        "next_obj_idxes": of(following.track_ids, EXACT),
    }


def _match_ids(ids: Tensor, stored: GoldenArrays, name: str) -> Tensor:
    """(N,) where the entries of a golden list are in ours: lists are ordered by scores, which may nearly tie."""
    our_ids = ids.tolist()
    golden = stored.floats(name, None).astype(int).tolist() if name in stored.names else our_ids
    if sorted(golden) != sorted(our_ids):
        return torch.arange(len(our_ids), device=ids.device)
    place = {number: place for place, number in enumerate(our_ids)}
    return torch.tensor([place[number] for number in golden], dtype=torch.int64, device=ids.device)


def _boxes(network: UniAD, p: UniADPredictions, order: Tensor, stored: GoldenArrays) -> dict[str, Quantity]:
    tracks = Boxes(*(getattr(p.tracks, name)[order] for name in p.tracks.__slots__))
    quantities = _box_quantities(tracks, "track") | {
        "track_ids": replace(Quantity.of(tracks.track_ids, EXACT), listed=True)
    }
    instances = p.after
    if "track_scores" in stored.names:
        golden = torch.from_numpy(stored.floats("track_scores", None)).float()
        if len(golden) == len(instances.scores):
            # The most certain ones as the set sees them; that our scores are the same is another comparison.
            chosen = golden.topk(min(network.config.max_boxes, len(golden))).indices.to(instances.scores.device)
            all_boxes = decode_instances(instances.kept(chosen))
            inside = torch.isin(chosen, _in_range(network, p))
            detected = Boxes(*(getattr(all_boxes, name)[inside] for name in all_boxes.__slots__))
            return quantities | _box_quantities(detected, "det") | _box_quantities(p.ego, "sdc")
    return (
        quantities
        | _box_quantities(select_strongest_boxes(instances, network.config), "det")
        | _box_quantities(p.ego, "sdc")
    )


def _in_range(network: UniAD, p: UniADPredictions) -> Tensor:
    """Indices of the instances whose boxes may be reported."""
    config = replace(network.config, max_boxes=len(p.after.scores))
    numbered = replace(p.after, track_ids=torch.arange(len(p.after.scores), device=p.after.scores.device))
    return select_strongest_boxes(numbered, config).track_ids


def _box_quantities(boxes: Boxes, kind: str) -> dict[str, Quantity]:
    quantities = {
        f"{kind}_boxes_3d": Quantity.of(boxes.boxes, DECODED),
        f"{kind}_scores_3d": Quantity.of(boxes.scores, SCORES),
        f"{kind}_labels_3d": Quantity.of(boxes.labels, EXACT),
    }
    return {name: replace(quantity, listed=True) for name, quantity in quantities.items()}


def _map(p: UniADPredictions) -> dict[str, Quantity]:
    elements, of = p.elements, Quantity.of
    return {
        "seg_memory": of(elements.cells, EXACT),
        "seg_query": of(elements.queries, DECODED),
        "seg_query_pos": of(elements.query_positions, EXACT),
        "seg_outputs_classes": of(elements.class_logits, DECODED),
        "seg_outputs_coords": of(elements.rectangles, SHARES),
    }


def _masks(network: UniAD, p: UniADPredictions, stored: GoldenArrays) -> dict[str, Quantity]:
    """Masks of the elements that the set chose, pasted in the order of the set."""
    elements, config = p.elements, network.config
    if "seg_outputs_classes" in stored.names:
        shape = (*elements.class_logits.shape[:1], 1, *elements.class_logits.shape[1:])
        logits = torch.from_numpy(stored.floats("seg_outputs_classes", *shape)[:, 0]).float()
        elements = replace(elements, class_logits=logits.to(elements.class_logits))
    masks = network.seg_head.masks(elements)
    scores, order = rank_masks(masks.values, masks.scores)
    size = torch.tensor([config.bev_columns, config.bev_rows] * 2, device=scores.device)
    corners = (extent_corners(masks.rectangles) * size).clamp(min=0).minimum(size)
    by_element = torch.empty_like(scores).scatter_(0, order, scores)
    boxes = torch.cat([corners, by_element[:, None]], 1)
    order = _golden_order(boxes, order, stored)
    road = paste_masks(masks.values, by_element[order], order, masks.labels, masks.drivable_values, config.map_classes)
    rim = ((masks.values - INSIDE).abs() < TOO_CLOSE_MASK).any(0)
    shore = ((masks.drivable_values - INSIDE).abs() < TOO_CLOSE_MASK).cpu().numpy()
    hanging = rim.expand_as(road.lanes).cpu().numpy()
    return {
        "seg_mask_scores": Quantity.of(torch.cat([masks.values, masks.drivable_values[None]]), MASKS),
        "seg_bbox": replace(Quantity.of(boxes[order], CORNERS), listed=True),
        "seg_labels": replace(Quantity.of(masks.labels[order], EXACT), listed=True),
        "seg_lane": Quantity.of(road.lanes.byte(), EXACT, hanging.reshape(-1)),
        "seg_lane_score": Quantity.of(road.lane_values, MASKS, hanging.reshape(-1)),
        "seg_drivable": Quantity.of(road.drivable.byte(), EXACT, shore.reshape(-1)),
        "seg_lane_area": _area_quantity(road.lanes, hanging, stored, "seg_lane_area", len(road.lanes)),
        "seg_drivable_area": _area_quantity(road.drivable[None], shore[None], stored, "seg_drivable_area"),
    }


def _golden_order(boxes: Tensor, order: Tensor, stored: GoldenArrays) -> Tensor:
    """(N,) which of our (N, 5) boxes is each golden one; our own order where they are not the same boxes."""
    golden = stored.floats("seg_bbox", None, 5) if "seg_bbox" in stored.names else np.zeros((0, 5))
    if golden.shape != tuple(boxes.shape):
        return order
    apart = np.abs(golden[:, None, :4] - boxes[None, :, :4].double().cpu().numpy()).max(-1)
    nearest = apart.argmin(1)
    return torch.from_numpy(nearest).to(order) if len(set(nearest.tolist())) == len(nearest) else order


def _area_quantity(inside: Tensor, hanging: Bools, stored: GoldenArrays, name: str, *shape: int) -> Quantity:
    """Cells of (K, ...) masks, stored in `shape`; undecided if cells too close to call explain a difference."""
    areas = inside.flatten(1).sum(1).cpu().numpy()
    doubtful = hanging.reshape(len(areas), -1).sum(1)
    golden = areas
    if name in stored.names:
        golden = stored.floats(name, *shape).reshape(-1)
    return Quantity(areas, EXACT, np.abs(areas - golden) <= doubtful)


def _motion(p: UniADPredictions, order: Tensor) -> dict[str, Quantity]:
    forecasts, of = p.forecasts, Quantity.of
    agents = torch.cat([order, order.new_tensor([len(order)])])
    return {
        "motion_traj_preds": of(forecasts.trajectories[:, agents], DECODED),
        "motion_traj_preds_sdc": of(forecasts.trajectories[:, -1], DECODED),
        "motion_traj_scores": of(forecasts.log_probabilities[:, agents], DECODED),
        "motion_traj_scores_sdc": of(forecasts.log_probabilities[:, -1], DECODED),
        "motion_sdc_traj_query": of(forecasts.queries[:, -1], DECODED),
        "motion_sdc_track_query": of(p.ego.states, DECODED),
        "motion_track_query_pos": of(forecasts.positions[order][p.vehicles[order]], EXACT),
        "motion_vehicle_track_scores": of(p.tracks.scores[order][p.vehicles[order]], SCORES),
    }


def _occupancy(p: UniADPredictions, order: Tensor, stored: GoldenArrays) -> dict[str, Quantity]:
    """Occupancy; from the step on in which a cell might attend to another vehicle, larger errors are left out."""
    occupancy = p.occupancy
    ours = torch.full((len(order),), -1, device=order.device)
    ours[p.vehicles] = torch.arange(int(p.vehicles.sum()), device=order.device)
    vehicles = ours[order][p.vehicles[order]]
    side = occupancy.logits.shape[-1]
    logits, masks = occupancy.logits[vehicles], occupancy.mask_logits[vehicles]
    upsampled = F.interpolate(masks, size=(side, side), mode="bilinear", align_corners=False) if len(masks) else logits
    steps = p.occupancy.occupied.shape[0]
    flips = np.zeros(steps, np.bool_)
    if len(masks):
        close = ((masks.sigmoid() - ATTENDED_ABOVE).abs() < TOO_CLOSE_SEEN).flatten(2).any(2).any(0)
        flips = np.maximum.accumulate(close.cpu().numpy())
    undecided = np.tile(flips, len(vehicles))
    hanging = ((occupancy.margin.abs() < TOO_CLOSE_OCCUPANCY).cpu().numpy()) | flips[:, None, None]
    packed = np.packbits(occupancy.occupied.cpu().numpy())
    doubtful = np.packbits(hanging) > 0
    return {
        "occ_ins_logits": Quantity.of(logits, EXACT, undecided),
        "occ_mask_preds": Quantity.of(upsampled, EXACT, undecided),
        "occ_seg_out_bits": Quantity(packed, EXACT, doubtful),
        "occ_seg_out_area": _area_quantity(occupancy.occupied, hanging, stored, "occ_seg_out_area", 1, steps),
    }


SAME_M: Final = 1e-2
"""Tolerance of the specification for the moved plan."""
SAME_COST: Final = 1e-5
"""Stored plans are in single precision."""
CELLS: Final = "occupied cells that count for the plan"
COSTS: Final = "cost of the moved plan above the stored one's"
WHOLE: Final = "sdc_traj behind the network (m)"
LOWEST: Final = "lowest cost above the stored plan's"


def compare_optimiser(comparison: Comparison, predictions: UniADPredictions, stored: GoldenArrays) -> None:
    """Compare moved plans of a frame; without plans in its golden numbers nothing is compared."""
    occupied = predictions.occupancy.occupied.cpu().numpy()
    steps = len(predictions.plan.positions_m)
    if not {"sdc_traj", "sdc_traj_before_optim", "occ_seg_out_bits"} <= stored.names:
        return
    golden = stored.floats("sdc_traj", 1, steps, 2)[0]
    before = stored.floats("sdc_traj_before_optim", 1, steps, 2)[0]
    bits = stored.floats("occ_seg_out_bits", None)
    stored_cells = np.unpackbits(bits.astype(np.uint8)).reshape(occupied.shape).astype(bool)
    nearby = [nearby_cells(*arguments) for arguments in zip(before, _per_point(stored_cells, before))]
    if "col_optim_cells" in stored.names:
        comparison.same(CELLS, [len(cells) for cells in nearby], stored.floats("col_optim_cells", steps))
    costs = np.array([cost(*arguments) for arguments in zip(golden, before, nearby, strict=True)])
    solvers: list[Solver] = ["newton", "ipopt"] if find_spec("casadi") else ["newton"]
    for solver in solvers:
        moved = move_plan(before, stored_cells, solver)
        comparison.numbers(f"sdc_traj by {solver} from stored occupancy (m)", moved.points, golden, SAME_M)
        comparison.errors(f"{COSTS}, {solver}", np.maximum(moved.costs - costs, 0), SAME_COST)
    lowest = move_plan(before, stored_cells, "lowest")
    comparison.errors(LOWEST, np.maximum(lowest.costs - costs, 0), SAME_COST)
    if lower := int(np.count_nonzero(lowest.costs < costs - SAME_COST)):
        comparison.note(LOWEST, f"lower in {lower} of {steps} points of {comparison.where}")
    # The plan from our own occupancy, but for points near which cells that are too close to call are different.
    plan = predictions.plan.positions_m.double().cpu().numpy()
    pairs = zip(plan, _per_point(occupied, plan), _per_point(stored_cells, plan), strict=True)
    same = np.array([np.array_equal(nearby_cells(at, ours), nearby_cells(at, theirs)) for at, ours, theirs in pairs])
    comparison.numbers(WHOLE, move_plan(plan, occupied).points[same], golden[same], SAME_M)
    if not same.all():
        note = f"{np.count_nonzero(~same)} points with other occupied cells left out in {comparison.where}"
        comparison.note(WHOLE, note)


def _per_point(occupied: Bools, plan: Floats) -> list[Bools]:
    """Occupancy, (rows, columns), that counts for each point of a plan."""
    return [occupied[min(step + 1, len(occupied) - 1)] for step in range(len(plan))]


ELSEWHERE: Final = ("sdc_traj", "col_optim_cells")
"""Quantities compared by `compare_optimiser`."""


def compare_uniad(comparison: Comparison, network: UniAD, golden: ParitySet) -> None:
    """Run the frames of a golden set with carried state and compare each."""
    network.reset()
    device, config = next(network.parameters()).device, network.config
    inputs = _Inputs.of(golden, config)
    network.motion_head.load_anchors(inputs.anchors)
    for number, stored in enumerate(golden.outputs):
        at, key_frame = comparison.at(f"{golden.folder.name}, frame {number}"), inputs.frame(golden, number, device)
        with tap_features(network) as taps:
            can_bus = network.ego_motion(key_frame).can_bus
            predictions = network.predict(key_frame)
            ours = frame_quantities(network, predictions, can_bus, taps, stored)
        compare_frame(at, golden, number, ours, ELSEWHERE)
        compare_optimiser(at, predictions, stored)


@dataclass(frozen=True, slots=True)
class _Inputs:
    """Inputs of all frames but for their images."""

    projections: Tensor
    can_bus: Tensor
    rotations: Tensor
    translations: Tensor
    timestamps_s: list[float]
    commands: list[int]
    anchors: Tensor

    @classmethod
    def of(cls, golden: ParitySet, config: UniADConfig) -> "_Inputs":
        """Those of a set."""
        arrays, frames = golden.inputs, len(golden.outputs)
        groups = (config.motion_groups, config.modes, config.forecast_steps, 2)
        commands = arrays.integers("command", frames)
        if ((commands < 0) | (commands >= config.commands)).any():
            raise ValueError(f"it has commands past {config.commands - 1}")
        return cls(
            projections=torch.from_numpy(arrays.floats("lidar2img", config.cameras, 4, 4)),
            can_bus=torch.from_numpy(arrays.floats("can_bus", frames, 18)),
            rotations=torch.from_numpy(arrays.floats("l2g_r_mat", frames, 3, 3)).float(),
            translations=torch.from_numpy(arrays.floats("l2g_t", frames, 3)).float(),
            timestamps_s=arrays.floats("timestamps", frames).tolist(),
            commands=commands.tolist(),
            anchors=torch.from_numpy(arrays.floats("motion_anchors", *groups)).float(),
        )

    def frame(self, golden: ParitySet, number: int, device: torch.device) -> UniADInputs:
        """One frame."""
        return UniADInputs(
            images=golden.camera_images(number, len(self.projections)).to(device),
            lidar2img=self.projections.to(device),
            can_bus=self.can_bus[number],
            l2g_r_mat=self.rotations[number],
            l2g_t=self.translations[number],
            timestamp=self.timestamps_s[number],
            command=self.commands[number],
            scene_token=golden.recipe.scene_tokens[number],
        )


GOLDEN: Final = GoldenNetwork(ParitySet.read, build_network, compare_uniad)
