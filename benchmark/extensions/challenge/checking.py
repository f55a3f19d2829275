"""``challenge check``: an entry held to the recordings that it was made from and to the rules.

Nothing that an entry says of itself is believed but by how much its scenes' times were moved: who is changed, how, and
what touches what is found in its tables and images, drivability from keyframes alone. Its own judgements and verdicts
of inspectors are not read.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from benchmark.constants import VERSION
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_names import find_shift_us, resolve_names
from benchmark.datasets.steps import require_two_hz
from benchmark.dynamics.bicycle import compute_rear_axle
from benchmark.errors import InputError, did_you_mean
from benchmark.extensions.challenge.changed_objects import (
    ChangedObject,
    Nearness,
    check_changed_objects,
    check_changed_vehicle,
    check_drivable_area,
    check_gap,
    check_labels,
    find_changed_objects,
    find_nearest_ego,
    find_nearest_object,
)
from benchmark.extensions.challenge.images import (
    Views,
    check_change_is_seen,
    check_image_files,
    check_image_times,
    read_thumbnails,
)
from benchmark.extensions.challenge.recorded_part import (
    CommonKeyframes,
    Counterparts,
    check_ego,
    check_map,
    check_planner_inputs,
    check_sensors,
    check_times,
    match_objects,
    require_comparable,
)
from benchmark.extensions.challenge.rules import ChallengeRules, MotionRules
from benchmark.geometry import Floats, wrap_angle, yaw_of_quaternion
from benchmark.interactions.tracks import Integers
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.records.challenge import ChangedVehicle, ComparedData, EntryVerdict, RefusalReason, SceneVerdict
from benchmark.scene import Scene


def check_motion_limits(seconds: Floats, boxes: Floats, rules: MotionRules) -> Iterator[RefusalReason]:
    """Limits that a track breaks, one reason each, by (K,) seconds and (K, 5) boxes from where it is changed."""
    if len(boxes) < 2:
        return
    span = np.diff(seconds)
    along, across, turn = _compute_step_motion(seconds, boxes)
    yaw_rate = turn / span
    # A lateral acceleration that changes its sign in the middle displaces the axle by a quarter of it times the time.
    sideways = rules.sideways_m_s + rules.lateral_m_s2 * span / 4
    measured: list[tuple[str, Floats, Floats | float, str]] = [
        ("yaw_rate_rad_s", np.abs(yaw_rate), rules.yaw_rate_rad_s * rules.tolerance, "rad/s of yaw rate"),
        ("lateral_m_s2", np.abs(yaw_rate * along), rules.lateral_m_s2 * rules.tolerance, "m/s^2 across"),
        ("sideways_m_s", np.abs(across), sideways * rules.tolerance, "m/s sideways"),
        ("backwards_m_s", -along, np.full(len(along), rules.backwards_m_s), "m/s backwards"),
    ]
    if len(boxes) > 2:
        acceleration = np.diff(along) / (0.5 * (span[:-1] + span[1:]))
        measured += [
            ("acceleration_m_s2", acceleration, rules.acceleration_m_s2 * rules.tolerance, "m/s^2 forwards"),
            ("braking_m_s2", -acceleration, rules.braking_m_s2 * rules.tolerance, "m/s^2 of braking"),
        ]
    for rule, values, limit, unit in measured:
        excess = values - limit
        at = int(np.argmax(excess))
        if excess[at] > 0:
            most = float(np.broadcast_to(limit, values.shape)[at])
            yield RefusalReason(
                rule=f"motion.{rule}",
                sentence=f"needs {values[at]:.3g} {unit} at {seconds[at]:.1f} s; {most:.3g} are allowed",
            )


def check_launch(seconds: Floats, boxes: Floats, rules: MotionRules) -> RefusalReason | None:
    """Jump of a vehicle where its recorded track ends, by (3,) seconds and (3, 5) boxes: two recorded, one changed."""
    first, second = np.diff(seconds)
    before, after = np.diff(boxes[:, :2], axis=0)
    expected = before / first * second
    off = float(np.hypot(*(after - expected)))
    most = rules.launch_m_s2 * 0.5 * second * (first + second) + rules.launch_m
    if off <= most:
        return None
    return RefusalReason(
        rule="motion.launch_m_s2",
        sentence=f"jumps at {seconds[1]:.1f} s, where its recorded track ends: {off:.3g} m off its extrapolated path; "
        f"{most:.3g} m are allowed",
    )


def _compute_step_motion(seconds: Floats, boxes: Floats) -> tuple[Floats, Floats, Floats]:
    """(K - 1,) mean speed of the rear axle along and across its mean heading, and (K - 1,) turn, radians."""
    axle = compute_rear_axle(boxes[:, [0, 1, 4]], float(boxes[0, 2]))
    turn = wrap_angle(np.diff(axle[:, 2]))
    heading = axle[:-1, 2] + 0.5 * turn
    step = np.diff(axle[:, :2], axis=0) / np.diff(seconds)[:, None]
    # The length of an arc exceeds its chord.
    longer = 1.0 / np.sinc(turn / (2 * np.pi))
    along = (step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)) * longer
    across = step[:, 1] * np.cos(heading) - step[:, 0] * np.sin(heading)
    return along, across, turn


DIGITS: Final = 3
NO_MAP: Final = "the recordings have no map: the drivable area was not checked"
NO_CAMERAS: Final = "the recordings have no cameras: calibration was not compared"


@dataclass(frozen=True, slots=True)
class CheckedScene:
    """Verdict on a scene; ``tracks`` are recorded tokens and (K, 2) keyframe positions, NaN where absent."""

    verdict: SceneVerdict
    tracks: tuple[tuple[str, Floats], ...]


def check_entry(
    entry: DataSet,
    base: DataSet,
    rules: ChallengeRules,
    names: Sequence[str] | None = None,
    executor: Executor | None = None,
) -> EntryVerdict:
    """Check an entry, a third-party data set made from the recordings of `base`.

    Args:
        names: Scenes of the entry, all by default; then it need not have all that the rules require.
        executor: Where scenes are checked; this process by default. Nothing depends on it.

    Raises:
        InputError: If a scene is not of these recordings, is missing, or is broken.
    """
    sources = find_source_recordings(entry, base, names)
    if names is None:
        _require_scenes(entry, sources, rules)
    work = [(name, sources[name]) for name in sources]
    check = partial(_check_scene, entry, base, rules)
    checked = list((executor or LocalProcesses(1)).map(check, work, total=len(work), label="checking scenes"))
    return EntryVerdict(
        version=VERSION,
        entry=ComparedData(name=entry.name, fingerprint=entry.fingerprint()),
        base=ComparedData(name=base.name, fingerprint=base.fingerprint()),
        challenge=rules.name,
        rules=rules.fingerprint,
        reasons=tuple(_check_scenes_per_recording(sources, rules)),
        scenes=tuple(_add_repeat_reasons(checked, rules)),
    )


def find_source_recordings(entry: DataSet, base: DataSet, names: Sequence[str] | None = None) -> dict[str, str]:
    """Recorded scene that each scene of an entry was made from, in its order; refused where none is known."""
    present = entry.scene_names(None)
    names = None if names is None else resolve_names(entry.provenance(), names)
    for name in names or ():
        if name not in present:
            raise InputError(f"{entry.root} has no scene {name!r}; {did_you_mean(name, present)}it has {len(present)}")
    wanted = [name for name in present if names is None or name in names]
    if not wanted:
        raise InputError(f"{entry.root} has no scene to check")
    sources = {name: facts.source for name, facts in entry.scene_facts(wanted).items()}
    recorded = set(base.scene_names(None))
    if lost := next((name for name in wanted if sources[name] not in recorded), None):
        raise InputError(
            f"{lost} of {entry.root} names {sources[lost]} as its recording, which {base.root} lacks; give the "
            "recordings with --base, or name the scene after its recording, such as scene-0061-a"
        )
    return sources


def _require_scenes(entry: DataSet, sources: Mapping[str, str], rules: ChallengeRules) -> None:
    if missing := sorted(set(rules.scenes.required) - set(sources.values())):
        raise InputError(
            f"{entry.root} has no scene made from {', '.join(missing[:5])}{', ...' if len(missing) > 5 else ''}, "
            f"{len(missing)} of {len(rules.scenes.required)} recordings that the rules require; add them"
        )


def _check_scenes_per_recording(sources: Mapping[str, str], rules: ChallengeRules) -> Iterator[RefusalReason]:
    most = rules.scenes.most_of_one
    for recording, count in Counter(sources.values()).items():
        if most and count > most:
            yield RefusalReason(
                rule="scenes.most_of_one", sentence=f"has {count} scenes of {recording}; the rules allow {most}"
            )


def _add_repeat_reasons(checked: Sequence[CheckedScene], rules: ChallengeRules) -> Iterator[SceneVerdict]:
    """Verdicts, with the reason added to scenes that repeat an earlier one."""
    earlier: dict[tuple[str, tuple[str, ...]], list[CheckedScene]] = {}
    for scene in checked:
        verdict = scene.verdict
        alike = earlier.setdefault((verdict.recording, tuple(token for token, _ in scene.tracks)), [])
        twin = next((other for other in alike if _is_repeat(scene, other, rules.scenes.apart_m)), None)
        if twin is not None:
            reason = RefusalReason(rule="scenes.apart_m", sentence=f"repeats the scene {twin.verdict.scene}")
            verdict = verdict.model_copy(update={"reasons": (*verdict.reasons, reason)})
        alike.append(scene)
        yield verdict


def _is_repeat(scene: CheckedScene, other: CheckedScene, apart_m: float) -> bool:
    if not scene.tracks:
        return not other.tracks
    for (_, mine), (_, theirs) in zip(scene.tracks, other.tracks, strict=True):
        if mine.shape != theirs.shape or (np.isnan(mine) != np.isnan(theirs)).any():
            return False
        if np.nanmax(np.hypot(*(mine - theirs).T), initial=0.0) > apart_m:
            return False
    return True


def _check_scene(entry: DataSet, base: DataSet, rules: ChallengeRules, work: tuple[str, str]) -> CheckedScene:
    return _SceneCheck.of(entry, base, rules, *work).result()


@dataclass(frozen=True, slots=True)
class _SceneCheck:
    """Everything that is looked at of one scene."""

    entry: DataSet
    base: DataSet
    rules: ChallengeRules
    scene: Scene
    recorded: Scene
    common: CommonKeyframes
    known: Counterparts
    differing: tuple[ChangedObject, ...]
    views: tuple[Views, Views]
    notes: list[str]

    @classmethod
    def of(cls, entry: DataSet, base: DataSet, rules: ChallengeRules, name: str, source: str) -> "_SceneCheck":
        shift_us = find_shift_us(entry.provenance(), name)
        scene, recorded = entry.scene(name), base.scene(source)
        scene = replace(scene, timestamps_us=scene.timestamps_us - shift_us)
        require_two_hz(recorded, "the challenge")
        common = CommonKeyframes.common(scene, recorded)
        require_comparable(scene, recorded, common)
        known = match_objects(scene, recorded, common)
        changed_objects = find_changed_objects(scene, recorded, known, common, rules)
        mine = {
            camera: tuple(replace(view, timestamp_us=view.timestamp_us - shift_us) for view in of_camera)
            for camera, of_camera in entry.videos(name, sweeps=False).items()
        }
        views = mine, base.videos(source, sweeps=False)
        return cls(entry, base, rules, scene, recorded, common, known, tuple(changed_objects), views, [])

    def result(self) -> CheckedScene:
        reasons = [*self._check_recorded_part(), *self._who(), *self._images()]
        vehicles = []
        for changed_object in self.differing[: max(self.rules.changed.most, 1)]:
            vehicle_reasons, vehicle = self._vehicle(changed_object)
            reasons += vehicle_reasons
            vehicles.append(vehicle)
        vehicles += [
            self._describe_vehicle(changed_object)
            for changed_object in self.differing[max(self.rules.changed.most, 1) :]
        ]
        verdict = SceneVerdict(
            scene=self.scene.name,
            recording=self.recorded.name,
            reasons=tuple(reasons),
            notes=tuple(self.notes),
            changed=tuple(vehicles),
            images=sum(map(len, self.views[0].values())),
        )
        return CheckedScene(verdict, tuple(self._track(changed_object) for changed_object in self.differing))

    def _check_recorded_part(self) -> Iterator[RefusalReason]:
        rules = self.rules.unchanged
        yield from check_times(self.scene, self.recorded, self.common)
        yield from check_ego(self.scene, self.recorded, self.common, rules)
        yield from check_sensors(
            self.scene, self.recorded, self.common, self.views, rules, required=self.rules.images.required
        )
        if not self.views[1]:
            self.notes.append(NO_CAMERAS)
        if self.base.has_map(self.recorded.name):
            yield from check_map(self.scene.road_map, self.recorded.road_map, rules)
        else:
            self.notes.append(NO_MAP)
        # A scene with missing images yields no observations; the missing images are a reason by themselves.
        there = {view.path.is_file() for of_camera in self.views[0].values() for view in of_camera}
        if len(there) < 2:
            mine = list(self.entry.observations(self.scene.name))
            theirs = list(self.base.observations(self.recorded.name))
            yield from check_planner_inputs(mine, theirs, self.common, rules)

    def _who(self) -> Iterator[RefusalReason]:
        arguments = self.scene, self.recorded, self.known, self.differing, self.common, self.rules
        yield from check_changed_objects(*arguments)
        yield from check_labels(*arguments)

    def _images(self) -> Iterator[RefusalReason]:
        if not self.rules.images.required or not self.views[1]:
            return
        thumbnails, reasons = check_image_files(self.views[0], self.rules.images)
        yield from reasons
        if not self.rules.images.of_their_time:
            return
        recorded = read_thumbnails(self.views[1])
        yield from check_image_times(thumbnails, recorded, self.common)
        for changed_object in self.differing[: self.rules.changed.most]:
            changed = np.flatnonzero(changed_object.at)
            reason = check_change_is_seen(
                self.scene, changed_object.agent, changed, self.views, (thumbnails, recorded), self.common
            )
            if reason is not None:
                yield reason

    def _vehicle(self, changed_object: ChangedObject) -> tuple[list[RefusalReason], ChangedVehicle]:
        """Verdict on one changed vehicle."""
        rules, scene = self.rules, self.scene
        reasons = list(check_changed_vehicle(scene, self.recorded, changed_object, self.common, rules))
        reasons += self._check_motion(changed_object)
        frames = self._frames(changed_object)
        if not len(frames):
            return reasons, self._describe_vehicle(changed_object)
        boxes = scene.agents.boxes[changed_object.agent, frames]
        if self.base.has_map(self.recorded.name):
            reasons += check_drivable_area(boxes, scene.seconds[frames], self.recorded.road_map, rules.road)
        other = find_nearest_object(scene, changed_object.agent, frames)
        ego = find_nearest_ego(scene, changed_object.agent, int(self.common.here[changed_object.first]))
        reasons += [
            gap_reason for gap_reason in (check_gap(near, scene, rules.gaps) for near in (ego, other)) if gap_reason
        ]
        return reasons, self._describe_vehicle(changed_object, ego, other)

    def _check_motion(self, changed_object: ChangedObject) -> Iterator[RefusalReason]:
        here = self.common.here
        there = here[changed_object.at & self.scene.annotations.valid[changed_object.agent, here]]
        seconds = self.scene.seconds[self.scene.keyframes]
        yield from check_motion_limits(seconds[there], self._boxes(changed_object.agent, there), self.rules.motion)
        before = here[: changed_object.first]
        before = before[self.scene.annotations.valid[changed_object.agent, before]][-2:]
        if len(before) == 2 and len(there):
            at = np.concatenate([before, there[:1]])
            launch = check_launch(seconds[at], self._boxes(changed_object.agent, at), self.rules.motion)
            if launch is not None:
                yield launch

    def _boxes(self, agent: int, keyframes: Integers) -> Floats:
        """(C, 5) boxes at keyframes, as annotated."""
        notes, at = self.scene.annotations, (agent, keyframes)
        yaw = yaw_of_quaternion(notes.rotation[at])[:, None]
        return np.concatenate([notes.position[at][:, :2], notes.size[at][:, :2], yaw], axis=1)

    def _frames(self, changed_object: ChangedObject) -> Integers:
        """Frames after the last keyframe before it differs at which it is there."""
        first = int(self.common.here[changed_object.first])
        start = int(self.scene.keyframes[first - 1]) + 1 if first else 0
        return start + np.flatnonzero(self.scene.agents.valid[changed_object.agent, start:])

    def _describe_vehicle(
        self, changed_object: ChangedObject, ego: Nearness | None = None, other: Nearness | None = None
    ) -> ChangedVehicle:
        at = self.scene.keyframes[self.common.here[changed_object.first]]
        return ChangedVehicle(
            instance=self.scene.agents.ids[changed_object.agent],
            recorded=self.recorded.agents.ids[changed_object.recorded],
            category=self.scene.agents.categories[changed_object.agent],
            from_s=round(float(self.scene.seconds[at]), DIGITS),
            farthest_m=round(changed_object.farthest_m, DIGITS),
            least_gap_ego_m=None if ego is None else round(ego.gap_m, DIGITS),
            least_gap_others_m=None if other is None else round(other.gap_m, DIGITS),
            nearest_ego_s=None if ego is None else round(ego.seconds, DIGITS),
        )

    def _track(self, changed_object: ChangedObject) -> tuple[str, Floats]:
        notes = self.scene.annotations
        places = np.where(
            notes.valid[changed_object.agent, :, None], notes.position[changed_object.agent, :, :2], np.nan
        )
        return self.recorded.agents.ids[changed_object.recorded], places
