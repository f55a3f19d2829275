"""All camera images of a scene, keyframes and the sweeps between them, as one video a camera."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmark.datasets.sensors import read_views, view_of
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.planning import CameraView


def videos_of_scene(
    nusc: Any, root: Path, samples: Sequence[Row], *, sweeps: bool
) -> dict[str, tuple[CameraView, ...]]:
    """Images by camera name in time order; files are opened only when a view is loaded.

    Args:
        sweeps: Also the images between keyframes, from the first keyframe to the last.

    Returns:
        Views by camera, cameras in the order of `read_views` of the first sample.
    """
    videos: dict[str, list[CameraView]] = {}
    for index, sample in enumerate(samples):
        for name, view in read_views(nusc, root, sample).items():
            video = videos.setdefault(name, [])
            video.append(view)
            if sweeps and index + 1 < len(samples):
                video += _sweeps(nusc, root, sample["data"][name], view)
    for name, video in videos.items():
        times = [view.timestamp_us for view in video]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise InputError(
                f"the images of {name} of scene {samples[0]['scene_token']} turn back in time; fix sample_data.json"
            )
    return {name: tuple(video) for name, video in videos.items()}


def _sweeps(nusc: Any, root: Path, token: str, keyframe: CameraView) -> list[CameraView]:
    """Views after a keyframe up to the next one; the calibration is that of the keyframe."""
    found: list[CameraView] = []
    row, seen = nusc.get("sample_data", token), {token}
    while row["next"] and row["next"] not in seen:
        seen.add(row["next"])
        row = nusc.get("sample_data", row["next"])
        if row["is_key_frame"]:
            return found
        found.append(view_of(nusc, root, row, keyframe.camera))
    # No keyframe follows although there is a later sample: the chain is broken, and its rows belong nowhere.
    return []
