"""The appendix' tables as the paper lays them out: hyper-parameters, runtime, and the data set in numbers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from benchmark.published import (
    ADV_NUSC,
    DATA_SET_SOURCE,
    HYPER_PARAMETERS,
    HYPER_PARAMETERS_SOURCE,
    RUNTIME_MACHINE,
    RUNTIME_S,
    RUNTIME_SOURCE,
)
from benchmark.records.ablation import AblationReport
from benchmark.records.scenes import Sheets, SplitSheet
from benchmark.report.cells import UNDEFINED, Shown
from benchmark.report.table import LatexForm, Table, table_of
from benchmark.report.words import counted
from leaderboard.tables.published import published_rows, published_seconds
from leaderboard.tables.statistics import by_data_set, origin_of

COMPONENTS: Final = {
    "sampling": "Traj. sampling",
    "physics": "Physics",
    "scoring": "Traj. scoring",
    "rendering": "Rendering",
}
"""What the paper calls the stages of generation."""


def _scientific(value: float) -> str:
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+") if value and value < 0.01 else f"{value:g}"


def _falling(last: float) -> str:
    return f"Quadratically decreasing from 1.0 to {last:g}"


_SHOWN: Final[dict[str, tuple[str, Callable[[Any], str]]]] = {
    "InitScale": ("init_scale", _scientific),
    "CornerWeight": ("corner_weight", lambda value: f"{value:g}"),
    "H (planning horizon)": ("horizon", lambda value: counted(value, "timestep")),
    "DACStepWeight": ("road_and_collision_last_weight", _falling),
    "ColStepWeight": ("road_and_collision_last_weight", _falling),
    "ACStepWeight": ("challenge_first_weight", lambda value: f"Linearly increasing from {value:g} to 1.0"),
    "DACWeight": ("dac_weight", lambda value: f"{value:g}"),
    "CRWeight": ("cr_weight", lambda value: f"{value:g}"),
    "ACWeight": ("ac_weight", lambda value: f"{value:g}"),
    "Temperature": ("temperature", lambda value: f"{float(value)}"),
    "#Refinement Rounds": ("rounds", lambda value: f"{value}"),
}
"""For each row of the paper's table the setting of the search that it is, and how its value is written there."""


def hyper_parameter_tables(sheets: Sheets, ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """The paper's table of hyper-parameters, with those of each search of ours.

    Args:
        sheets: Sheets of any splits; those that know the settings of their search count.
        ablations: Studies, which hold the settings of their full search.

    Returns:
        A table by name of the data set that has any.
    """
    found: dict[str, dict[str, Mapping[str, Any]]] = {}
    for (data_name, split), sheet in sorted(sheets.splits.items()):
        if sheet.hyper:
            found.setdefault(data_name, {})[split] = sheet.hyper
    for study in ablations:
        if study.hyper:
            found.setdefault(study.data.name, {}).setdefault(f"ablation, {study.planner.name}", study.hyper)
    return {name: (_hyper_parameters(name, searches),) for name, searches in found.items()}


def _hyper_parameters(data_name: str, searches: Mapping[str, Mapping[str, Any]]) -> Table:
    rows: list[tuple[str | Shown, ...]] = []
    differing: dict[str, list[str]] = {}
    for name, printed in HYPER_PARAMETERS.items():
        field, written = _SHOWN[name]
        ours = [UNDEFINED if search.get(field) is None else written(search[field]) for search in searches.values()]
        for which, value in zip(searches, ours, strict=True):
            if value != printed:
                differing.setdefault(which, []).append(name)
        rows.append((name, *ours, printed))
    notes = [f"{which} differs from the paper in {', '.join(names)}." for which, names in differing.items()]
    same = [which for which in searches if which not in differing]
    notes += [f"As the paper prints them: {'; '.join(same)}."] if same else []
    return table_of(
        "paper-hyper-parameters",
        f"{data_name}: hyper-parameters",
        ("Hyperparameter", *searches, "paper"),
        rows,
        notes=(*notes, "What the paper leaves open has settings of its own: docs/generation.md."),
        text_columns=2 + len(searches),
        groups=(("", 1), ("here", len(searches)), ("paper", 1)),
        sources=(HYPER_PARAMETERS_SOURCE,),
        latex_form=LatexForm("l" * (2 + len(searches)), fit=len(searches) > 0),
    )


def paper_runtime_tables(sheets: Sheets) -> dict[str, tuple[Table, ...]]:
    """The paper's runtime breakdown for each split whose generation was timed."""

    def tables(name: str, splits: Sequence[SplitSheet]) -> list[Table]:
        return [_runtime(name, split) for split in splits if split.runtime is not None]

    return by_data_set(sheets, tables)


def _runtime(data_name: str, split: SplitSheet) -> Table:
    runtime, origin = split.runtime, origin_of(split)
    assert runtime is not None, "asked for splits that were timed"
    each = {stage: runtime.each_s(stage) for stage in (*RUNTIME_S, *sorted(set(runtime.total_s) - set(RUNTIME_S)))}
    rows: list[tuple[str | Shown, ...]] = []
    for stage, seconds in each.items():
        count, of = (runtime.scenes, "scenes") if stage == "rendering" else (runtime.attempts, "attempts")
        name = COMPONENTS.get(stage, stage.capitalize())
        rows.append((name, origin.cell(seconds, "s", count, of).shown(2), published_seconds(stage)))
    total = sum(seconds or 0.0 for seconds in each.values())
    rows.append(("Total", origin.cell(total, "s", runtime.attempts, "attempts").shown(2), published_seconds("all")))
    return table_of(
        f"paper-runtime-{split.split}",
        f"{data_name}, split {split.split}: runtime breakdown (s)",
        ("Component", "here", "paper"),
        rows,
        notes=(
            f"Here: processor seconds of one attempt and of rendering one scene, means of "
            f"{counted(runtime.attempts, 'attempt')} and {counted(runtime.scenes, 'scene')}. Paper: seconds by the "
            f"clock for one scene of about 240 frames and six cameras on {RUNTIME_MACHINE}. They do not compare.",
        ),
        groups=(("", 1), ("runtime in s", 2)),
        sources=(RUNTIME_SOURCE,),
    )


def paper_data_set_tables(sheets: Sheets) -> dict[str, tuple[Table, ...]]:
    """The paper's overview of its data set, with a column for each split of ours."""

    def tables(name: str, splits: Sequence[SplitSheet]) -> list[Table]:
        return [_data_set(name, splits)]

    return by_data_set(sheets, tables)


def _data_set(data_name: str, splits: Sequence[SplitSheet]) -> Table:
    rows: list[tuple[str | Shown, ...]] = []
    for name in ADV_NUSC:
        words = name.replace("_", " ")
        counts = [getattr(split.statistics.counts, name) for split in splits]
        ours = [
            Shown(f"{count:,}", origin_of(split).count(count, words))
            for split, count in zip(splits, counts, strict=True)
        ]
        rows.append((f"# {words}", *ours, published_rows(name)))
    return table_of(
        "paper-data-set",
        f"{data_name}: overview of the data set",
        ("Attribute", *(split.split for split in splits), "Adv-nuSc"),
        rows,
        notes=("Adv-nuSc is made from the nuScenes validation split.",),
        groups=(("", 1), ("here", len(splits)), ("paper", 1)),
        sources=(DATA_SET_SOURCE,),
    )
