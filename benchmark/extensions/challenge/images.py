"""Images of an entry: there, whole, of the right size, of anything, and of their own keyframe and camera.

Pictures are drawn anew for an entry and cannot be compared with the recording's pixel by pixel. Small grey versions
are: a picture of another keyframe is more like that one's neighbours than like its own, and where the recording is
drawn in the same way, it is most like the recording's at that time and of that camera.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.box_projection import compute_box_corners, to_camera
from benchmark.errors import InputError
from benchmark.extensions.challenge.recorded_part import CommonKeyframes
from benchmark.extensions.challenge.rules import ImageRules
from benchmark.geometry import Floats
from benchmark.interactions.tracks import Integers
from benchmark.machine.storage import file_sha256
from benchmark.planning import CameraView
from benchmark.records.challenge import RefusalReason
from benchmark.report.words import pluralise
from benchmark.scene import Scene
from benchmark.untrusted.http_images import read_picture

Views = Mapping[str, Sequence[CameraView]]

_SMALL: Final = (32, 18)
"""Width and height of the versions that are compared, pixels."""
_ALIKE: Final = 2.0
"""Mean difference, grey values, below which two small pictures show the same."""
_OF_ONE_STYLE: Final = 12.0
"""The same, below which entry and recording are drawn in the same way."""
_CLEARLY: Final = 0.3
"""A picture is of another keyframe or camera if it differs from that one's by less than this share of the difference
from its own."""
_FARTHEST_SHIFT: Final = 3
_NEAR_M: Final = 40.0
_SEEN_SHARE: Final = 0.01
"""A vehicle that near, and that large in a picture, cannot be overlooked."""
_LEAST_SEEN: Final = 2


@dataclass(frozen=True, slots=True)
class CameraThumbnails:
    """Pictures of one camera at K keyframes: (K, 18, 32) grey values, and K hashes of the files."""

    small: Floats
    digests: tuple[str, ...]


def check_image_files(views: Views, rules: ImageRules) -> tuple[dict[str, CameraThumbnails], list[RefusalReason]]:
    """Pictures of the cameras all of whose files can be read, and at most one reason for each camera and rule."""
    thumbnails: dict[str, CameraThumbnails] = {}
    reasons: dict[tuple[str, str], str] = {}
    for name, of_camera in views.items():
        small, digests = [], []
        for keyframe, view in enumerate(of_camera):
            faults, picture = _check_picture(view, rules)
            for rule, sentence in faults:
                reasons.setdefault((rule, name), f"{sentence} ({name}, keyframe {keyframe})")
            if picture is not None:
                small.append(picture)
                digests.append(file_sha256(view.path))
        if len(small) == len(of_camera):
            thumbnails[name] = CameraThumbnails(np.array(small), tuple(digests))
    return thumbnails, [RefusalReason(rule=rule, sentence=sentence) for (rule, _), sentence in reasons.items()]


def read_thumbnails(views: Views) -> dict[str, CameraThumbnails]:
    """The same of a recording, as far as it has pictures; what cannot be read is left out."""
    thumbnails = {}
    for name, of_camera in views.items():
        try:
            small = np.array([_shrink(read_picture(view.path)) for view in of_camera])
        except InputError:
            continue
        thumbnails[name] = CameraThumbnails(small, tuple(file_sha256(view.path) for view in of_camera))
    return thumbnails


def _check_picture(view: CameraView, rules: ImageRules) -> tuple[list[tuple[str, str]], Floats | None]:
    """Rules that a picture breaks, each with a sentence, and its small version if it can be read."""
    try:
        picture = view.load()
    except InputError as error:
        return [("images.required", _strip_folder(str(error), view.path))], None
    faults = []
    height, width = picture.shape[:2]
    if (width, height) != (view.camera.width, view.camera.height):
        rows = f"{view.camera.width} x {view.camera.height}"
        faults.append(("images.required", f"{view.path.name} is {width} x {height} pixels, but its row has {rows}"))
    if (rules.width and width != rules.width) or (rules.height and height != rules.height):
        needed = f"{rules.width or 'any'} x {rules.height or 'any'}"
        faults.append(("images.width", f"{view.path.name} is {width} x {height} pixels; {needed} are needed"))
    contrast = float(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).std())
    if contrast < rules.least_contrast:
        faults.append(
            ("images.least_contrast", f"{view.path.name} shows nothing: its grey values deviate by {contrast:.2g}")
        )
    return faults, _shrink(picture)


def _strip_folder(sentence: str, path: Path) -> str:
    return sentence.replace(str(path), path.name)


def _shrink(picture: NDArray[np.uint8]) -> Floats:
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, _SMALL, interpolation=cv2.INTER_AREA), np.float64)


def check_image_times(
    seen: Mapping[str, CameraThumbnails], recorded: Mapping[str, CameraThumbnails], common: CommonKeyframes
) -> Iterator[RefusalReason]:
    """Reasons against pictures that show another keyframe or camera, at most one for each camera and way to tell."""
    for name, pictures in seen.items():
        displaced = [
            (k, other)
            for k in range(len(pictures.small))
            if (other := _find_matching_keyframe(pictures, k)) is not None
        ]
        if displaced:
            k, other = displaced[0]
            more = "" if len(displaced) == 1 else f", as in {pluralise(len(displaced) - 1, 'other picture')}"
            yield RefusalReason(
                rule="images.of_their_time",
                sentence=f"the picture of {name} at keyframe {k} shows keyframe {other} rather{more}",
            )
    yield from _find_shifted_cameras(seen, recorded, common)


def _find_matching_keyframe(pictures: CameraThumbnails, k: int) -> int | None:
    """The keyframe whose surroundings the picture of keyframe k fits clearly better than its own."""
    small = pictures.small
    count = len(small)
    own = [at for at in (k - 1, k + 1) if 0 <= at < count]
    apart = np.abs(small - small[k]).mean(axis=(1, 2))
    least_own = min((float(apart[at]) for at in own), default=0.0)
    if len(own) == 2:
        across = float(np.abs(small[own[0]] - small[own[1]]).mean())
        if least_own > _ALIKE and across < least_own:
            far = [at for at in range(count) if abs(at - k) > 1]
            best = min(far, key=lambda at: apart[at], default=None)
            if best is not None and apart[best] < _CLEARLY * least_own:
                return best
    # The very file of a neighbour, while the pictures before and after change.
    for at in own:
        before, after = min(at, k) - 1, max(at, k) + 1
        changes = [
            float(np.abs(small[first] - small[other]).mean())
            for first, other in ((before, min(at, k)), (max(at, k), after))
            if first >= 0 and other < count
        ]
        if pictures.digests[at] == pictures.digests[k] and at < k and changes and min(changes) > _ALIKE:
            return at
    return None


def _find_shifted_cameras(
    thumbnails: Mapping[str, CameraThumbnails], recorded: Mapping[str, CameraThumbnails], common: CommonKeyframes
) -> Iterator[RefusalReason]:
    """Cameras whose pictures, all together, are the recording's of another time or camera."""
    for name in (camera for camera in thumbnails if camera in recorded):
        mine, theirs = thumbnails[name].small[common.here], recorded[name].small
        own = _median_distance(mine, theirs[common.there])
        others = {
            other: _median_distance(mine, pictures.small[common.there])
            for other, pictures in recorded.items()
            if other != name and len(pictures.small) == len(theirs)
        }
        nearest = min(others, key=lambda other: others[other], default=None)
        if nearest is not None and others[nearest] < min(_OF_ONE_STYLE, _CLEARLY * own) and own > _ALIKE:
            yield RefusalReason(
                rule="images.of_their_time", sentence=f"the pictures of {name} show the recorded view of {nearest}"
            )
            continue
        shifted = {shift: _shifted_distance(mine, theirs, common.there, shift) for shift in _list_shifts(len(theirs))}
        best = min(shifted, key=lambda shift: shifted[shift], default=0)
        if shifted and shifted[best] < min(_OF_ONE_STYLE, _CLEARLY * own) and own > _ALIKE:
            when = f"{pluralise(abs(best), 'keyframe')} {'later' if best > 0 else 'earlier'}"
            yield RefusalReason(
                rule="images.of_their_time", sentence=f"the pictures of {name} show the recording {when}"
            )
            continue
        if (single := _find_displaced_picture(mine, theirs, common.there)) is not None:
            place, other = single
            yield RefusalReason(
                rule="images.of_their_time",
                sentence=f"the picture of {name} at keyframe {common.here[place]} shows the recording at "
                f"keyframe {other}",
            )


def _find_displaced_picture(mine: Floats, theirs: Floats, there: Integers) -> tuple[int, int] | None:
    """The first picture that the recording has, as good as equal, at another keyframe: its place, and that keyframe."""
    for place, (picture, own) in enumerate(zip(mine, there.tolist(), strict=True)):
        apart = np.abs(theirs - picture).mean(axis=(1, 2))
        best = int(np.argmin(apart))
        if best != own and apart[best] < min(_ALIKE, _CLEARLY * apart[own]) and apart[own] > 2 * _ALIKE:
            return place, best
    return None


def _list_shifts(count: int) -> list[int]:
    most = min(_FARTHEST_SHIFT, count // 2)
    return [shift for shift in range(-most, most + 1) if shift]


def _median_distance(first: Floats, second: Floats) -> float:
    """Median over the keyframes of how far pictures are apart."""
    return float(np.median(np.abs(first - second).mean(axis=(1, 2))))


def _shifted_distance(mine: Floats, theirs: Floats, there: Integers, shift: int) -> float:
    inside = (there + shift >= 0) & (there + shift < len(theirs))
    return _median_distance(mine[inside], theirs[there[inside] + shift]) if inside.any() else np.inf


def check_change_is_seen(
    entry: Scene,
    agent: int,
    changed: Integers,
    views: tuple[Views, Views],
    pictures: tuple[Mapping[str, CameraThumbnails], Mapping[str, CameraThumbnails]],
    common: CommonKeyframes,
) -> RefusalReason | None:
    """Reason why a changed vehicle is unseen: all pictures that it must be in are the recording's own files.

    ``changed`` are indices of common keyframes at which it is elsewhere; of each pair the entry comes first.
    """
    same = []
    for name in (camera for camera in pictures[0] if camera in pictures[1]):
        for place in changed.tolist():
            here, there = int(common.here[place]), int(common.there[place])
            if entry.annotations.valid[agent, here] and _is_large(entry, agent, here, views[0][name][here]):
                same.append(pictures[0][name].digests[here] == pictures[1][name].digests[there])
    if len(same) >= _LEAST_SEEN and all(same):
        return RefusalReason(
            rule="images.of_their_time",
            sentence=f"all {len(same)} pictures in which the changed vehicle is large are the recording's, without it",
        )
    return None


def _is_large(entry: Scene, agent: int, keyframe: int, view: CameraView) -> bool:
    frame = int(entry.keyframes[keyframe])
    size = entry.annotations.size[agent, keyframe]
    corners = compute_box_corners(entry.agents.position[agent, frame], float(entry.agents.yaw[agent, frame]), size)
    corners_in_camera = to_camera(corners, view.global_T_ego, view.camera)
    if (corners_in_camera[:, 2] < 1.0).any() or corners_in_camera[:, 2].min() > _NEAR_M:
        return False
    pixels = corners_in_camera @ view.camera.intrinsic.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    edge = np.array([view.camera.width, view.camera.height])
    low, high = np.clip(pixels.min(axis=0), 0, edge), np.clip(pixels.max(axis=0), 0, edge)
    return bool((high - low).prod() > _SEEN_SHARE * edge.prod())
