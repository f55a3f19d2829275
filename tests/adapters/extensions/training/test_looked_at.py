"""Frames that were looked at once: the same frames without images, and what is rare more often."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from adapters.extensions.training.dataset_mixture import FrameStore, build_frames
from adapters.extensions.training.frames import REPEATS, SPEED, CachedFrames, Frames, TrainingFrame, oversample_changes
from adapters.extensions.training.trainer import Recipe, fit
from tests.adapters.extensions.training.one_scene import OneScene
from tests.adapters.extensions.training.test_trainer import GlanceObjective
from tests.adapters.extensions.training.uniad.objectives import a_frame
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene(f"scene-990{number}", seconds=4.0) for number in (1, 2, 3)])
    return build_frames(root, "val", tmp_path_factory.mktemp("frames"))


def test_scenes_that_are_learned_from_are_looked_at_from_their_beginnings(store: FrameStore) -> None:
    seen: list[list[int]] = []
    second = store.frames_of(store.scenes[1])
    looked = CachedFrames(store, [second[2], second[3]], lambda frames: seen.append([each.index for each in frames]))
    assert looked.scenes == store.scenes[1:2] and looked.identity == store.identity
    assert seen == [list(range(len(second)))] and len(looked) == len(second)
    for length in (1, 3, 50):
        for number in second:
            own, other = looked.clip(number, length), store.clip(number, length)
            assert [each.index for each in own] == [each.index for each in other]
            assert all(len(each.images) == 0 for each in own)
            assert torch.equal(own[-1].ego_future, other[-1].ego_future)


def driven(speed: float, future: Tensor, known: bool = True) -> TrainingFrame:
    frame = a_frame()
    can_bus = frame.can_bus.clone()
    can_bus[SPEED] = speed
    return replace(frame, can_bus=can_bus, ego_future=future, ego_future_valid=torch.full((6,), known))


def test_who_brakes_turns_or_stands_is_seen_more_often_than_who_drives_on() -> None:
    steps = torch.arange(1, 7) * 0.5
    on = torch.stack([torch.zeros(6), 8.0 * steps], -1)
    braking, standing = on * torch.linspace(1, 0.7, 6)[:, None], torch.zeros(6, 2)
    turning = torch.stack([0.5 * steps**2, 8.0 * steps], -1)
    frames = OneScene(
        [
            driven(8.0, on),
            driven(8.0, braking),
            driven(0.0, standing),
            driven(8.0, turning),
            driven(8.0, braking, known=False),
        ]
    )
    counts = [oversample_changes(frames, range(5)).count(number) for number in range(5)]
    assert counts == [1, REPEATS, REPEATS, REPEATS, 1]


class Foresighted(GlanceObjective):
    """Remembers the mean colours of frames, and never sees an image again."""

    def __init__(self) -> None:
        with torch.random.fork_rng():
            torch.manual_seed(3)
            super().__init__()
        self.looks = 0
        self.colours: dict[tuple[str, int], Tensor] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        self.looks += 1
        return CachedFrames(store, frames, self._cache_scene), frames

    def _cache_scene(self, scene: Sequence[TrainingFrame]) -> None:
        self.colours |= {(each.scene, each.index): each.images for each in scene}

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        assert all(len(each.images) == 0 for each in clip)
        return super().losses([replace(each, images=self.colours[each.scene, each.index]) for each in clip])


def test_training_looks_once_and_learns_the_same(store: FrameStore, tmp_path: Path) -> None:
    recipe = Recipe(steps=30, learning_rate=1e-2, clips=2, warmup=10)
    objective, frames = Foresighted(), range(len(store))
    with torch.random.fork_rng():
        torch.manual_seed(3)
        plain = GlanceObjective()
    expected = fit(plain, store, frames, recipe, tmp_path / "plain.safetensors")
    found = fit(objective, store, frames, recipe, tmp_path / "seen.safetensors")
    assert objective.looks == 1 and all(torch.equal(expected[name], found[name]) for name in expected)
    # What is finished needs no second look.
    again = fit(Foresighted(), store, frames, recipe, tmp_path / "seen.safetensors")
    later = Foresighted()
    fit(later, store, frames, recipe, tmp_path / "seen.safetensors")
    assert later.looks == 0 and all(torch.equal(again[name], found[name]) for name in found)
