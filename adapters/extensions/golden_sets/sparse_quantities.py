"""What golden sets of the sparse networks store, from our networks, and how near it must be."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from adapters.extensions.golden_sets.sparse_order import Order, Rows
from adapters.networks.sparse.boxes import decode_boxes
from adapters.networks.sparse.model import Memory, SparseNetwork
from adapters.networks.sparse.noise_schedule import TIMESTEPS
from adapters.networks.sparse.selection import (
    SparsePredictions,
    forecast_centres,
    select_boxes,
    select_lines,
    select_plan,
)


class Rule(Enum):
    """How near a quantity must be.

    Attributes:
        METRES: Within a millimetre.
        SPREAD: Within a thousandth of the spread of the golden numbers.
        ROWS: The same for nearly all rows.
        FORECASTS: The same for most rows. Headings turn points that lie 57 m away, and a metre is a full turn of the
            sines that the forecasts are read from, so that rounding shows in them.
        EQUAL: Equal.
    """

    METRES = "m"
    SPREAD = "of its spread"
    ROWS = "of its spread, 97 % of rows"
    FORECASTS = "of its spread, 95 % of rows"
    EQUAL = "equal"


@dataclass(frozen=True, slots=True)
class Quantity:
    """One array of ours.

    Attributes:
        values: In the golden order of rows, with the axes that the sets have: what a head gives has one more in front.
        rule: How near it must be.
    """

    values: NDArray[Any]
    rule: Rule


def frame_quantities(
    network: SparseNetwork, predictions: SparsePredictions, order: Order, command: int, fresh: bool | None
) -> dict[str, Quantity]:
    """Everything but feature maps that a set may store of a frame.

    Args:
        network: Has computed the frame and remembers it.
        predictions: Of the frame.
        order: Of its rows.
        command: Of the frame.
        fresh: Whether what was remembered was used; ``None`` where nothing was.

    Returns:
        Quantities by the names of the sets.
    """
    found = _stages(predictions, order)
    found |= _planner(predictions, order)
    found |= _reported(network, predictions, order, command)
    found |= _denoising(predictions)
    if network.memory is not None:
        found |= _remembered(network.memory, len(order.agents))
        if fresh is not None:
            found["state_det_bank_mask"] = Quantity(np.array([fresh], np.bool_), Rule.EQUAL)
    return found


def map_quantities(backbone: list[Tensor], pyramid: list[Tensor]) -> dict[str, Quantity]:
    """Feature maps by the names of the sets."""
    found = {f"backbone_c{level + 2}": _numbers(features, Rule.SPREAD) for level, features in enumerate(backbone)}
    return found | {f"fpn_p{level}": _numbers(features, Rule.SPREAD) for level, features in enumerate(pyramid)}


def _numbers(tensor: Tensor, rule: Rule, rows: Rows | None = None) -> Quantity:
    values = tensor.detach().cpu().numpy()
    return Quantity(values if rows is None else values[rows], rule)


def _batch(tensor: Tensor, rule: Rule, rows: Rows | None = None) -> Quantity:
    return replace(found := _numbers(tensor, rule, rows), values=found.values[None])


def _stages(predictions: SparsePredictions, order: Order) -> dict[str, Quantity]:
    agents, lines = predictions.agents, predictions.lines
    found = {
        "det_instance_feature": _batch(agents.features, Rule.ROWS, order.agents),
        "det_anchor_embed": _batch(agents.embeddings, Rule.ROWS, order.agents),
        "map_instance_feature": _batch(lines.features, Rule.SPREAD, order.lines),
        "map_anchor_embed": _batch(lines.embeddings, Rule.SPREAD, order.lines),
    }
    for number, (boxes, drawn) in enumerate(zip(agents.stages, lines.stages, strict=True)):
        # Rows find their order behind the first stage.
        rows, line_rows = (order.agents, order.lines) if number else (None, None)
        found[f"det_cls_{number}"] = _batch(boxes.logits, Rule.ROWS, rows)
        found[f"det_reg_{number}"] = _batch(boxes.anchors, Rule.ROWS, rows)
        if boxes.qualities is not None:
            found[f"det_quality_{number}"] = _batch(boxes.qualities, Rule.ROWS, rows)
        found[f"map_cls_{number}"] = _batch(drawn.logits, Rule.SPREAD, line_rows)
        found[f"map_reg_{number}"] = _batch(drawn.anchors, Rule.SPREAD, line_rows)
    return found


def _planner(predictions: SparsePredictions, order: Order) -> dict[str, Quantity]:
    planner = predictions.planner
    return {
        "motion_cls": _batch(planner.motion_logits, Rule.FORECASTS, order.agents),
        "motion_reg": _batch(planner.motion_offsets, Rule.FORECASTS, order.agents),
        "plan_cls": _batch(planner.plan_logits.reshape(1, -1), Rule.SPREAD),
        "plan_reg": _batch(planner.plan_offsets.flatten(0, 1)[None], Rule.METRES),
        "plan_status": _batch(planner.status[None], Rule.SPREAD),
    }


def _reported(
    network: SparseNetwork, predictions: SparsePredictions, order: Order, command: int
) -> dict[str, Quantity]:
    config, planner = network.config, predictions.planner
    boxes, lines = select_boxes(config, predictions.agents), select_lines(config, predictions.lines)
    plan = select_plan(config, predictions, command)
    rows, drawn = boxes.rows[torch.from_numpy(order.boxes)], order.vectors
    past = decode_boxes(planner.queue.boxes.transpose(0, 1))
    # After a frame that was followed, numbers of rows that changed places are those of the set.
    numbers = predictions.track_ids if network.memory is None else _numbers_of(network.memory, order)
    return {
        "result_boxes_3d": _numbers(decode_boxes(predictions.agents.anchors)[rows], Rule.ROWS),
        # Scores as they fall: of rows that changed places they are nearly the same, or the order is wrong.
        "result_scores_3d": _numbers(boxes.scores, Rule.SPREAD),
        "result_labels_3d": _numbers(boxes.labels, Rule.EQUAL, order.boxes),
        "result_cls_scores": _numbers(boxes.class_scores, Rule.SPREAD),
        "result_instance_ids": _numbers(numbers[rows], Rule.EQUAL),
        "result_trajs_3d": _numbers(forecast_centres(predictions)[rows], Rule.FORECASTS),
        "result_trajs_score": _numbers(planner.motion_logits[rows].sigmoid(), Rule.FORECASTS),
        "result_period": _numbers(planner.queue.periods[rows], Rule.EQUAL),
        "result_anchor_queue": _numbers(past[rows], Rule.ROWS),
        "result_ego_anchor_queue": _numbers(decode_boxes(planner.queue.ego_boxes.transpose(0, 1)), Rule.SPREAD),
        "result_ego_period": Quantity(np.array([planner.queue.ego_period]), Rule.EQUAL),
        "result_map_vectors": _numbers(lines.points, Rule.SPREAD, drawn),
        "result_map_scores": _numbers(lines.scores, Rule.SPREAD),
        "result_map_labels": _numbers(lines.labels, Rule.EQUAL, drawn),
        "result_planning": _numbers(plan.modes, Rule.METRES),
        "result_planning_score": _numbers(plan.scores, Rule.SPREAD),
        "result_final_planning": _numbers(plan.plan, Rule.METRES),
        "final_planning": _numbers(plan.plan, Rule.METRES),
        "planning_score": _numbers(plan.scores, Rule.SPREAD),
    }


def _numbers_of(memory: Memory, order: Order) -> Tensor:
    """(N,) track numbers of our rows; what is remembered is in the golden order."""
    numbers = torch.empty_like(memory.queue.ids)
    numbers[torch.from_numpy(order.agents)] = memory.queue.ids
    return numbers


def _denoising(predictions: SparsePredictions) -> dict[str, Quantity]:
    steps: Mapping[str, Tensor] = predictions.planner.denoising
    if not steps:
        return {}
    found = {
        "diff_anchor_normalised": _batch(steps["anchors"], Rule.SPREAD),
        "diff_noise": _batch(steps["noise"], Rule.SPREAD),
        "diff_noisy_start": _batch(steps["start"], Rule.SPREAD),
    }
    for step, timestep in enumerate(TIMESTEPS):
        found[f"diff_prev_sample_step{step}"] = _numbers(steps[f"sample {step}"], Rule.SPREAD)
        found[f"diff_timestep_step{step}"] = Quantity(np.array([timestep]), Rule.EQUAL)
        for block in range(2):
            found[f"diff_refine{block}_reg_step{step}"] = _numbers(steps[f"offsets {block} {step}"], Rule.METRES)
            found[f"diff_refine{block}_cls_step{step}"] = _numbers(steps[f"logits {block} {step}"], Rule.SPREAD)
    return found


def _remembered(memory: Memory, agents: int) -> dict[str, Quantity]:
    queue, tracks = memory.queue, memory.tracks
    ids = np.full(agents, -1, np.int64)
    ids[: len(tracks.ids)] = tracks.ids.cpu().numpy()
    return {
        "det_instance_id": _batch(queue.ids, Rule.EQUAL),
        "state_det_cached_anchor": _batch(memory.agents.anchors, Rule.ROWS),
        "state_det_confidence": _batch(memory.agents.confidence, Rule.SPREAD),
        "state_map_cached_anchor": _batch(memory.lines.anchors, Rule.SPREAD),
        "state_map_confidence": _batch(memory.lines.confidence, Rule.SPREAD),
        "state_cached_instance_id": Quantity(ids[None], Rule.EQUAL),
        "state_period": _batch(queue.periods, Rule.EQUAL),
        "state_ego_period": Quantity(np.array([[queue.ego_period]]), Rule.EQUAL),
        "state_ego_anchor_last": _batch(queue.ego_boxes[-1], Rule.SPREAD),
        "state_prev_id": _numbers(tracks.next_id, Rule.EQUAL),
    }
