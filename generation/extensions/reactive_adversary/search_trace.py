"""What an adversary considered at a planning frame, as it is shown (`benchmark.records.search_trace`)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmark.dynamics.bicycle import MotionModel, VehicleState
from benchmark.records.search_trace import FrameAction, SearchTraceFrame
from benchmark.scene import Scene
from benchmark.scene_pages.page_tracks import find_origin
from generation.search.hyperparameters import HyperParameters
from generation.search.refinement import Refinement, build_trace_frame


def build_search_trace(
    scene: Scene,
    agent: int,
    frame: int,
    state: VehicleState,
    found: Refinement | None,
    picked: tuple[int, int] | None,
    hyper: HyperParameters,
    model: MotionModel,
    *,
    as_made: bool,
) -> Mapping[str, Any]:
    """A `SearchTraceFrame` as JSON: candidates of the round that the driven one, `picked`, is from, else of the best.

    `as_made` is whether the track that the scene was made with went on.
    """
    did: FrameAction = "track" if as_made else "slowed" if picked is None else "searched"
    shown: dict[str, Any] = {"frame": frame, "time_us": int(scene.timestamps_us[frame]), "did": did}
    if found is None:
        return SearchTraceFrame.model_validate(shown).model_dump(mode="json")
    number, index = picked or (found.round, found.chosen)
    rounds = build_trace_frame(scene, agent, frame, state, replace(found, round=number, chosen=index), hyper, model)
    best, origin = rounds.rounds[number], np.array(find_origin(scene))
    lines = np.array(best.candidates, np.float64).reshape(len(best.candidates), -1, 2) + origin
    shown |= {
        "candidates": np.round(lines, 2).tolist(),
        "scores": best.scores,
        "chosen": None if picked is None else rounds.chosen,
    }
    return SearchTraceFrame.model_validate(shown).model_dump(mode="json")
