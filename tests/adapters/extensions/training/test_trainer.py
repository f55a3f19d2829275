"""Training gives the same bytes whenever it is interrupted, and says what is wrong in one sentence."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from adapters.extensions.training.dataset_mixture import FrameStore
from adapters.extensions.training.frames import REPEATS, SPEED, CachedFrames, Frames, TrainingFrame, oversample_changes
from adapters.extensions.training.losses import plan_loss
from adapters.extensions.training.trainer import LOG_EVERY, Recipe, fit, learning_rate, select_clip
from benchmark.errors import InputError
from benchmark.weights.tensors import hash_tensors
from tests.adapters.extensions.training.road_frames import OneScene, a_frame

STEPS = 2 * LOG_EVERY + 20


class Glance(nn.Module):
    """A plan from the mean colours of the images."""

    def __init__(self) -> None:
        super().__init__()
        self.img_backbone = nn.Linear(18, 8)
        self.head = nn.Linear(8, 12)

    def forward(self, images: Tensor) -> Tensor:
        colours = images.float().mean((-1, -2)).flatten() / 255
        plan: Tensor = self.head(torch.relu(self.img_backbone(colours))).view(6, 2)
        return plan


class GlanceObjective:
    """Learns to plan, with noise; counts its clips and stops at one of them."""

    def __init__(self, stop_at: int | None = None, spoil_at: int | None = None) -> None:
        self.network = Glance()
        self.clip_frames = 2
        self.seen: list[tuple[str, int]] = []
        self.stop_at, self.spoil_at = stop_at, spoil_at

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        if len(self.seen) == self.stop_at:
            raise KeyboardInterrupt
        self.seen.append((clip[-1].scene, clip[-1].index))
        frame = clip[-1]
        plan = self.network(frame.images) + 0.01 * torch.randn(6, 2)
        spoiled = math.nan if len(self.seen) == self.spoil_at else 1.0
        return {"plan": spoiled * plan_loss(plan, frame.ego_future, frame.ego_future_valid)}


class TogetherObjective(GlanceObjective):
    """The same, of all clips of a step at once."""

    def losses_of(self, clips: Sequence[Sequence[TrainingFrame]]) -> dict[str, Tensor]:
        return {"plan": torch.stack([self.losses(clip)["plan"] for clip in clips]).mean()}


def trained(store: FrameStore, out: Path, objective: GlanceObjective | None = None, **changes: int | float) -> str:
    recipe = Recipe(steps=STEPS, **{"learning_rate": 1e-2, "clips": 2, "warmup": 10, **changes})  # type: ignore[arg-type]
    if objective is None:
        objective = fresh()
    return hash_tensors(fit(objective, store, range(len(store)), recipe, out, keep_every_s=0.0))


def fresh(stop_at: int | None = None, spoil_at: int | None = None) -> GlanceObjective:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        return GlanceObjective(stop_at, spoil_at)


@pytest.fixture(scope="module")
def whole(store: FrameStore, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, bytes]:
    """Weights and log of a run that nothing disturbs."""
    out = tmp_path_factory.mktemp("whole") / "w.safetensors"
    return trained(store, out), out.with_suffix(".log.jsonl").read_bytes()


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(
    store: FrameStore, whole: tuple[str, bytes], tmp_path: Path
) -> None:
    assert trained(store, tmp_path / "a.safetensors") == whole[0] != trained(store, tmp_path / "b.safetensors", seed=1)
    assert (tmp_path / "a.log.jsonl").read_bytes() == whole[1]


def test_a_run_that_is_killed_twice_goes_on_and_ends_with_the_same_weights(
    store: FrameStore, whole: tuple[str, bytes], tmp_path: Path
) -> None:
    out = tmp_path / "killed.safetensors"
    for stop_at in (1, 2 * LOG_EVERY + 7):
        with pytest.raises(KeyboardInterrupt):
            trained(store, out, fresh(stop_at))
    last = fresh()
    assert trained(store, out, last) == whole[0] and out.with_suffix(".log.jsonl").read_bytes() == whole[1]
    # Steps that were kept are not taken again, and of a finished run none is.
    assert len(last.seen) == 2 * (STEPS - LOG_EVERY)
    again = fresh()
    assert trained(store, out, again) == whole[0] and not again.seen


@pytest.mark.path
def test_losses_fall_and_are_logged(store: FrameStore, tmp_path: Path) -> None:
    trained(store, tmp_path / "a.safetensors", learning_rate=0.1)
    rows = [json.loads(line) for line in (tmp_path / "a.log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [LOG_EVERY, 2 * LOG_EVERY, STEPS]
    assert rows[-1]["plan"] < 0.3 * rows[0]["plan"] and rows[-1]["loss"] == rows[-1]["plan"]


def test_clips_together_teach_what_clips_one_by_one_teach(
    store: FrameStore, whole: tuple[str, bytes], tmp_path: Path
) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        together = TogetherObjective()
    assert trained(store, tmp_path / "together.safetensors", together) == whole[0]


def test_every_frame_ends_a_clip_once_before_any_does_twice(store: FrameStore) -> None:
    recipe = Recipe(steps=1)
    count = len(store)
    drawn = [select_clip(store, range(count), recipe, 2, draw)[-1] for draw in range(2 * count)]
    places = [(frame.scene, frame.index) for frame in drawn]
    assert len(set(places[:count])) == count == len(set(places[count:]))
    assert places[:count] != places[count:]
    scattered = Recipe(steps=1, scattered=True)
    mixed = [frame for draw in range(count // 2) for frame in select_clip(store, range(count), scattered, 2, draw)]
    assert len({(frame.scene, frame.index) for frame in mixed}) == count


def test_the_learning_rate_rises_and_falls() -> None:
    recipe = Recipe(steps=1000, learning_rate=1.0, warmup=100)
    rates = [learning_rate(recipe, step) for step in range(1000)]
    assert rates[0] == pytest.approx(0.01, rel=0.01) and rates[-1] == pytest.approx(0.01, rel=0.01)
    assert max(rates) == pytest.approx(rates[100], rel=0.05)


def test_what_goes_wrong_is_a_sentence(store: FrameStore, tmp_path: Path) -> None:
    out = tmp_path / "w.safetensors"
    with pytest.raises(InputError, match="no frames to train on"):
        fit(fresh(), store, [], Recipe(steps=1), out)
    with pytest.raises(InputError, match=r"cannot write .*--out"):
        trained(store, Path("/proc/no/w.safetensors"))
    with pytest.raises(InputError, match="at least one step"):
        Recipe(steps=0)
    with pytest.raises(InputError, match=r"no longer finite at step 2 .*lower --learning-rate"):
        trained(store, out, fresh(spoil_at=5))
    with pytest.raises(KeyboardInterrupt):
        trained(store, out, fresh(stop_at=2 * LOG_EVERY + 1))
    with pytest.raises(InputError, match="belongs to a training run with other settings"):
        trained(store, out, gradient_norm=1.0)
    unfinished = out.with_suffix(".progress.safetensors")
    unfinished.write_bytes(unfinished.read_bytes()[:200])
    with pytest.raises(InputError, match="remove it to train from the beginning"):
        trained(store, out)


# --- frames that were looked at once


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


def test_who_brakes_turns_or_stands_is_seen_more_often_than_who_drives_on() -> None:
    def driven(speed: float, future: Tensor, known: bool = True) -> TrainingFrame:
        can_bus = a_frame().can_bus.index_fill(0, torch.tensor([SPEED]), speed)
        return replace(a_frame(), can_bus=can_bus, ego_future=future, ego_future_valid=torch.full((6,), known))

    steps = torch.arange(1, 7) * 0.5
    on = torch.stack([torch.zeros(6), 8.0 * steps], -1)
    turning, braking = torch.stack([0.5 * steps**2, 8.0 * steps], -1), on * torch.linspace(1, 0.7, 6)[:, None]
    frames = [driven(8.0, on), driven(8.0, braking), driven(0.0, torch.zeros(6, 2)), driven(8.0, turning)]
    frames.append(driven(8.0, braking, known=False))
    counts = [oversample_changes(OneScene(frames), range(5)).count(number) for number in range(5)]
    assert counts == [1, REPEATS, REPEATS, REPEATS, 1]


class Foresighted(GlanceObjective):
    """Remembers images by their frames, and never looks at one again."""

    def __init__(self) -> None:
        with torch.random.fork_rng():
            torch.manual_seed(3)
            super().__init__()
        self.looks = 0
        self.images: dict[tuple[str, int], Tensor] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        self.looks += 1
        return CachedFrames(store, frames, self._cache_scene), frames

    def _cache_scene(self, scene: Sequence[TrainingFrame]) -> None:
        self.images |= {(each.scene, each.index): each.images for each in scene}

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        assert all(len(each.images) == 0 for each in clip)
        return super().losses([replace(each, images=self.images[each.scene, each.index]) for each in clip])


def test_training_looks_once_and_learns_the_same(store: FrameStore, tmp_path: Path) -> None:
    recipe, frames = Recipe(steps=30, learning_rate=1e-2, clips=2, warmup=10), range(len(store))
    objective, later = Foresighted(), Foresighted()
    expected = fit(fresh(), store, frames, recipe, tmp_path / "plain.safetensors")
    found = fit(objective, store, frames, recipe, tmp_path / "seen.safetensors")
    assert objective.looks == 1 and all(torch.equal(expected[name], found[name]) for name in expected)
    # What is finished needs no second look.
    again = fit(later, store, frames, recipe, tmp_path / "seen.safetensors")
    assert later.looks == 0 and all(torch.equal(again[name], found[name]) for name in found)
