"""Images between samples are drawn for whoever asks, of the embedded data set and of the demo's town."""

from pathlib import Path

import pytest

from benchmark import api
from generation.sources import mini
from generation.sources.mini import TownSettings, build_town_data_set


def test_samples_are_enough_unless_somebody_asks_for_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    town = build_town_data_set(
        api.workspace(tmp_path).split_root("demo", "val"), TownSettings(val_scenes=1, images=False), workers=1
    )
    asked: list[tuple[Path, TownSettings]] = []

    def noted(root: Path, settings: TownSettings, *, workers: int) -> Path:
        asked.append((root, settings))
        return town

    monkeypatch.setattr(mini, "build_town_data_set", noted)
    for sweeps in (False, True):
        api.open_data("mini", sweeps=sweeps)
        api.open_data("demo", out=tmp_path, sweeps=sweeps)
    (first, few), (later, all_of_it), (demo, its_own) = asked
    assert first == later and (few.pictures, all_of_it.pictures) == ("keyframes", "all")
    assert demo == town and its_own == TownSettings(val_scenes=1)
