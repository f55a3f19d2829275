"""The part of the leaderboard on abilities: planners, scenes, and pictures of both."""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.machine.storage import content_key
from benchmark.report.cells import UNDEFINED, CellSource, TableCell, ValueSource
from benchmark.report.table import Table, escape_markdown
from benchmark.report.words import pluralise
from leaderboard.extensions.ability.figures import ability_figures
from leaderboard.extensions.ability.fit import AbilityFit, PlannerAbility, StoredFit, list_fits
from leaderboard.extensions.ability.matrix import FEWEST_PLANNERS
from leaderboard.frame.rows import list_planner_marks, mark_planner_name
from leaderboard.frame.specification import (
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.page.sections import Section, SectionItem

ABILITIES: Final = "abilities"
"""Heading above these tables."""
_CELLS: Final = {
    ("contact", "open"): "1 where no plan of the scene touches the adversary first at the planner's fault, else 0",
    ("score", "open"): "the share of samples whose plan does not touch the adversary first at the planner's fault",
    ("contact", "closed"): "1 where no drive of the scene touches the adversary at the planner's fault, else 0",
    ("score", "closed"): "nuPlan's terms, mean over the drives of the scene",
}
_NOTE: Final = (
    "A cell is a planner in a scene: {}; 0 where the planner failed. Ability: above the mean of these planners, in "
    "standard deviations of planners, from one joint fit of all of them (docs/extensions/ability.md). It is relative "
    "to these planners and recordings: the claim is about other scenes like these. Expected: over all scenes of the "
    "matrix. Rank: 95 % interval and letters of planners that are not told apart."
)
_SCENES_NOTE: Final = (
    "Difficulty: the ability at which half is expected, with half the width of its 68 % interval; discrimination: "
    "slope there. Failed: planners that fail, or score 0, of those that ran it."
)
_COLUMNS: Final = [
    *text_columns("planner"),
    *group_columns("joint fit", estimate_columns("ability", digits=2, ends=2, beside="95 %", signed=True)),
    *group_columns("joint fit", number_columns("expected %", digits=1), number_columns("rank, 95 %", "P(best)")),
    *group_columns("as measured", number_columns("mean %", digits=1), number_columns("cells")),
]
_SCENES: Final = [
    *text_columns("scene", "recording", "all planners"),
    *number_columns("difficulty", "±", "discrimination", digits=2),
    *number_columns("failed"),
]


def build_sections(fits: Sequence[StoredFit]) -> list[Section]:
    """A section for each fit: planners, pictures; scenes as data."""
    return [_build_section(stored) for stored in fits]


def _build_section(stored: StoredFit) -> Section:
    fit, measured = stored.fit, stored.fit.measured
    planners, scenes, figures = ability_table(stored), difficulty_table(fit), ability_figures(fit)
    shown: list[SectionItem] = [planners, *figures, "Difficulty of every scene: `tables/difficulty.csv`.\n"]
    heading = f"{escape_markdown(measured.data)}: {ABILITIES}"
    return Section(measured.data, heading, shown, [(ABILITIES, [planners, scenes])], figures)


def _name(fit: AbilityFit) -> str:
    world = f"-{content_key(fit.world)[:8]}" if fit.world else ""
    return f"{fit.split}-{fit.loop}-{fit.kind}{world}"


def _find_origin(fit: AbilityFit) -> ValueSource:
    return ValueSource(record="; ".join(fit.records))


def ability_table(stored: StoredFit) -> Table:
    """Planners of a fit: ranked ones, miniatures, references, the ablest of each first."""
    fit = stored.fit
    ordered = sorted(fit.planners, key=lambda each: (each.reference, each.miniature, -each.ability))
    notes = [_NOTE.format(_CELLS[fit.kind, fit.loop]), *_list_notes(fit)]
    if not stored.current:
        notes.insert(
            0, "Fitted to other records than the present ones: run challenger-bench leaderboard ability again."
        )
    notes += list_planner_marks(_Marks(each) for each in fit.planners)
    return tabulate(
        f"ability-{_name(fit)}",
        f"{fit.measured.words}: abilities",
        _COLUMNS,
        [_planner_values(fit, each) for each in ordered],
        notes,
        brief=[column.key for column in _COLUMNS],
    )


class _Marks:
    """What a planner is, for the notes on marks; which references are privileged is not stored."""

    def __init__(self, planner: PlannerAbility) -> None:
        self.privileged, self.miniature = False, planner.miniature


def _planner_values(fit: AbilityFit, planner: PlannerAbility) -> Values:
    origin = _find_origin(fit)
    rank = UNDEFINED
    if planner.best is not None:
        ends = str(planner.best) if planner.best == planner.worst else f"{planner.best}-{planner.worst}"
        rank = f"{ends} {planner.letters}"
    cells: dict[str, CellSource] = {
        "ability": origin.cell(planner.ability, "", planner.cells, "scenes", low=planner.low, high=planner.high),
        "expected %": origin.cell(planner.expected, "%", len(fit.scenes), "scenes", scale=100.0),
        "mean %": origin.cell(planner.mean, "%", planner.cells, "scenes", scale=100.0),
        "cells": origin.count(planner.cells, "scenes", len(fit.scenes)),
    }
    first = origin.cell(planner.first, "", fit.draws, "draws").shown(2)
    name = mark_planner_name(planner.name, privileged=False, miniature=planner.miniature)
    return {"planner": TableCell(name, miniature=planner.miniature), "rank, 95 %": rank, "P(best)": first, **cells}


def _list_notes(fit: AbilityFit) -> list[str]:
    """Counts of what the fit rests on, scenes that tell nothing, and what is missing."""
    matrix, notes = fit.matrix, []
    scenes, recordings = len(fit.scenes), len(set(matrix.recordings))
    effects = "with" if fit.kept.sd_u else "without"
    of = f"{pluralise(len(fit.planners), 'planner')}, {pluralise(scenes, 'scene')} of "
    notes.append(
        f"{of}{pluralise(recordings, 'recording')}, {effects} effects of planner and recording; R-hat {fit.r_hat:.3f} "
        f"after {fit.draws:,} draws, {fit.divergent} divergent; seed {fit.seed}."
    )
    nobody = sum(scene.passed == scene.ran for scene in fit.scenes)
    everybody = sum(scene.passed == 0 for scene in fit.scenes)
    notes.append(
        f"Nobody fails {nobody} and everybody fails {everybody} of {pluralise(scenes, 'scene')}: they say next to "
        "nothing about ranks and are in every rate."
    )
    if matrix.missing:
        share = 100.0 * matrix.missing / matrix.values.size
        known = [scene.difficulty for scene in fit.scenes]
        missing = (~matrix.known).mean(axis=0)
        words = f"{matrix.missing} of {matrix.values.size} cells ({share:.0f} %) are missing"
        if None not in known and missing.std() > 0.0:
            words += f"; correlation with difficulty {np.corrcoef(missing, np.array(known, float))[0, 1]:+.2f}"
        notes.append(f"{words}.")
    if fit.scenes[0].difficulty is None:
        notes.append(
            f"With {pluralise(len(fit.planners), 'planner')} (at least {FEWEST_PLANNERS}) a fit of this kind says "
            "nothing of single scenes."
        )
    return notes


def difficulty_table(fit: AbilityFit) -> Table:
    """Scenes of a fit, the hardest first."""
    origin = _find_origin(fit)
    rows: list[Values] = []
    for scene in sorted(fit.scenes, key=lambda each: (-(each.difficulty or 0.0), each.scene)):
        extreme = "pass" if scene.passed == scene.ran else "fail" if not scene.passed else ""
        rows.append(
            {
                "scene": scene.scene,
                "recording": scene.recording,
                "all planners": extreme,
                "difficulty": origin.cell(scene.difficulty, "", scene.ran, "planners"),
                "±": origin.cell(scene.deviation, "", scene.ran, "planners"),
                "discrimination": origin.cell(scene.discrimination, "", scene.ran, "planners"),
                "failed": origin.count(scene.ran - scene.passed, "planners", scene.ran).shown(after=f"/{scene.ran}"),
            }
        )
    title = f"{fit.measured.words}: difficulty of scenes"
    return tabulate(f"difficulty-{_name(fit)}", title, _SCENES, rows, [_SCENES_NOTE, *_list_notes(fit)])


def list_statistics(out: Path, names: Collection[str], split: str | None) -> list[Table]:
    """Tables of scenes for ``data stats``: of the fits of a data set, of one split if it is named."""
    fits = list_fits(out)
    return [difficulty_table(fit) for fit in fits if fit.data in names and split in (None, fit.split)]
