"""Splits that ``drive`` takes, and how each is driven: recordings beside an adversarial split in its windows."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from benchmark import api
from benchmark.cli.splits import ChosenSplits, choose_splits

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.runs.driving import DriveSettings


def choose_drive_splits(
    data: "api.DataSource", splits: Sequence[str], scenes: tuple[str, ...] | None, limit: int | None
) -> ChosenSplits:
    """The splits; of recordings beside an adversarial one: those that its chosen scenes came from."""
    from benchmark.records.seed_splits import is_adversarial

    leading = [split for split in splits if is_adversarial(split)]
    if not leading:
        return choose_splits(data, splits, scenes, limit)
    taken = choose_splits(data, leading, scenes, limit)
    others = {split: data.require_split(split) for split in splits if split not in leading}
    return ChosenSplits({**taken.ahead, **others}, taken.sentence)


def plan_splits(
    source: "api.DataSource",
    splits: Sequence[str],
    settings_of: "Callable[[str, bool], DriveSettings]",
    *,
    paired: bool,
) -> "list[tuple[DataSet, str, DriveSettings]]":
    """Data set, name and settings of what is driven.

    ``settings_of`` makes settings of a split and whether it is adversarial. ``paired``, recordings beside adversarial
    splits are driven once for each of these, in its windows.
    """
    recordings = source.open()
    opened = {split: source.open_split(split, recordings) for split in splits}
    leading = [split for split, data in opened.items() if _has_adversaries(data, split)]
    others = [split for split in opened if split not in leading] if paired and leading else []
    planned: list[tuple[DataSet, str, DriveSettings]] = []
    for split, data in opened.items():
        if split not in others:
            how = _with_windows(settings_of(split, split in leading), split, data, recordings)
            planned += [
                (opened[name], name, api.follow_windows(how, split, data, opened[name], name)) for name in others
            ]
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
