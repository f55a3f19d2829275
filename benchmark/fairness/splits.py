"""A split judged: the ladder in sum, how severe its encounters are, how real its adversaries move."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.fairness.data_sets import judge_data
from benchmark.fairness.split_realism import split_realism
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.records.judged_splits import LadderRow, SeverityRow, SplitJudgement
from benchmark.records.judgement import DRIVER_NAMES, DriverRun, EncounterSeverity, SceneJudgement, unsolvable
from benchmark.records.statistics import Quantiles

_LEVELS: Final = {"least": 0.0, "tenth": 0.1, "median": 0.5, "ninetieth": 0.9, "most": 1.0}
_STRUCK: Final = ("rear", "stopped_ego")
"""Kinds of contact in which another drives into the ego."""
_BEFORE_CONTACT: Final = {"least_ttc_s": "least time to contact, s", "tet_s": "TET, s", "tit_s2": "TIT, s^2"}
"""In a run that ends in contact they are what they are by construction."""
_ALWAYS: Final = {
    "least_gap_m": "least gap, m",
    "pet_s": "PET, s",
    "max_btn": "largest BTN",
}


def adversarial_names(data: DataSet, names: Sequence[str]) -> tuple[str, ...]:
    """Those scenes of a data set that are no recordings, as far as it says.

    Scenes with adversaries, and those of which it is not said how many they have.
    """
    facts = data.scene_facts(names)
    return tuple(name for name in names if facts[name].adversaries != 0)


def judge_split(
    data: DataSet, names: Sequence[str], executor: Executor | None = None, recordings: DataSet | None = None
) -> SplitJudgement:
    """Judge scenes of a data set together.

    Args:
        data: The data set.
        names: Scenes of it.
        executor: Where scenes without a judgement are judged; this process by default.
        recordings: The data set that its scenes were made from, if at hand.

    Returns:
        The judgement of the split.

    Raises:
        InputError: If a scene is broken, or workers are lost.
    """
    executor = executor or LocalProcesses()
    judged = judge_data(data, names, executor, recordings)
    ordinary: dict[str, tuple[SceneJudgement, ...]] = {}
    if recordings is not None:
        sources = {facts.source for facts in data.scene_facts(names).values()}
        ordinary = judge_data(recordings, sorted(sources & set(recordings.scene_names(None))), executor)
    met = [each.encounter for said in judged.values() for each in said if each.encounter is not None]
    free = [each for each in met if each.contact is None]
    return SplitJudgement(
        scenes=dict(judged),
        ladder=ladder([said for said in judged.values() if said]),
        ladder_of_recordings=ladder([said for said in ordinary.values() if said]) if ordinary else (),
        unsolvable=tuple(name for name, said in judged.items() if unsolvable(said)),
        severity=(
            *(_severity(label, name, met) for name, label in _ALWAYS.items()),
            *(_severity(label, name, free) for name, label in _BEFORE_CONTACT.items()),
        ),
        contacts=len(met) - len(free),
        realism=split_realism(data, judged, recordings),
    )


def ladder(scenes: Sequence[Sequence[SceneJudgement]]) -> tuple[LadderRow, ...]:
    """How many scenes, of at least one, each driver survives."""
    rows = []
    for name in DRIVER_NAMES:
        runs = [said[0].drivers[name] for said in scenes]
        rows.append(
            LadderRow(
                driver=name,
                survives=sum(run.survives for run in runs),
                of=len(runs),
                hit_adversary=sum(_hits_adversary(run) for run in runs),
                hit_from_behind=sum(run.contact is not None and run.contact.kind in _STRUCK for run in runs),
                beyond_end=sum(run.beyond_end for run in runs),
            )
        )
    return tuple(rows)


def _hits_adversary(run: DriverRun) -> bool:
    return run.contact is not None and run.contact.party != "other"


def _severity(label: str, name: str, met: Sequence[EncounterSeverity]) -> SeverityRow:
    values = [value for value in (getattr(each, name) for each in met) if value is not None]
    quantiles = {level: float(np.quantile(values, at)) for level, at in _LEVELS.items()} if values else None
    return SeverityRow(
        name=label, of=len(values), quantiles=None if quantiles is None else Quantiles.model_validate(quantiles)
    )
