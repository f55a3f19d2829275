"""Where an adversarial scene is driven: around the encounter, and the same part of the recording that it was made from.

The adversary departs from its recording at its launch frame; where the data set names none, at the first frame that is
more than 0.1 m from where it was recorded. A window begins 3 s before the first adversary departs, at a keyframe. It
ends once every adversary has been absent or more than 50 m from the recorded ego for 3 s, counted from when one has
been nearer. So it is the same for every planner, and on the recording as on what was made from it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.closed_loop.default_engine import PRIMING_STEPS
from benchmark.errors import InputError
from benchmark.fairness.data_set_assessment import MOVED_M, find_recording, read_adversarial_scene, read_launches
from benchmark.geometry import Bools, Floats
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.machine.storage import content_key
from benchmark.records.encounter_window import EncounterWindow
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

BEFORE_S: Final = 3.0
FAR_M: Final = 50.0
FAR_S: Final = 3.0
_ROUNDING_S: Final = 1e-6
Windows = Mapping[str, tuple[EncounterWindow, ...]]
"""Windows of scenes, by the scene that is driven."""


def find_windows(
    data: "DataSet", names: Sequence[str], recordings: "DataSet | None" = None, *, whole: bool = False
) -> Windows:
    """The window of each adversarial scene.

    Args:
        data: The data set.
        names: Which of its scenes.
        recordings: What they were made from; tells departures where there are no launch frames.
        whole: Windows of whole scenes, which say who their adversaries are.

    Returns:
        One window a scene. That of a scene of which nothing says where its adversaries depart is all of it.

    Raises:
        InputError: If a scene is too short to be driven.
    """
    return {name: (_find_window(data, name, recordings, whole=whole),) for name in names}


def transfer_windows(windows: Windows, data: "DataSet", unchanged: "DataSet", names: Sequence[str]) -> Windows:
    """The same windows on unchanged recordings, where there is the recording.

    Args:
        windows: Of adversarial scenes.
        data: Their data set.
        unchanged: The data set of the recordings.
        names: Which of its scenes.

    Returns:
        Windows by recording, in the order of the names; their adversaries are who is at the same places until the
        adversarial ones depart.

    Raises:
        InputError: If no adversarial scene was made from any of the recordings.
    """
    sources, facts = data.scene_facts([*windows]), unchanged.scene_facts(names)
    copies = {facts[name].source: name for name in names}
    moved: dict[str, list[EncounterWindow]] = {name: [] for name in names}
    for name, own in windows.items():
        copy = copies.get(sources[name].source)
        if copy is not None:
            moved[copy] += [_transfer_window(window, data.scene(name), unchanged.scene(copy)) for window in own]
    if not any(moved.values()):
        raise InputError(
            f"none of the scenes of {unchanged.name} that are to be driven is a recording that the adversarial scenes "
            "were made from; name the split that has them"
        )
    return {name: tuple(own) for name, own in moved.items() if own}


def hash_windows(windows: Windows) -> str:
    """Eight hexadecimal digits of windows."""
    return content_key("windows", {name: [repr(window) for window in own] for name, own in windows.items()})[:8]


def find_departure(scene: Scene, launches: Mapping[str, int], recorded: Scene | None) -> float | None:
    """Seconds of a scene at which the first of its adversaries departs; ``None`` where nothing says of any."""
    times = [float(scene.seconds[launches[name]]) for name in scene.adversaries if name in launches]
    if not times and recorded is not None:
        known = (_find_first_difference(scene, name, recorded) for name in scene.adversaries)
        times = [time for time in known if time is not None]
    return min(times, default=None)


def find_recorded_agent(scene: Scene, name: str, recorded: Scene, until_s: float = np.inf) -> int | None:
    """Index in a recording of who is where an agent of a scene is up to a time, or as long as it can be told."""
    away, present = _measure_from_recorded(scene, scene.agents.ids.index(name), recorded)
    return _find_same(away, present, scene.seconds <= until_s + _ROUNDING_S)


def _find_same(away: Floats, present: Bools, counted: Bools) -> int | None:
    """Row of (N, T) distances that is near from its first frame on for longest; (T,) frames until then count."""
    before = present & counted
    frames = np.flatnonzero(before.any(axis=0))
    if not len(frames):
        return None
    far = np.where(present & (away > MOVED_M), np.arange(away.shape[1]), away.shape[1]).min(axis=1)
    far[~(before & (away <= MOVED_M)).any(axis=1)] = 0
    best = int(np.argmax(far)) if len(far) else 0
    return best if len(far) and far[best] > frames[0] else None


def _find_window(data: "DataSet", name: str, recordings: "DataSet | None", *, whole: bool) -> EncounterWindow:
    scene, source = read_adversarial_scene(data, name, recordings), data.scene_facts([name])[name].source
    launches = read_launches(data, scene)
    recorded = None if launches or source == name else find_recording(data, name, recordings)
    departs_s = find_departure(scene, launches, recorded)
    last = len(scene.keyframes) - 1
    if last < PRIMING_STEPS + 1:
        raise InputError(f"scene {name} has {last + 1} keyframes, too few for a drive; leave it out with --scenes")
    rounded_s = None if departs_s is None else round(departs_s, 6)
    window = EncounterWindow(name, PRIMING_STEPS, last, scene.adversaries, rounded_s)
    if whole or departs_s is None:
        return window
    times = scene.seconds[scene.keyframes]
    start = int(np.searchsorted(times, departs_s - BEFORE_S + _ROUNDING_S, side="right")) - 1
    start = min(max(start, PRIMING_STEPS), last - 1)
    over_s = _find_end(scene, departs_s)
    end = last if over_s is None else int(np.searchsorted(times, over_s - _ROUNDING_S))
    return replace(window, start=start, end=min(max(end, start + 1), last))


def _find_end(scene: Scene, departs_s: float) -> float | None:
    """When every adversary has been away for 3 s, seconds; ``None`` where that does not come."""
    rows = [scene.agents.ids.index(name) for name in scene.adversaries]
    after = np.flatnonzero(scene.seconds >= departs_s - _ROUNDING_S)
    offset = scene.agents.position[rows][:, after, :2] - scene.ego.boxes[after, :2]
    near = (scene.agents.valid[rows][:, after] & (np.hypot(*np.moveaxis(offset, -1, 0)) <= FAR_M)).any(axis=0)
    seconds = scene.seconds[after]
    last_near_s: float | None = None
    for is_near, now in zip(near.tolist(), seconds.tolist(), strict=True):
        if last_near_s is not None and now - last_near_s >= FAR_S:
            return float(last_near_s + FAR_S)
        last_near_s = now if is_near else last_near_s
    return None


def _find_first_difference(scene: Scene, name: str, recorded: Scene) -> float | None:
    """When an agent first is elsewhere than in the recording; at its first frame if the recording does not have it."""
    agent = scene.agents.ids.index(name)
    frames = np.flatnonzero(scene.agents.valid[agent])
    away, present = _measure_from_recorded(scene, agent, recorded)
    same = _find_same(away, present, np.ones_like(scene.seconds, np.bool_))
    if same is not None:
        frames = frames[(~present[same] | (away[same] > MOVED_M))[frames]]
    return float(scene.seconds[frames[0]]) if len(frames) else None


def _measure_from_recorded(scene: Scene, agent: int, recorded: Scene) -> tuple[Floats, Bools]:
    """(N, T) metres from an agent to each of a recording's of its category, and (N, T) where both are there."""
    boxes, present = ContinuousTracks.of_scene(recorded).agents_at(scene.seconds)
    offset = boxes[..., :2] - scene.agents.position[agent, :, :2]
    alike = np.array([name == scene.agents.categories[agent] for name in recorded.agents.categories], np.bool_)
    inside = scene.seconds <= recorded.seconds[-1] + _ROUNDING_S
    return np.hypot(*np.moveaxis(offset, -1, 0)), present & alike[:, None] & scene.agents.valid[agent] & inside


def _transfer_window(window: EncounterWindow, scene: Scene, recorded: Scene) -> EncounterWindow:
    if window.end >= len(recorded.keyframes):
        raise InputError(
            f"{recorded.name} has {len(recorded.keyframes)} keyframes, too few for the window of {window.of}; "
            "drive the recordings that it was made from"
        )
    until_s = np.inf if window.departs_s is None else window.departs_s
    found = (find_recorded_agent(scene, name, recorded, until_s) for name in window.adversaries)
    names = tuple(recorded.agents.ids[agent] for agent in found if agent is not None)
    return replace(window, adversaries=names)
