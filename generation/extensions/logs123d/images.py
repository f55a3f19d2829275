"""Images of a log as the writer of roots takes them: which there are, from where they were seen, and their bytes."""

import hashlib
import io
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.datasets.scenario_map import to_name
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
from benchmark.scene import Camera, EgoTrack, Scene
from benchmark.untrusted.files import PICTURE, read_file
from benchmark.untrusted.http_images import decode_picture
from generation.extensions.logs123d.cameras import find_file, inspect_image, rectify
from generation.extensions.logs123d.log_files import list_images, list_video_images
from generation.extensions.logs123d.log_scene import LogCamera, LogScene
from generation.extensions.logs123d.poses import compose, invert, shift, to_track
from generation.render.contract import Images, RecordedChannel

NAME: Final = "recorded"


@dataclass(frozen=True, slots=True)
class LogImages:
    """The images of one log (`RecordedImages`); ``sensors`` is the folder that paths of images are relative to."""

    source: LogScene
    sensors: Path | None
    firsts: Mapping[str, tuple[str, tuple[int, int]]]
    name: str = NAME
    version: str = "1"

    @classmethod
    def of(cls, source: LogScene, sensors: Path | None) -> "LogImages":
        """The images of a log, after a look at the first of each camera."""
        reader, rows = cls(source, sensors, {}), {one.key: int(one.images.rows[0]) for one in source.cameras}
        held = [one.key for one in source.cameras if one.table.types.get("data") == "binary"]
        # One look into all files: each costs a process.
        data = dict(zip(held, list_images(source.log, [(key, rows[key]) for key in held]), strict=True))
        firsts = {}
        for one in source.cameras:
            (image,) = [data[one.key]] if one.key in data else reader.read(one, [rows[one.key]])
            firsts[one.lens.name] = inspect_image(image, f"{one.table.path}, row {rows[one.key]},")
        return cls(source, sensors, firsts)

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        """The scene's own."""
        return scene.cameras

    def render(self, scene: Scene, frames: Collection[int]) -> Iterator[Images]:
        """The same images, decoded."""
        for frame in frames:
            yield {name: decode_picture(io.BytesIO(data), PICTURE) for name, _, data in self.files(scene, [frame])}

    def channels(self, scene: Scene) -> Mapping[str, RecordedChannel]:
        """When and from where each camera recorded what is taken of it."""
        return {camera.lens.name: self._channel(scene, camera) for camera in self.source.cameras}

    def _channel(self, scene: Scene, camera: LogCamera) -> RecordedChannel:
        images, source = camera.images, self.source
        at = camera.table.times_us()[images.rows] + source.by_us
        body = compose(camera.in_world[images.rows], invert(camera.lens.camera_to_imu))
        ego: EgoTrack = to_track(shift(compose(body, source.body.base), source.by_m))
        extension = self.firsts[camera.lens.name][0] if camera.lens.project is None else "jpg"
        return RecordedChannel(images.frames, at - scene.timestamps_us[images.frames], ego, extension)

    def files(self, scene: Scene, frames: Collection[int]) -> Iterator[tuple[str, int, bytes]]:
        """Camera, frame and bytes of every image of some frames, camera after camera."""
        wanted = set(frames)
        for camera in self.source.cameras:
            first = self.firsts[camera.lens.name]
            pairs = zip(camera.images.frames.tolist(), camera.images.rows.tolist(), strict=True)
            taken = [(frame, row) for frame, row in pairs if frame in wanted]
            for (frame, row), data in zip(taken, self.read(camera, [row for _, row in taken]), strict=True):
                where = f"{camera.table.path}, row {row},"
                kind, size = inspect_image(data, where)
                if (kind, size) != first:
                    raise InputError(
                        f"{where} has a {kind} image of {size[0]} x {size[1]} pixels, and the first is a {first[0]} of "
                        f"{first[1][0]} x {first[1][1]}; convert the log again"
                    )
                yield camera.lens.name, frame, rectify(data, camera.lens, where)

    def sizes(self) -> dict[str, tuple[int, int]]:
        """Width and height of the images of each camera, by its name."""
        return {name: size for name, (_, size) in self.firsts.items()}

    def read(self, camera: LogCamera, rows: list[int]) -> Iterator[bytes]:
        """Bytes of the images in some rows, wherever they are kept."""
        kind, table = camera.table.types.get("data"), camera.table
        if kind == "binary":
            yield from list_images(self.source.log, [(camera.key, row) for row in rows])
        elif kind == "string":
            for path in self._list_paths(camera, rows):
                if not path.is_file():
                    raise InputError(f"image {path} is missing, which {table.path} names; complete --sensors")
                yield read_file(path, PICTURE)
        elif kind in ("int32", "int64"):
            numbers = table.numbers("data")[rows]
            if (np.diff(numbers) <= 0).any() or (numbers < 0).any():
                raise table.damaged("its frames of the video do not follow each other")
            yield from list_video_images(_find_video(camera), numbers.tolist())
        else:
            raise table.damaged(f"its images are {kind}, which is not known")

    def _list_paths(self, camera: LogCamera, rows: list[int]) -> list[Path]:
        if self.sensors is None:
            raise InputError(
                f"the images of {self.source.log.folder} are files of its source data set; name the folder that their "
                "paths begin in with --sensors, or import without images: --no-images"
            )
        names = camera.table.columns["data"]
        found = [to_name(names[row], f"the image of row {row}", camera.table.path) for row in rows]
        return [find_file(self.sensors, name, str(camera.table.path)) for name in found]

    def digest(self) -> str:
        """Hash of the images: of the files that hold them, or of paths and sizes where each is a file of its own."""
        digest = hashlib.sha256()
        for camera in self.source.cameras:
            table = camera.table
            parts = [file_sha256(table.path)]
            if table.types.get("data") == "string":
                paths = self._list_paths(camera, camera.images.rows.tolist())
                parts += [f"{path.name} {path.stat().st_size if path.is_file() else -1}" for path in paths]
            elif table.types.get("data") != "binary":
                parts.append(file_sha256(_find_video(camera)))
            digest.update("\n".join([camera.key, *parts, ""]).encode())
        return digest.hexdigest()


def _find_video(camera: LogCamera) -> Path:
    path = camera.table.path.with_suffix(".mp4")
    if not path.is_file():
        raise InputError(f"{path} is missing, which {camera.table.path} names images of; complete the log")
    return path
