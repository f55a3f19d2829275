"""The appendix' tables as the paper lays them out: hyper-parameters, runtime, and the data set in numbers."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, Final

from benchmark.published import (
    ADV_NUSC,
    DATA_SET_SOURCE,
    HYPER_PARAMETERS,
    HYPER_PARAMETERS_SOURCE,
    RUNTIME_MACHINE,
    RUNTIME_SOURCE,
)
from benchmark.records.ablation import AblationReport
from benchmark.records.scene_pages import ScenePages, SplitPage
from benchmark.records.statistics import BuildRuntime
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import LatexForm, Table
from benchmark.report.words import pluralise
from leaderboard.frame.specification import (
    Values,
    build_count_cells,
    find_origin,
    group_columns,
    number_columns,
    numbered_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.published import quote_rows, quote_seconds
from leaderboard.tables.runtime import count_units, list_stages

COMPONENTS: Final = {
    "sampling": "Traj. sampling",
    "physics": "Physics",
    "scoring": "Traj. scoring",
    "rendering": "Rendering",
}
"""Names of the stages of generation in the paper."""


def _format_scientific(value: float) -> str:
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+") if value and value < 0.01 else f"{value:g}"


def _format_decay(last: float) -> str:
    return f"Quadratically decreasing from 1.0 to {last:g}"


_SHOWN: Final[dict[str, tuple[str, Callable[[Any], str]]]] = {
    "InitScale": ("init_scale", _format_scientific),
    "CornerWeight": ("corner_weight", lambda value: f"{value:g}"),
    "H (planning horizon)": ("horizon", lambda value: pluralise(value, "timestep")),
    "DACStepWeight": ("road_and_collision_last_weight", _format_decay),
    "ColStepWeight": ("road_and_collision_last_weight", _format_decay),
    "ACStepWeight": ("challenge_first_weight", lambda value: f"Linearly increasing from {value:g} to 1.0"),
    "DACWeight": ("dac_weight", lambda value: f"{value:g}"),
    "CRWeight": ("cr_weight", lambda value: f"{value:g}"),
    "ACWeight": ("ac_weight", lambda value: f"{value:g}"),
    "Temperature": ("temperature", lambda value: f"{float(value)}"),
    "#Refinement Rounds": ("rounds", lambda value: f"{value}"),
}
"""For each row of the paper's table the setting of the search that it is, and how its value is written there."""


def hyper_parameter_tables(sheets: ScenePages, ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """The paper's hyper-parameters by data set, beside those of studies and of sheets that know their search."""
    searches_by_data_set: dict[str, dict[str, Mapping[str, Any]]] = {}
    for (data_name, split), sheet in sorted(sheets.splits.items()):
        if sheet.hyper:
            searches_by_data_set.setdefault(data_name, {})[split] = sheet.hyper
    for study in ablations:
        if study.hyper:
            searches_by_data_set.setdefault(study.data.name, {}).setdefault(
                f"ablation, {study.planner.name}", study.hyper
            )
    return {name: (_hyper_parameter_table(name, searches),) for name, searches in searches_by_data_set.items()}


def _hyper_parameter_table(data_name: str, searches: Mapping[str, Mapping[str, Any]]) -> Table:
    rows: list[Values] = []
    differing: dict[str, list[str]] = {}
    for name, printed in HYPER_PARAMETERS.items():
        field, written = _SHOWN[name]
        ours = [UNDEFINED if search.get(field) is None else written(search[field]) for search in searches.values()]
        for which, value in zip(searches, ours, strict=True):
            if value != printed:
                differing.setdefault(which, []).append(name)
        here = {f"#{place}": value for place, value in enumerate(ours)}
        rows.append({"Hyperparameter": name, **here, "paper": printed})
    notes = [f"{which} differs from the paper in {', '.join(names)}." for which, names in differing.items()]
    same = [which for which in searches if which not in differing]
    notes += [f"As the paper prints them: {'; '.join(same)}."] if same else []
    return tabulate(
        "paper-hyper-parameters",
        f"{data_name}: hyper-parameters",
        [
            *text_columns("Hyperparameter"),
            *(replace(column, text=True) for column in group_columns("here", numbered_columns(searches))),
            *group_columns("paper", text_columns("paper")),
        ],
        rows,
        (*notes, "Choices that the paper leaves open are settings: docs/generation.md."),
        sources=(HYPER_PARAMETERS_SOURCE,),
        latex_form=LatexForm("l" * (2 + len(searches)), fit=len(searches) > 0),
    )


def paper_runtime_tables(data_name: str, splits: Sequence[SplitPage]) -> list[Table]:
    """The paper's runtime breakdown for each split whose generation was timed."""
    return [_runtime_table(data_name, split, split.runtime) for split in splits if split.runtime is not None]


def _runtime_table(data_name: str, split: SplitPage, runtime: BuildRuntime) -> Table:
    origin, seconds_by_stage = find_origin(split), {stage: runtime.each_s(stage) for stage in list_stages(runtime)}
    rows: list[Values] = [
        {
            "Component": COMPONENTS.get(stage, stage.capitalize()),
            "here": origin.cell(seconds, "s", *count_units(runtime, stage)),
            "paper": quote_seconds(stage),
        }
        for stage, seconds in seconds_by_stage.items()
    ]
    total = origin.cell(sum(seconds or 0.0 for seconds in seconds_by_stage.values()), "s", runtime.attempts, "attempts")
    return tabulate(
        f"paper-runtime-{split.split}",
        f"{data_name}, split {split.split}: runtime breakdown (s)",
        [*text_columns("Component"), *group_columns("runtime in s", number_columns("here", "paper", digits=2))],
        [*rows, {"Component": "Total", "here": total, "paper": quote_seconds("all")}],
        (
            f"Here: processor seconds of one attempt and of rendering one scene, means of "
            f"{pluralise(runtime.attempts, 'attempt')} and {pluralise(runtime.scenes, 'scene')}. Paper: wall-clock "
            f"seconds for one scene of about 240 frames and six cameras on {RUNTIME_MACHINE}. They are not comparable.",
        ),
        sources=(RUNTIME_SOURCE,),
    )


def paper_data_set_tables(data_name: str, splits: Sequence[SplitPage]) -> list[Table]:
    """The paper's overview of its data set, with a column for each split of ours."""
    rows: list[Values] = [
        {
            "Attribute": f"# {name.replace('_', ' ')}",
            **build_count_cells(splits, name.replace("_", " "), attrgetter(f"statistics.counts.{name}")),
            "Adv-nuSc": quote_rows(name),
        }
        for name in ADV_NUSC
    ]
    columns = [
        *text_columns("Attribute"),
        *group_columns("here", numbered_columns(split.split for split in splits)),
        *group_columns("paper", number_columns("Adv-nuSc")),
    ]
    note = "Adv-nuSc is made from the nuScenes validation split."
    title = f"{data_name}: overview of the data set"
    return [tabulate("paper-data-set", title, columns, rows, (note,), sources=(DATA_SET_SOURCE,))]
