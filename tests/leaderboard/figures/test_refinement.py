"""The figure of refinement: the same traces give the same bytes, whatever they hold, and names are only text."""

import io
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from benchmark.errors import InputError
from benchmark.records.run_schema import DataFacts
from benchmark.records.scene_pages import RefinementTrace, ScenePage, ScenePages, StoredScenePage, TraceFrame
from leaderboard.figures.refinement import draw_refinement, find_most_improved_frame, quartiles, refinement_figures

ROAD = ((-50.0, -7.0), (150.0, -7.0), (150.0, 7.0), (-50.0, 7.0), (-50.0, -7.0))
HOSTILE = ("$x_{1$ \\frac", "<script>&--", "a\x00b\nc", "日本語", "x" * 500, "")
ISLAND = ((20.0, -1.0), (20.0, 1.0), (24.0, 1.0), (24.0, -1.0), (20.0, -1.0))
FRAMES = 60


def sheet_named(scene: str, split: str = "adv", data: str = "d") -> ScenePage:
    """An ego and a faster adversary on a straight road."""

    def car(name: str, y_m: float, *, adversary: bool = False) -> dict[str, Any]:
        x_m = [0.7 * frame for frame in range(FRAMES)]
        return {
            "id": name, "category": "vehicle.car", "size_m": (4.6, 1.9, 1.7), "adversary": adversary, "first": 0,
            "x_m": x_m, "y_m": [y_m] * FRAMES, "yaw_rad": [0.0] * FRAMES,
        }  # fmt: skip

    return ScenePage.model_validate(
        {
            "schema": 1, "data": DataFacts(name=data, version="v1.0-mini", fingerprint="0" * 64), "split": split,
            "scene": scene, "source": scene, "description": "", "labels": (), "origin_m": (0.0, 0.0),
            "timestamps_us": [round(frame * 1e6 / 12) for frame in range(FRAMES)], "keyframes": (0,),
            "sample_tokens": ("t",), "agents": [car("other", -3.0), car("a", 3.0, adversary=True)],
            "ego": {
                "x_m": [0.5 * frame for frame in range(FRAMES)], "y_m": [0.0] * FRAMES, "yaw_rad": [0.0] * FRAMES,
                "length_m": 4.0, "width_m": 1.8, "centre_ahead_m": 1.0,
            },
            "road": {
                "drivable": ((ROAD, ISLAND),), "crossings": ((ROAD[:2],),), "walkways": (),
                "dividers": (
                    {"points": ((-50.0, 0.0), (150.0, 0.0)), "paint": "dashed-white"},
                    {"points": ((0.0, 1.0),), "paint": "solid-yellow"},
                    {"points": ((0.0, 1.0), (9.0, 1.0)), "paint": "unpainted"},
                ),
            },
            "cameras": (), "pictures": (), "adversary_edges": {}, "files": {},
        }
    )  # fmt: skip


def frame_of(frame: int, rounds: Sequence[Sequence[float | None]], /, **changes: Any) -> TraceFrame:
    """Candidates that fan out; ``rounds`` holds their scores."""
    made = []
    for scores in rounds:
        turns = np.linspace(-0.4, 0.4, max(len(scores), 1))[: len(scores)]
        lines = [
            [(0.7 * frame + 4.0 * step * math.cos(turn), 3.0 + 4.0 * step * math.sin(turn)) for step in range(7)]
            for turn in turns
        ]
        made.append({"candidates": lines, "scores": scores, "collision_free": len(scores)})
    best = {"frame": frame, "rounds": made, "chosen_round": len(rounds) - 1, "chosen": 0}
    return TraceFrame.model_validate(best | changes)


def stored(
    scene: str, *frames: TraceFrame, candidates: Any = 8, split: str = "adv", data: str = "d"
) -> StoredScenePage:
    trace = {
        "schema": 1, "scene": scene, "agent": "a", "origin_m": (0.0, 0.0), "search": {"candidates": candidates},
        "frames": frames,
    }  # fmt: skip
    return StoredScenePage(Path("somewhere"), sheet_named(scene, split, data), RefinementTrace.model_validate(trace))


def sheets_of(*found: StoredScenePage) -> ScenePages:
    return ScenePages({}, {(each.sheet.data.name, each.sheet.split, each.sheet.scene): each for each in found})


FALLING = [[20.0 / (1 + number), 3.0, None, 0.3 / (1 + number)] for number in range(6)]
GOOD = stored("s1", frame_of(12, FALLING), frame_of(24, FALLING[:1]))


def drawn(found: StoredScenePage, frame: int | None = None) -> bytes:
    """PNG of a figure that must be there; the SVG must be one."""
    png, svg = (draw_refinement(found, suffix, frame=frame) for suffix in (".png", ".svg"))
    assert png is not None
    assert svg is not None
    ElementTree.fromstring(svg)
    assert b"<script" not in svg
    assert imread(io.BytesIO(png))[..., :3].std() > 0.02
    return png


def test_the_same_trace_gives_the_same_bytes_whatever_the_users_settings() -> None:
    first = refinement_figures("d", sheets_of(GOOD))
    with mpl.rc_context({"font.size": 30, "svg.hashsalt": "other", "lines.linewidth": 9.0}):
        assert refinement_figures("d", sheets_of(GOOD)) == first
    assert [figure.name for figure in first] == ["refinement-adv-s1"]
    assert drawn(GOOD) == first[0].png
    assert drawn(GOOD, 24) != first[0].png


def test_the_first_traced_scenes_of_each_split_of_this_data_set_are_drawn() -> None:
    frame = frame_of(12, [[1.0, 2.0]])
    scenes = [stored(f"s{number}", frame) for number in range(5)]
    others = [stored("s0", frame, split="two"), stored("s9", frame, data="e")]
    untraced = StoredScenePage(Path("somewhere"), sheet_named("a"), None)
    names = [figure.name for figure in refinement_figures("d", sheets_of(*scenes[::-1], *others, untraced))]
    assert names == ["refinement-adv-s0", "refinement-adv-s1", "refinement-adv-s2", "refinement-two-s0"]
    assert refinement_figures("d", sheets_of()) == ()
    assert draw_refinement(untraced, ".png") is None


def test_the_frame_whose_best_score_falls_most_is_shown() -> None:
    frames = (
        frame_of(12, [[3.0, 9.0], [2.5, 9.0]]),
        frame_of(24, [[4.0], [1.0], [2.0]]),
        frame_of(36, [[2.5], [0.5]]),
        frame_of(48, [[None], [0.5]]),
        frame_of(56, [], chosen_round=0),
    )
    rounds = stored("s", *frames).rounds
    assert rounds is not None
    best = find_most_improved_frame(rounds)
    assert best is not None
    # 24 and 36 fall by the same; the last round counts, not the best.
    assert best.frame == 24
    nothing = stored("s", *frames[3:])
    assert nothing.rounds is not None
    assert find_most_improved_frame(nothing.rounds) is None
    assert draw_refinement(nothing, ".png") is None
    assert draw_refinement(GOOD, ".png", frame=13) is None


CASES: dict[str, StoredScenePage] = {
    **{f"{n} rounds": stored("s", frame_of(12, [[5.0 - 0.1 * each, 7.0] for each in range(n)])) for n in (1, 14)},
    **{
        f"scores {scores[:2]}": stored("s", frame_of(12, [scores, scores]))
        for scores in ([0.0, 0.0], [1e-9, 1e9], [-1.0, 2.0], [1e300, 1.0], [0.5, None], [7.0] * 64)
    },
    "the end of a scene": stored(HOSTILE[0], frame_of(FRAMES - 1, FALLING[:2])),
    **{
        f"{each} candidates": stored(name, frame_of(0, FALLING[:2]), candidates=each)
        for each, name in zip((None, "many", -1, 256, 10**12), HOSTILE[1:], strict=True)
    },
}


@pytest.mark.parametrize("case", CASES.values(), ids=range(len(CASES)))
def test_whatever_a_trace_holds_can_be_drawn(case: StoredScenePage) -> None:
    """Any number of rounds and candidates, any scores, the ends of a scene; names are only text."""
    drawn(case)


def test_points_that_are_missing_or_far_away_can_be_drawn() -> None:
    frame = frame_of(12, FALLING[:2])
    lines = [list(map(list, line)) for line in frame.rounds[0].candidates]
    lines[0], lines[1], lines[2][6] = [], lines[1][:1], [1e6, -1e6]
    first = frame.rounds[0].model_copy(update={"candidates": tuple(tuple(map(tuple, line)) for line in lines)})
    drawn(stored("s", frame.model_copy(update={"rounds": (first, frame.rounds[1])})))


@pytest.mark.parametrize(
    "changes", [{"chosen": 4}, {"chosen": -1}, {"chosen_round": 9}, {"chosen_round": -1}, {"frame": 999}, {"frame": -1}]
)
def test_a_trace_that_does_not_fit_together_is_refused(changes: dict[str, int]) -> None:
    with pytest.raises(InputError, match="is inconsistent at frame"):
        draw_refinement(stored("s", frame_of(12, FALLING, **changes)), ".png")


def test_quartiles_count_those_that_were_left_out() -> None:
    assert quartiles([4.0, 1.0, 3.0, 2.0], 4) == (1.0, 2.0, 3.0)
    assert quartiles([5.0], 1) == (5.0, 5.0, 5.0)
    assert quartiles([], 9) is None
    scores = np.random.default_rng(0).exponential(size=256)
    order = np.sort(scores)
    kept = [*order[:32], *order[32:][np.linspace(0, 223, 32).round().astype(int)]]
    found = quartiles(kept, 256)
    assert found is not None
    assert found[1] == pytest.approx(float(np.median(scores)), rel=0.1)
    assert float(np.median(kept)) < 0.5 * found[1]
