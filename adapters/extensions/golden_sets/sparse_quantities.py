"""Quantities in golden sets of the sparse networks and their tolerances; near ties rows may be sorted otherwise."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from adapters.extensions.golden_sets.tensors import Quantity, Tolerance
from adapters.networks.sparse.boxes import decode_boxes
from adapters.networks.sparse.decoder import DecodedInstances, InstanceMemory, SparseDecoder
from adapters.networks.sparse.diffusion import TIMESTEPS
from adapters.networks.sparse.model import SparseMemory, SparseNetwork, TrackIds
from adapters.networks.sparse.selection import (
    SparsePredictions,
    forecast_centres,
    select_boxes,
    select_lines,
    select_plan,
)
from benchmark.geometry import Floats
from benchmark.verification.golden_sets import GoldenArrays

Rows = NDArray[np.int64]
TIED: Final = 1e-4
"""Rows whose scores are so close may change places."""
MOVED: Final = 0.02
"""A row with a number that is further than this from the golden one, in metres, logits or scores, may be another."""


@dataclass(frozen=True, slots=True)
class RowOrder:
    """Our row for each golden one: `agents` and `lines` from the second stage on, `boxes` and `vectors` reported."""

    agents: Rows
    lines: Rows
    boxes: Rows
    vectors: Rows

    @classmethod
    def of(cls, network: SparseNetwork, predictions: SparsePredictions, stored: GoldenArrays) -> "RowOrder":
        """Find the order of a frame's rows; what a set does not store stays as it is."""
        agents, lines = predictions.agents, predictions.lines
        boxes, vectors = select_boxes(network.config, agents), select_lines(network.config, lines)
        codes = stored.floats("det_reg_5", 1, *agents.anchors.shape)[0] if "det_reg_5" in stored.names else None
        places = stored.floats("map_reg_5", 1, *lines.anchors.shape)[0] if "map_reg_5" in stored.names else None
        reported, drawn = None, None
        if "result_boxes_3d" in stored.names:
            reported = stored.floats("result_boxes_3d", len(boxes.rows), None)[:, :3]
        if {"result_map_vectors", "result_map_labels"} <= stored.names:
            points = stored.floats("result_map_vectors", *vectors.points.shape).reshape(len(vectors.points), -1)
            drawn = np.concatenate([points, stored.integers("result_map_labels", len(points))[:, None]], 1)
        return cls(
            _match_rows(agents.anchors, codes),
            _match_rows(lines.anchors, places),
            _match_rows(agents.anchors[boxes.rows, :3], reported),
            _match_rows(torch.cat([vectors.points.flatten(1), vectors.labels[:, None]], 1), drawn),
        )

    @property
    def moved(self) -> float:
        """Largest share of rows that are not where they were."""
        parts = (self.agents, self.lines, self.boxes, self.vectors)
        return max(float((rows != np.arange(len(rows))).mean()) for rows in parts)


def reorder_memory(
    network: SparseNetwork,
    predictions: SparsePredictions,
    before: SparseMemory | None,
    order: RowOrder,
    stored: GoldenArrays,
) -> None:
    """Put what a network remembers into the golden order, so that later frames can be compared row by row.

    The memory of a row is always ours; only its position is the set's, and its number, which follows from it. If that
    takes more than swaps at ties, nothing is changed.
    """
    memory, head = network.memory, network.head
    names = {"det_instance_id", "state_cached_instance_id", "state_map_cached_anchor"}
    if memory is None or not names <= stored.names:
        return
    count, queue = len(order.agents), memory.queue
    ids = stored.integers("det_instance_id", 1, count)[0]
    cached_ids = stored.integers("state_cached_instance_id", 1, count)[0, : head.det_head.remembered]
    rows = _find_rows(cached_ids, ids, predictions.track_ids.cpu().numpy(), order.agents)
    line_rows = _find_nearest(
        predictions.lines, stored.floats("state_map_cached_anchor", 1, *memory.lines.anchors.shape)[0]
    )
    if rows is None or line_rows is None:
        return
    agents = _reorder_instances(head.det_head, predictions.agents, before.agents if before else None, rows)
    lines = _reorder_instances(head.map_head, predictions.lines, before.lines if before else None, line_rows)
    for ours, theirs in ((memory.agents, agents), (memory.lines, lines)):
        if not bool(((ours.confidence - theirs.confidence).abs() <= TIED).all()):
            return
    device = queue.ids.device
    places = torch.from_numpy(order.agents).to(device)
    network.memory = replace(
        memory,
        agents=agents,
        lines=lines,
        tracks=TrackIds(torch.from_numpy(cached_ids).to(device), memory.tracks.next_id),
        queue=replace(
            queue,
            features=queue.features[:, places],
            boxes=queue.boxes[:, places],
            periods=queue.periods[places],
            ids=torch.from_numpy(ids).to(device),
            confidence=queue.confidence[places],
        ),
    )


def _find_rows(cached_ids: Rows, ids: Rows, our_ids: Rows, order: Rows) -> Rows | None:
    """Our rows that have the golden numbers `kept`; nothing if numbers differ where nothing changed places."""
    settled = order == np.arange(len(order))
    same = np.array_equal(our_ids[settled], ids[settled]) and np.array_equal(np.sort(our_ids), np.sort(ids))
    if not same or not np.isin(cached_ids, ids).all():
        return None
    rows: Rows = order[np.argsort(ids)[np.searchsorted(np.sort(ids), cached_ids)]]
    return rows


def _match_rows(ours: torch.Tensor, golden: Floats | None) -> Rows:
    """Order of ours for the golden rows: the same row, or where that differs, the nearest of those that differ."""
    order = np.arange(len(ours))
    if golden is None:
        return order
    values = ours.detach().cpu().numpy().astype(np.float64)
    differ = np.flatnonzero(~(np.abs(values - golden).max(1) <= MOVED))
    apart = np.abs(golden[differ, None] - values[None, differ]).max(-1)
    # Only a pair that are each other's nearest, and near, has changed places.
    for row, column in enumerate(apart.argmin(1) if len(differ) else []):
        if apart[row, column] <= MOVED and apart[:, column].argmin() == row:
            order[differ[row]] = differ[column]
    return order if len(np.unique(order)) == len(order) else np.arange(len(ours))


def _find_nearest(decoded: DecodedInstances, golden: Floats) -> Rows | None:
    """Instances that golden places are of; nothing if that is not clear."""
    anchors = decoded.anchors.detach().cpu().numpy().astype(np.float64)
    apart = np.abs(golden[:, None] - anchors).max(-1)
    rows = apart.argmin(1)
    clear = len(np.unique(rows)) == len(rows) and bool((apart.min(1) <= MOVED).all())
    return rows if clear else None


def _reorder_instances(
    decoder: SparseDecoder, decoded: DecodedInstances, past: InstanceMemory | None, rows: Rows
) -> InstanceMemory:
    return decoder.remember(decoded, past, torch.from_numpy(rows).to(decoded.features.device))


OTHER_ROWS: Final = "all rows, and the largest number, where most count above (of their spread)"
OTHERS: Final = 0.05
"""For the rows that are left, of the spread."""
SHARE_OF_SPREAD: Final = 1e-3

METRES: Final = Tolerance(1e-3, of_spread=False, unit="m")
SPREAD: Final = Tolerance(SHARE_OF_SPREAD)
ROWS: Final = Tolerance(SHARE_OF_SPREAD, share=0.97, rows=True, others=OTHER_ROWS, allowed_of_others=OTHERS)
FORECASTS: Final = replace(ROWS, share=0.95)
"""Headings turn points that lie 57 m away, and a metre is a full turn of the sines that forecasts are read from."""
EQUAL: Final = SPREAD
"""Of whole numbers and verdicts, which must be equal."""


def frame_quantities(
    network: SparseNetwork, predictions: SparsePredictions, order: RowOrder, command: int, fresh: bool | None
) -> dict[str, Quantity]:
    """All that a set may store of a frame but feature maps, by its names, in the golden order of rows.

    What a head gives has one more axis in front. `fresh` is whether memory was used; ``None`` where there was none.
    """
    quantities = _stage_quantities(predictions, order)
    quantities |= _planner_quantities(predictions, order)
    quantities |= _output_quantities(network, predictions, order, command)
    quantities |= _denoising_quantities(predictions)
    if network.memory is not None:
        quantities |= _memory_quantities(network.memory, len(order.agents))
        if fresh is not None:
            quantities["state_det_bank_mask"] = Quantity(np.array([fresh], np.bool_), EQUAL)
    return quantities


def map_quantities(backbone: list[Tensor], pyramid: list[Tensor]) -> dict[str, Quantity]:
    """Feature maps by the names of the sets."""
    quantities = {f"backbone_c{level + 2}": _numbers(features, SPREAD) for level, features in enumerate(backbone)}
    return quantities | {f"fpn_p{level}": _numbers(features, SPREAD) for level, features in enumerate(pyramid)}


def _numbers(tensor: Tensor, tolerance: Tolerance, rows: Rows | None = None) -> Quantity:
    values = tensor.detach().cpu().numpy()
    return Quantity(values if rows is None else values[rows], tolerance)


def _batch(tensor: Tensor, tolerance: Tolerance, rows: Rows | None = None) -> Quantity:
    return replace(quantity := _numbers(tensor, tolerance, rows), values=quantity.values[None])


def _stage_quantities(predictions: SparsePredictions, order: RowOrder) -> dict[str, Quantity]:
    agents, lines = predictions.agents, predictions.lines
    quantities = {
        "det_instance_feature": _batch(agents.features, ROWS, order.agents),
        "det_anchor_embed": _batch(agents.embeddings, ROWS, order.agents),
        "map_instance_feature": _batch(lines.features, SPREAD, order.lines),
        "map_anchor_embed": _batch(lines.embeddings, SPREAD, order.lines),
    }
    for number, (boxes, drawn) in enumerate(zip(agents.stages, lines.stages, strict=True)):
        # Rows find their order behind the first stage.
        rows, line_rows = (order.agents, order.lines) if number else (None, None)
        quantities[f"det_cls_{number}"] = _batch(boxes.logits, ROWS, rows)
        quantities[f"det_reg_{number}"] = _batch(boxes.anchors, ROWS, rows)
        if boxes.qualities is not None:
            quantities[f"det_quality_{number}"] = _batch(boxes.qualities, ROWS, rows)
        quantities[f"map_cls_{number}"] = _batch(drawn.logits, SPREAD, line_rows)
        quantities[f"map_reg_{number}"] = _batch(drawn.anchors, SPREAD, line_rows)
    return quantities


def _planner_quantities(predictions: SparsePredictions, order: RowOrder) -> dict[str, Quantity]:
    planner = predictions.planner
    return {
        "motion_cls": _batch(planner.motion_logits, FORECASTS, order.agents),
        "motion_reg": _batch(planner.motion_offsets, FORECASTS, order.agents),
        "plan_cls": _batch(planner.plan_logits.reshape(1, -1), SPREAD),
        "plan_reg": _batch(planner.plan_offsets.flatten(0, 1)[None], METRES),
        "plan_status": _batch(planner.status[None], SPREAD),
    }


def _output_quantities(
    network: SparseNetwork, predictions: SparsePredictions, order: RowOrder, command: int
) -> dict[str, Quantity]:
    config, planner = network.config, predictions.planner
    boxes, lines = select_boxes(config, predictions.agents), select_lines(config, predictions.lines)
    plan = select_plan(config, predictions, command)
    rows, drawn = boxes.rows[torch.from_numpy(order.boxes)], order.vectors
    past = decode_boxes(planner.queue.boxes.transpose(0, 1))
    # After a frame that was followed, numbers of rows that changed places are those of the set.
    numbers = predictions.track_ids if network.memory is None else _track_ids_of(network.memory, order)
    return {
        "result_boxes_3d": _numbers(decode_boxes(predictions.agents.anchors)[rows], ROWS),
        # Scores as they fall: of rows that changed places they are nearly the same, or the order is wrong.
        "result_scores_3d": _numbers(boxes.scores, SPREAD),
        "result_labels_3d": _numbers(boxes.labels, EQUAL, order.boxes),
        "result_cls_scores": _numbers(boxes.class_scores, SPREAD),
        "result_instance_ids": _numbers(numbers[rows], EQUAL),
        "result_trajs_3d": _numbers(forecast_centres(predictions)[rows], FORECASTS),
        "result_trajs_score": _numbers(planner.motion_logits[rows].sigmoid(), FORECASTS),
        "result_period": _numbers(planner.queue.periods[rows], EQUAL),
        "result_anchor_queue": _numbers(past[rows], ROWS),
        "result_ego_anchor_queue": _numbers(decode_boxes(planner.queue.ego_boxes.transpose(0, 1)), SPREAD),
        "result_ego_period": Quantity(np.array([planner.queue.ego_period]), EQUAL),
        "result_map_vectors": _numbers(lines.points, SPREAD, drawn),
        "result_map_scores": _numbers(lines.scores, SPREAD),
        "result_map_labels": _numbers(lines.labels, EQUAL, drawn),
        "result_planning": _numbers(plan.modes, METRES),
        "result_planning_score": _numbers(plan.scores, SPREAD),
        "result_final_planning": _numbers(plan.plan, METRES),
        "final_planning": _numbers(plan.plan, METRES),
        "planning_score": _numbers(plan.scores, SPREAD),
    }


def _track_ids_of(memory: SparseMemory, order: RowOrder) -> Tensor:
    """(N,) track numbers of our rows; what is remembered is in the golden order."""
    numbers = torch.empty_like(memory.queue.ids)
    numbers[torch.from_numpy(order.agents)] = memory.queue.ids
    return numbers


def _denoising_quantities(predictions: SparsePredictions) -> dict[str, Quantity]:
    steps: Mapping[str, Tensor] = predictions.planner.denoising
    if not steps:
        return {}
    quantities = {
        "diff_anchor_normalised": _batch(steps["anchors"], SPREAD),
        "diff_noise": _batch(steps["noise"], SPREAD),
        "diff_noisy_start": _batch(steps["start"], SPREAD),
    }
    for step, timestep in enumerate(TIMESTEPS):
        quantities[f"diff_prev_sample_step{step}"] = _numbers(steps[f"sample {step}"], SPREAD)
        quantities[f"diff_timestep_step{step}"] = Quantity(np.array([timestep]), EQUAL)
        for block in range(2):
            quantities[f"diff_refine{block}_reg_step{step}"] = _numbers(steps[f"offsets {block} {step}"], METRES)
            quantities[f"diff_refine{block}_cls_step{step}"] = _numbers(steps[f"logits {block} {step}"], SPREAD)
    return quantities


def _memory_quantities(memory: SparseMemory, agents: int) -> dict[str, Quantity]:
    queue, tracks = memory.queue, memory.tracks
    ids = np.full(agents, -1, np.int64)
    ids[: len(tracks.ids)] = tracks.ids.cpu().numpy()
    return {
        "det_instance_id": _batch(queue.ids, EQUAL),
        "state_det_cached_anchor": _batch(memory.agents.anchors, ROWS),
        "state_det_confidence": _batch(memory.agents.confidence, SPREAD),
        "state_map_cached_anchor": _batch(memory.lines.anchors, SPREAD),
        "state_map_confidence": _batch(memory.lines.confidence, SPREAD),
        "state_cached_instance_id": Quantity(ids[None], EQUAL),
        "state_period": _batch(queue.periods, EQUAL),
        "state_ego_period": Quantity(np.array([[queue.ego_period]]), EQUAL),
        "state_ego_anchor_last": _batch(queue.ego_boxes[-1], SPREAD),
        "state_prev_id": _numbers(tracks.next_id, EQUAL),
    }
