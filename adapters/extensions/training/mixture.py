"""Frames of several roots as one: recorded scenes, and adversarial ones that were made from them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from torch import Tensor

from adapters.extensions.training.frame_store import FrameStore, build_frames, frames_key
from adapters.extensions.training.frames import Frames, TrainingFrame
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.machine.workspace import cache_root

ADVERSARIAL_SPLIT: Final = "adv"
"""Split of a root of adversarial scenes."""

IN_THE_WAY_M: Final = 3.0
"""Between the ego's lidar and the middle of somebody's box; cars in lanes side by side are further apart."""


class MixedFrames:
    """Several stores end to end; scenes have different names in each."""

    def __init__(self, stores: Sequence[Frames]) -> None:
        self._stores = tuple(stores)
        self.scenes = tuple(name for store in stores for name in store.scenes)
        if len(set(self.scenes)) < len(self.scenes):
            twice = next(name for name in self.scenes if self.scenes.count(name) > 1)
            raise InputError(f"two of the data sets to learn from have a scene {twice}; leave one of them out")
        self.identity = content_key("mixed frames", [store.identity for store in stores])
        self._firsts = [sum(map(len, stores[:place])) for place in range(len(stores))]

    def __len__(self) -> int:
        return sum(map(len, self._stores))

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        first, store = next(
            (first, store) for first, store in zip(self._firsts, self._stores, strict=True) if scene in store.scenes
        )
        own = store.frames_of(scene)
        return range(first + own.start, first + own.stop)

    def frame(self, number: int) -> TrainingFrame:
        """One frame; raises as `FrameStore.frame`."""
        store, own = self._place(number)
        return store.frame(own)

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene; raises as `FrameStore.clip`."""
        store, own = self._place(number)
        return store.clip(own, length)

    def _place(self, number: int) -> tuple[Frames, int]:
        which = max(place for place, first in enumerate(self._firsts) if first <= number)
        return self._stores[which], number - self._firsts[which]


class ApartScenes:
    """A store whose scenes have another name in front: two roots of the town name their scenes alike."""

    def __init__(self, store: Frames, name: str) -> None:
        self._store, self._name = store, name
        self.scenes = tuple(self._apart(scene) for scene in store.scenes)
        self.identity = content_key("scenes apart", store.identity, name)

    def __len__(self) -> int:
        return len(self._store)

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        return self._store.frames_of(scene.removeprefix(self._apart("")))

    def frame(self, number: int) -> TrainingFrame:
        """One frame; raises as the store."""
        return self._renamed(self._store.frame(number))

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene; raises as the store."""
        return [self._renamed(frame) for frame in self._store.clip(number, length)]

    def _apart(self, scene: str) -> str:
        return f"{self._name}/{scene}"

    def _renamed(self, frame: TrainingFrame) -> TrainingFrame:
        return replace(frame, scene=self._apart(frame.scene))


class FollowedAsRecorded:
    """Adversarial scenes, of whose ego a planner learns what it learns from the scene that each was made from.

    The ego of both drives the same way; what the recorded data set says of departures from the path holds for both.
    But it does not see the adversary: once that is in the way of one of them, nothing is learned from how it goes on.
    """

    def __init__(self, store: FrameStore, recorded: FrameStore, sources: Mapping[str, str]) -> None:
        self._store, self._recorded, self._sources = store, recorded, dict(sources)
        self.scenes = store.scenes
        self.identity = content_key("followed as recorded", store.identity, recorded.identity)

    def __len__(self) -> int:
        return len(self._store)

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        return self._store.frames_of(scene)

    def frame(self, number: int) -> TrainingFrame:
        """One frame; raises as `FrameStore.frame`."""
        return self._followed(self._store.frame(number))

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene; raises as `FrameStore.clip`."""
        return [self._followed(frame) for frame in self._store.clip(number, length)]

    def _followed(self, frame: TrainingFrame) -> TrainingFrame:
        follows = self._recorded.followed(self._sources[frame.scene], frame.index)
        return replace(frame, ego_future_valid=frame.ego_future_valid & follows & _clear(frame))


def _clear(frame: TrainingFrame) -> Tensor:
    """Steps, (6,) bool, of the ego's future before it is where another is."""
    steps = len(frame.ego_future)
    distance = (frame.futures[:, :steps, :2] - frame.ego_future).norm(dim=-1)
    met = ((distance < IN_THE_WAY_M) & frame.futures_valid[:, :steps]).any(0)
    clear: Tensor = met.cumsum(0) == 0
    return clear


def gathered(data_root: Path, split: str, *, workers: int) -> FrameStore:
    """The frames of a split, in the user's cache; raises as `build_frames`."""
    folder = cache_root() / "training" / frames_key(open_data(data_root), split)[:16]
    return build_frames(data_root, split, folder, workers=workers)


def require_others(roots: Sequence[Path], data: DataSet) -> None:
    """Refuse a data set that would be learned from twice."""
    known = {data.fingerprint(): data.root}
    for root in roots:
        fingerprint = open_data(root).fingerprint()
        if fingerprint in known:
            raise InputError(f"{root} is the same data set as {known[fingerprint]}; leave one of them out")
        known[fingerprint] = root


def require_made_from(root: Path, data: DataSet, split: str) -> dict[str, str]:
    """The recorded scene of each adversarial one; refuse scenes that were not made from those that are learned from.

    A scene that planners are judged on must never be learned from.
    """
    adversarial = open_data(root)
    names = adversarial.scene_names(ADVERSARIAL_SPLIT)
    made = (adversarial.provenance() or {}).get("source") or {}
    if made.get("fingerprint") != data.fingerprint():
        raise InputError(f"{root} was not made from {data.root}; give adversarial scenes that generate made from it")
    sources = {name: facts.source for name, facts in adversarial.scene_facts(names).items()}
    learned = set(data.scene_names(split))
    for name, source in sources.items():
        if source not in learned:
            raise InputError(
                f"{name} of {root} was made from {source}, which is not in split {split}; planners are judged on such "
                f"scenes: generate them with --source-split {split}"
            )
    return sources
