"""Rows that changed places: where scores nearly tie, another processor may sort them in another order."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from adapters.networks.sparse.decoder import Decoded, Remembered, SparseDecoder
from adapters.networks.sparse.model import Memory, SparseNetwork
from adapters.networks.sparse.selection import SparsePredictions, select_boxes, select_lines
from adapters.networks.sparse.tracks import Tracks
from benchmark.geometry import Floats
from benchmark.verification.golden import GoldenArrays

Rows = NDArray[np.int64]
TIED: Final = 1e-4
"""Rows whose scores are so close may change places."""
MOVED: Final = 0.02
"""A row with a number that is further than this from the golden one, in metres, logits or scores, may be another."""


@dataclass(frozen=True, slots=True)
class Order:
    """Rows of ours for each row of the golden set.

    `agents` and `lines` are of all instances, from the second stage on; `boxes` and `vectors` of the reported ones.
    """

    agents: Rows
    lines: Rows
    boxes: Rows
    vectors: Rows

    @classmethod
    def of(cls, network: SparseNetwork, predictions: SparsePredictions, stored: GoldenArrays) -> "Order":
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
            _order(agents.anchors, codes),
            _order(lines.anchors, places),
            _order(agents.anchors[boxes.rows, :3], reported),
            _order(torch.cat([vectors.points.flatten(1), vectors.labels[:, None]], 1), drawn),
        )

    @property
    def moved(self) -> float:
        """Largest share of rows that are not where they were."""
        parts = (self.agents, self.lines, self.boxes, self.vectors)
        return max(float((rows != np.arange(len(rows))).mean()) for rows in parts)


def follow(
    network: SparseNetwork,
    predictions: SparsePredictions,
    before: Memory | None,
    order: Order,
    stored: GoldenArrays,
) -> None:
    """Put what a network remembers into the golden order, so that later frames can be compared row by row.

    What is remembered of a row is ours in any case; only where it stands is the set's, and its number, which follows
    from where it stands. Where that takes more than changes of place at ties, nothing is changed.
    """
    memory, head = network.memory, network.head
    names = {"det_instance_id", "state_cached_instance_id", "state_map_cached_anchor"}
    if memory is None or not names <= stored.names:
        return
    count, queue = len(order.agents), memory.queue
    ids = stored.integers("det_instance_id", 1, count)[0]
    kept = stored.integers("state_cached_instance_id", 1, count)[0, : head.det_head.remembered]
    rows = _rows_of(kept, ids, predictions.track_ids.cpu().numpy(), order.agents)
    line_rows = _nearest(predictions.lines, stored.floats("state_map_cached_anchor", 1, *memory.lines.anchors.shape)[0])
    if rows is None or line_rows is None:
        return
    agents = _kept(head.det_head, predictions.agents, before.agents if before else None, rows)
    lines = _kept(head.map_head, predictions.lines, before.lines if before else None, line_rows)
    for ours, theirs in ((memory.agents, agents), (memory.lines, lines)):
        if not bool(((ours.confidence - theirs.confidence).abs() <= TIED).all()):
            return
    device = queue.ids.device
    places = torch.from_numpy(order.agents).to(device)
    network.memory = replace(
        memory,
        agents=agents,
        lines=lines,
        tracks=Tracks(torch.from_numpy(kept).to(device), memory.tracks.next_id),
        queue=replace(
            queue,
            features=queue.features[:, places],
            boxes=queue.boxes[:, places],
            periods=queue.periods[places],
            ids=torch.from_numpy(ids).to(device),
            confidence=queue.confidence[places],
        ),
    )


def _rows_of(kept: Rows, ids: Rows, own: Rows, order: Rows) -> Rows | None:
    """Our rows that have the golden numbers `kept`; nothing if numbers differ where nothing changed places."""
    settled = order == np.arange(len(order))
    same = np.array_equal(own[settled], ids[settled]) and np.array_equal(np.sort(own), np.sort(ids))
    if not same or not np.isin(kept, ids).all():
        return None
    rows: Rows = order[np.argsort(ids)[np.searchsorted(np.sort(ids), kept)]]
    return rows


def _order(ours: torch.Tensor, golden: Floats | None) -> Rows:
    """Order of ours for the golden rows: the same row, or where that differs, the nearest of those that differ."""
    order = np.arange(len(ours))
    if golden is None:
        return order
    own = ours.detach().cpu().numpy().astype(np.float64)
    differ = np.flatnonzero(~(np.abs(own - golden).max(1) <= MOVED))
    apart = np.abs(golden[differ, None] - own[None, differ]).max(-1)
    # Only a pair that are each other's nearest, and near, has changed places.
    for row, column in enumerate(apart.argmin(1) if len(differ) else []):
        if apart[row, column] <= MOVED and apart[:, column].argmin() == row:
            order[differ[row]] = differ[column]
    return order if len(np.unique(order)) == len(order) else np.arange(len(ours))


def _nearest(decoded: Decoded, golden: Floats) -> Rows | None:
    """Instances that golden places are of; nothing if that is not clear."""
    own = decoded.anchors.detach().cpu().numpy().astype(np.float64)
    apart = np.abs(golden[:, None] - own).max(-1)
    rows = apart.argmin(1)
    clear = len(np.unique(rows)) == len(rows) and bool((apart.min(1) <= MOVED).all())
    return rows if clear else None


def _kept(decoder: SparseDecoder, decoded: Decoded, past: Remembered | None, rows: Rows) -> Remembered:
    return decoder.remember(decoded, past, torch.from_numpy(rows).to(decoded.features.device))
