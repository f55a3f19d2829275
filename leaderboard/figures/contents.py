"""Which figures there are, and in which order they are looked at."""

from collections.abc import Callable, Iterable
from typing import Final

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.transfer import TransferMatrix
from benchmark.records.scenes import Sheets
from leaderboard.figures.attacks import attack_figures, nothing_drawn
from leaderboard.figures.charts import run_figures
from leaderboard.figures.heat_map import heat_maps, lift_maps
from leaderboard.figures.refinement import refinement_figures
from leaderboard.frame.runs import Frame
from leaderboard.page.sections import NamedFigure
from leaderboard.tables.transfer import frame_matrices, name_of_lift, name_of_transfer

OF_RUNS: Final[tuple[Callable[[Frame], Iterable[NamedFigure]], ...]] = (run_figures, attack_figures)


def matrix_figures(frame: Frame) -> list[NamedFigure]:
    """Pictures of the matrices of transfer among the first tables, each with the name of its table.

    Where it is known who is an adversary, contacts with bystanders say nothing of attacks: of lift and φ under
    ``exact`` one picture a split.
    """
    name = frame.data_name
    found = [(judge, _matrices(frame, judge, split)) for split in frame.splits for judge in frame.judges]
    shares = [(name_of_transfer(name, each), heat_maps(each)) for _, some in found for each in some]
    of_lift = [some[-1] for judge, some in found if judge == EXACT and some]
    lifts = [(name_of_lift(name, each), lift_maps(each)) for each in of_lift]
    return [NamedFigure(stem, title, *drawn) for (stem, title), drawn in [*shares, *lifts]]


def _matrices(frame: Frame, judge: str, split: str) -> list[TransferMatrix]:
    return frame.once(frame_matrices, judge, split)[0]


def data_set_figures(frame: Frame, sheets: Sheets) -> list[NamedFigure]:
    """All other figures of one data set."""
    return [*(figure for draw in OF_RUNS for figure in draw(frame)), *refinement_figures(frame.data_name, sheets)]


def missing_figures(frame: Frame) -> list[str]:
    """Sentences on figures that records do not give."""
    missing = nothing_drawn(frame.data_name, frame.given)
    return [] if missing is None else [missing]
