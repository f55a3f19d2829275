"""The last column of tables of planners: rank with its interval, letters, and the interval of the mean."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.metrics.ranks import PlannerRank, SceneTotals, find_shared_scenes, rank_planners
from benchmark.records.run_schema import PlannerFacts, is_baseline
from benchmark.report.cells import MINIATURE_MARK, UNDEFINED, TableCell, ValueSource, format_interval
from benchmark.report.words import pluralise

RANK: Final = "rank, 95 %"
RANK_NOTE: Final = (
    "Rank: by {}, its 95 % interval over recordings, letters (planners without a common one are told apart with a "
    "probability above 97.5 %), and the 95 % interval of the mean, on the scenes that all ranked planners have; a "
    "failed {} is the worst outcome (docs/metrics.md). References have no rank; miniatures (§) are ranked among "
    "themselves."
)


@dataclass(frozen=True, slots=True)
class Contestant:
    """A planner of a table, with what it did in each scene and the recording of each scene."""

    name: str
    facts: PlannerFacts
    totals: SceneTotals
    source_of: Mapping[str, str]
    origin: ValueSource

    @property
    def group(self) -> str:
        """Group that it is ranked among; a reference is alone."""
        if is_baseline(self.facts):
            return f"reference {self.name}"
        return MINIATURE_MARK if self.facts.miniature else ""


def rank_cells(
    contestants: Sequence[Contestant], *, lower_is_better: bool, unit: str, seed: int = 0
) -> tuple[list[TableCell], list[str]]:
    """Cells of the column in the order of the planners, and a note on the scenes of each group that has ranks."""
    cells: dict[int, TableCell] = {}
    notes = []
    scale, digits = (100.0, 1) if unit == "%" else (1.0, 2)
    for group in dict.fromkeys(each.group for each in contestants):
        places = [place for place, each in enumerate(contestants) if each.group == group]
        own = [contestants[place] for place in places]
        source_of = {scene: source for each in own for scene, source in each.source_of.items()}
        alone = len(own) == 1
        ranks = rank_planners([each.totals for each in own], source_of, lower_is_better=lower_is_better, seed=seed)
        scenes = find_shared_scenes([each.totals for each in own])
        for place, each, rank in zip(places, own, ranks or ()):
            if rank is not None:
                ends = format_interval(scale * rank.low, scale * rank.high, digits=digits)
                text = " ".join(dict.fromkeys((UNDEFINED if alone else _describe_rank(rank, group), ends)))
                cells[place] = TableCell(
                    text,
                    each.origin.cell(
                        rank.value, unit, len(scenes), "scenes", low=rank.low, high=rank.high, scale=scale
                    ),
                )
        if ranks is not None and not alone:
            recordings = pluralise(len({source_of[scene] for scene in scenes}), "recording")
            words = pluralise(len(own), "planner" if not group else "miniature")
            notes.append(f"Ranks of {words}: over {pluralise(len(scenes), 'scene')} of {recordings}.")
    return [cells.get(place, TableCell(UNDEFINED)) for place in range(len(contestants))], notes


def _describe_rank(rank: PlannerRank, group: str) -> str:
    places = str(rank.best) if rank.best == rank.worst else f"{rank.best}-{rank.worst}"
    return " ".join((places, rank.letters, *([group] if group else [])))
