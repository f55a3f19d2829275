"""Training frames on disk: one file a scene, read a frame at a time without keeping them in memory."""

import functools
from collections import OrderedDict
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, Self

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from torch import Tensor

from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.scene_frames import ENDLESS, scene_arrays
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, file_name, only_writer, read_json, write_bytes, write_json
from benchmark.machine.workers import map_ordered

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
    """Frames of a split, in the order of scenes and time.

    `identity` is the key of the data and of the code that the frames were made with.
    """

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
            raise InputError(f"{path} is no list of training frames; remove {folder} and build them again") from error
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
            return _frame_of(self._scene(name, path), name, index)
        except (OSError, SafetensorError) as error:
            raise InputError(f"cannot read the training frames {path} ({error}); remove it and build again") from error

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene, in time order; fewer than `length` at the start of a scene."""
        _, index = self._places[number]
        return [self.frame(each) for each in range(number - min(index, length - 1), number + 1)]

    def followed(self, scene: str, index: int) -> Tensor:
        """Steps, (6,) bool, of the ego's future that a planner learns from, as `TrainingFrame.ego_future_valid`.

        Reads no image.
        """
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
    with only_writer(folder):
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
    count = _kept(path, identity)
    if count is not None:
        return count
    arrays = scene_arrays(_opened(data_root), name)
    write_bytes(path, save(arrays, {"identity": identity}), durable=False)
    return len(arrays["command"])


@functools.lru_cache(maxsize=1)
def _opened(data_root: Path) -> Any:
    return open_data(data_root)


def _kept(path: Path, identity: str) -> int | None:
    """Frames in a scene's file; ``None`` if it is absent, broken, or made from something else."""
    try:
        with safe_open(path, "pt") as stored:
            if (stored.metadata() or {}).get("identity") != identity:
                return None
            return int(stored.get_slice("command").get_shape()[0])
    except (OSError, SafetensorError):
        return None


def _scene_file(folder: Path, name: str) -> Path:
    return folder / f"{file_name(name)}.safetensors"


def _frame_of(scene: _OpenScene, name: str, index: int) -> TrainingFrame:
    values: dict[str, Any] = {"images": scene.images[index : index + 1][0]}
    for field in fields(TrainingFrame):
        if field.name in ("scene", "index", "images"):
            continue
        array = scene.arrays[field.name]
        if field.name in ENDLESS:
            first, end = scene.arrays[ENDLESS[field.name]][index : index + 2].tolist()
            values[field.name] = array[first:end].clone()
        else:
            values[field.name] = array[index].clone()
    values["command"] = int(values["command"])
    values["timestamp_s"] = float(values["timestamp_s"])
    return TrainingFrame(scene=name, index=index, **values)
