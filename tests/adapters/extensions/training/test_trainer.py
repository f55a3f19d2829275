"""Training gives the same bytes whenever it is interrupted, and says what is wrong in one sentence."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from adapters.extensions.training.dataset_mixture import FrameStore, build_frames
from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.losses import plan_loss
from adapters.extensions.training.trainer import LOG_EVERY, Recipe, fit, learning_rate, select_clip
from benchmark.errors import InputError
from benchmark.weights.tensors import hash_tensors
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

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


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene(name, seconds=4.0) for name in ("scene-9901", "scene-9902")])
    return build_frames(root, "val", tmp_path_factory.mktemp("frames"))


def trained(store: FrameStore, out: Path, objective: GlanceObjective | None = None, **changes: int | float) -> str:
    recipe = Recipe(steps=STEPS, **{"learning_rate": 1e-2, "clips": 2, "warmup": 10, **changes})  # type: ignore[arg-type]
    if objective is None:
        objective = fresh()
    return hash_tensors(fit(objective, store, range(len(store)), recipe, out, keep_every_s=0.0))


def fresh(stop_at: int | None = None, spoil_at: int | None = None) -> GlanceObjective:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        return GlanceObjective(stop_at, spoil_at)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(store: FrameStore, tmp_path: Path) -> None:
    first, second = (trained(store, tmp_path / f"{name}.safetensors") for name in "ab")
    assert first == second != trained(store, tmp_path / "c.safetensors", seed=1)
    logs = [(tmp_path / f"{name}.log.jsonl").read_bytes() for name in "ab"]
    assert logs[0] == logs[1]


@pytest.mark.parametrize("stop_at", [1, 2 * LOG_EVERY + 7, 4 * LOG_EVERY + 3])
def test_a_killed_run_goes_on_and_ends_with_the_same_weights(store: FrameStore, tmp_path: Path, stop_at: int) -> None:
    undisturbed = trained(store, tmp_path / "whole.safetensors")
    out = tmp_path / "killed.safetensors"
    with pytest.raises(KeyboardInterrupt):
        trained(store, out, fresh(stop_at))
    objective = fresh()
    assert trained(store, out, objective) == undisturbed
    # Steps that were kept are not taken again.
    kept = stop_at // (2 * LOG_EVERY) * LOG_EVERY
    assert len(objective.seen) == 2 * (STEPS - kept)
    assert (tmp_path / "killed.log.jsonl").read_bytes() == (tmp_path / "whole.log.jsonl").read_bytes()


def test_a_finished_run_takes_no_further_step(store: FrameStore, tmp_path: Path) -> None:
    out = tmp_path / "done.safetensors"
    once = trained(store, out)
    objective = fresh()
    assert trained(store, out, objective) == once and not objective.seen


def test_losses_fall_and_are_logged(store: FrameStore, tmp_path: Path) -> None:
    trained(store, tmp_path / "a.safetensors", learning_rate=0.1)
    rows = [json.loads(line) for line in (tmp_path / "a.log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [LOG_EVERY, 2 * LOG_EVERY, STEPS]
    assert rows[-1]["plan"] < 0.3 * rows[0]["plan"] and rows[-1]["loss"] == rows[-1]["plan"]


def test_clips_together_teach_what_clips_one_by_one_teach(store: FrameStore, tmp_path: Path) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        together = TogetherObjective()
    assert trained(store, tmp_path / "together.safetensors", together) == trained(store, tmp_path / "one.safetensors")


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
