"""Training frames of several roots as one, recorded and adversarial, read from disk a frame at a time."""

import functools
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, Self

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from torch import Tensor

from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.extensions.training.scene_frames import VARIABLE_LENGTH, scene_arrays
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, lock_folder, read_json, sanitise_file_name, write_bytes, write_json
from benchmark.machine.workers import map_ordered
from benchmark.machine.workspace import cache_root

INDEX: Final = "frames.json"
FORMAT: Final = 1
"""Rises when `scene_arrays` gives other numbers, so that frames are built again."""
_OPEN_SCENES: Final = 64


@dataclass(frozen=True, slots=True)
class _OpenScene:
    """A scene's file: images are read when they are asked for, everything else is small and kept."""

    images: Any
    arrays: dict[str, Tensor]


class FrameStore:
    """Frames of a split by scene and time; `identity` is the key of their data and of the code that made them."""

    def __init__(self, folder: Path, counts: dict[str, int], identity: str) -> None:
        self.folder = folder
        self.scenes = tuple(counts)
        self.identity = identity
        self._places = [(name, index) for name, count in counts.items() for index in range(count)]
        self._firsts: dict[str, int] = {}
        for number, (name, _) in enumerate(self._places):
            self._firsts.setdefault(name, number)
        self._counts = counts
        self._open: OrderedDict[str, _OpenScene] = OrderedDict()

    @classmethod
    def open(cls, folder: Path) -> Self:
        """Open frames that `build_frames` has made; an `InputError` says that there are none, or not all."""
        path = folder / INDEX
        if not path.is_file():
            raise InputError(f"{folder} holds no complete training frames; build them first (train planner does)")
        index = read_json(path)
        try:
            counts = {str(name): int(count) for name, count in index["scenes"]}
            identity = str(index["identity"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path} is not a list of training frames; remove {folder} and build again") from error
        return cls(folder, counts, identity)

    def __len__(self) -> int:
        return len(self._places)

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        first = self._firsts[scene]
        return range(first, first + self._counts[scene])

    def frame(self, number: int) -> TrainingFrame:
        """One frame."""
        name, index = self._places[number]
        path = _scene_file(self.folder, name)
        try:
            return _read_frame(self._scene(name, path), name, index)
        except (OSError, SafetensorError) as error:
            raise InputError(f"cannot read the training frames {path} ({error}); remove it and build again") from error

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene, in time order; fewer than `length` at the start of a scene."""
        _, index = self._places[number]
        return [self.frame(frame_number) for frame_number in range(number - min(index, length - 1), number + 1)]

    def learnable_steps(self, scene: str, index: int) -> Tensor:
        """Steps, (6,) bool, of the ego's future that a planner learns from (`ego_future_valid`); reads no image."""
        path = _scene_file(self.folder, scene)
        try:
            return self._scene(scene, path).arrays["ego_future_valid"][index]
        except (OSError, SafetensorError, IndexError) as error:
            raise InputError(f"cannot read the training frames {path} ({error}); remove it and build again") from error

    def _scene(self, name: str, path: Path) -> _OpenScene:
        if name not in self._open:
            stored: Any = safe_open(path, "pt")
            arrays = {key: stored.get_tensor(key) for key in sorted(stored.keys()) if key != "images"}
            self._open[name] = _OpenScene(stored.get_slice("images"), arrays)
            if len(self._open) > _OPEN_SCENES:
                self._open.popitem(last=False)
        self._open.move_to_end(name)
        return self._open[name]


def build_frames(data_root: Path, split: str, folder: Path, *, workers: int = 1) -> FrameStore:
    """Gather the frames of a split; scenes that are there already are kept, so that the same command resumes."""
    data = open_data(data_root)
    names = data.scene_names(split)
    identity = frames_key(data, split)
    if _is_complete(folder, identity, names):
        return FrameStore.open(folder)
    with lock_folder(folder):
        (folder / INDEX).unlink(missing_ok=True)
        work = functools.partial(_build_scene, data_root, folder, identity)
        counts = list(map_ordered(work, names, workers=workers, label="training frames"))
        write_json(
            folder / INDEX, {"identity": identity, "split": split, "scenes": list(zip(names, counts, strict=True))}
        )
    return FrameStore.open(folder)


def frames_key(data: DataSet, split: str) -> str:
    """Key, 64 hexadecimal digits, of all that the frames of a split depend on."""
    return content_key("training frames", data.fingerprint(), split, FORMAT)


def _is_complete(folder: Path, identity: str, names: tuple[str, ...]) -> bool:
    try:
        store = FrameStore.open(folder)
    except InputError:
        return False
    return store.identity == identity and store.scenes == names


def _build_scene(data_root: Path, folder: Path, identity: str, name: str) -> int:
    path = _scene_file(folder, name)
    count = _count_cached_frames(path, identity)
    if count is not None:
        return count
    arrays = scene_arrays(_open_data(data_root), name)
    write_bytes(path, save(arrays, {"identity": identity}), durable=False)
    return len(arrays["command"])


@functools.lru_cache(maxsize=1)
def _open_data(data_root: Path) -> Any:
    return open_data(data_root)


def _count_cached_frames(path: Path, identity: str) -> int | None:
    """Frames in a scene's file; ``None`` if it is absent, broken, or made from something else."""
    try:
        with safe_open(path, "pt") as stored:
            if (stored.metadata() or {}).get("identity") != identity:
                return None
            return int(stored.get_slice("command").get_shape()[0])
    except (OSError, SafetensorError):
        return None


def _scene_file(folder: Path, name: str) -> Path:
    return folder / f"{sanitise_file_name(name)}.safetensors"


def _read_frame(scene: _OpenScene, name: str, index: int) -> TrainingFrame:
    values: dict[str, Any] = {"images": scene.images[index : index + 1][0]}
    for field in fields(TrainingFrame):
        if field.name in ("scene", "index", "images"):
            continue
        array = scene.arrays[field.name]
        if field.name in VARIABLE_LENGTH:
            first, end = scene.arrays[VARIABLE_LENGTH[field.name]][index : index + 2].tolist()
            values[field.name] = array[first:end].clone()
        else:
            values[field.name] = array[index].clone()
    values["command"] = int(values["command"])
    values["timestamp_s"] = float(values["timestamp_s"])
    return TrainingFrame(scene=name, index=index, **values)


ADVERSARIAL_SPLIT: Final = "adv"
"""Split of a root of adversarial scenes."""

IN_THE_WAY_M: Final = 3.0
"""Between the ego's lidar and the centre of another box; cars in neighbouring lanes are further apart."""


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
        numbers = store.frames_of(scene)
        return range(first + numbers.start, first + numbers.stop)

    def frame(self, number: int) -> TrainingFrame:
        """One frame; raises as `FrameStore.frame`."""
        store, store_number = self._place(number)
        return store.frame(store_number)

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene; raises as `FrameStore.clip`."""
        store, store_number = self._place(number)
        return store.clip(store_number, length)

    def _place(self, number: int) -> tuple[Frames, int]:
        which = max(place for place, first in enumerate(self._firsts) if first <= number)
        return self._stores[which], number - self._firsts[which]


class PrefixedScenes:
    """A store whose scenes have another name in front: two roots of the town name their scenes alike."""

    def __init__(self, store: Frames, name: str) -> None:
        self._store, self._name = store, name
        self.scenes = tuple(self._add_prefix(scene) for scene in store.scenes)
        self.identity = content_key("scenes apart", store.identity, name)

    def __len__(self) -> int:
        return len(self._store)

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        return self._store.frames_of(scene.removeprefix(self._add_prefix("")))

    def frame(self, number: int) -> TrainingFrame:
        """One frame; raises as the store."""
        return self._rename_scene(self._store.frame(number))

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene; raises as the store."""
        return [self._rename_scene(frame) for frame in self._store.clip(number, length)]

    def _add_prefix(self, scene: str) -> str:
        return f"{self._name}/{scene}"

    def _rename_scene(self, frame: TrainingFrame) -> TrainingFrame:
        return replace(frame, scene=self._add_prefix(frame.scene))


class RecordedFutureFrames:
    """Adversarial scenes that take the learnable steps of the ego's future from the recorded scene of each.

    The ego drives the same way in both; nothing is learned once the adversary is in the way of either of them.
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
        follows = self._recorded.learnable_steps(self._sources[frame.scene], frame.index)
        return replace(frame, ego_future_valid=frame.ego_future_valid & follows & _clear_steps(frame))


def _clear_steps(frame: TrainingFrame) -> Tensor:
    """Steps, (6,) bool, of the ego's future before it is where another is."""
    steps = len(frame.ego_future)
    distance = (frame.futures[:, :steps, :2] - frame.ego_future).norm(dim=-1)
    met = ((distance < IN_THE_WAY_M) & frame.futures_valid[:, :steps]).any(0)
    clear: Tensor = met.cumsum(0) == 0
    return clear


def cached_frames_of(data_root: Path, split: str, *, workers: int) -> FrameStore:
    """The frames of a split, in the user's cache; raises as `build_frames`."""
    folder = cache_root() / "training" / frames_key(open_data(data_root), split)[:16]
    return build_frames(data_root, split, folder, workers=workers)


def require_distinct_data(roots: Sequence[Path], data: DataSet) -> None:
    """Refuse a data set that would be learned from twice."""
    known = {data.fingerprint(): data.root}
    for root in roots:
        fingerprint = open_data(root).fingerprint()
        if fingerprint in known:
            raise InputError(f"{root} is the same data set as {known[fingerprint]}; leave one of them out")
        known[fingerprint] = root


def require_source_scenes(root: Path, data: DataSet, split: str) -> dict[str, str]:
    """Recorded scene of each adversarial one; sources outside the training split are refused: they are judged on."""
    adversarial = open_data(root)
    names = adversarial.scene_names(ADVERSARIAL_SPLIT)
    source_facts = (adversarial.provenance() or {}).get("source") or {}
    if source_facts.get("fingerprint") != data.fingerprint():
        raise InputError(f"{root} was not made from {data.root}; give adversarial scenes generated from it")
    sources = {name: facts.source for name, facts in adversarial.scene_facts(names).items()}
    learned = set(data.scene_names(split))
    for name, source in sources.items():
        if source not in learned:
            raise InputError(
                f"{name} of {root} was made from {source}, which is not in split {split}; planners are scored on such "
                f"scenes: generate them with --source-split {split}"
            )
    return sources
