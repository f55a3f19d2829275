"""Splits that ``drive`` takes, and how each is driven: recordings beside an adversarial split in its windows."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from benchmark import api
from benchmark.cli.splits import ChosenSplits, choose_splits

if TYPE_CHECKING:
    from benchmark.cli.drive import DriveOptions
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workers import Executor
    from benchmark.runs.driving import DriveSettings


def choose_drive_splits(
    data: "api.DataSource", options: "DriveOptions", scenes: tuple[str, ...] | None
) -> ChosenSplits:
    """The splits; of recordings beside an adversarial one: those that its chosen scenes came from."""
    from benchmark.records.seed_splits import is_adversarial

    if not any(map(is_adversarial, options.split)):
        return choose_splits(data, options.split, scenes, options.limit)
    leading = [split for split in options.split if is_adversarial(split)]
    taken = choose_splits(data, leading, scenes, options.limit)
    others = {split: data.require_split(split) for split in options.split if split not in leading}
    return ChosenSplits({**taken.ahead, **others}, taken.sentence)


def plan_splits(
    source: "api.DataSource",
    splits: "Sequence[str]",
    options: "DriveOptions",
    scenes: tuple[str, ...] | None,
    place: "Executor",
) -> "list[tuple[DataSet, str, DriveSettings]]":
    """Data set, name and settings of what is driven; of recordings once for each adversarial split beside them."""
    recordings = source.open()
    opened = {split: source.open_split(split, recordings) for split in splits}
    leading = {split: _has_adversaries(data, split) for split, data in opened.items()}
    pairs = options.engine == "default" and options.agents != "adversary" and any(leading.values())
    planned: list[tuple[DataSet, str, DriveSettings]] = []
    for split, data in opened.items():
        if pairs and not leading[split]:
            continue
        how = _with_windows(_settings(options, split, scenes, place, leading[split]), split, data, recordings)
        others = [name for name in opened if pairs and not leading[name]]
        planned += [(opened[name], name, api.follow_windows(how, split, data, opened[name], name)) for name in others]
        planned.append((data, split, how))
    return planned


def _has_adversaries(data: "DataSet", split: str) -> bool:
    """Whether a split is adversarial: by its name, or by what is known of its scenes."""
    from benchmark.records.seed_splits import is_adversarial

    return is_adversarial(split) or any(
        fact.adversaries != 0 for fact in data.scene_facts(data.scene_names(split)).values()
    )


def _with_windows(how: "DriveSettings", split: str, data: "DataSet", recordings: "DataSet") -> "DriveSettings":
    """The settings with the windows of an adversarial split; says which scenes have none."""
    from benchmark.runs.encounters import find_windows

    if how.window is None:
        return how
    names = how.chosen(data, split)
    windows = find_windows(data, names, recordings, whole=how.window == "scene")
    whole = [name for name, own in windows.items() if own[0].departs_s is None]
    if whole and how.window == "encounter":
        api.notify(
            f"{len(whole)} of {len(names)} scenes of {split} are driven whole: nothing says where their adversaries "
            f"depart ({', '.join(whole[:3])}{' ...' if len(whole) > 3 else ''})"
        )
    return replace(how, windows=windows)


def _settings(
    options: "DriveOptions", split: str, scenes: tuple[str, ...] | None, place: "Executor", adversarial: bool
) -> "DriveSettings":
    same = (
        *("engine", "agents", "window", "adversary_knows", "adversary_others", "adversary_rounds", "limit", "seed"),
        *("adversary_candidates", "adversary_tracks", "keep_considered", "sensor", "accept_torch_tensors", "until"),
        *("scenarios", "target", "runs"),
    )
    return api.drive_settings(
        split,
        adversarial=adversarial,
        adversary_every_s=options.adversary_every,
        latency_ms=options.latency,
        timeout_s=options.timeout,
        scenes=scenes,
        executor=place,
        **{name: getattr(options, name) for name in same},
    )
