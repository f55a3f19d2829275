"""Drives around an encounter: where the window is, who keeps its track, and the same on the recording."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import api
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import run_episode
from benchmark.closed_loop.simulation_config import interpolate_recorded_poses
from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.errors import InputError
from benchmark.machine.workers import LocalProcesses
from benchmark.metrics.drive_effect import collect_drive_effects
from benchmark.planning import Planner
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.run_schema import SceneFacts
from benchmark.runs.driving import DriveSettings, drive_shard, drive_split
from benchmark.runs.encounters import find_departure, find_windows, transfer_windows
from benchmark.runs.plan_rows import PlannerFactory
from benchmark.runs.redriving import redrive_and_score
from benchmark.runs.rescoring_drives import rescore_drives
from benchmark.runs.units import Shard
from benchmark.scene import Scene
from leaderboard.tables.drives import drive_tables
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Factory, Straight
from tests.hand_made import Car, scene_on_straight_road

LAUNCH = 72
"""Frame, at 6 s."""
CARS = (Car(62.0, 194.75, 8.0), Car(30.0, 198.25, 8.0), Car(120.0, 201.75, 9.0, np.pi))
"""Beside the ego, behind it, and oncoming."""


@dataclass
class Made(FakeData):
    """Adversarial scenes, by name with their launch frames; null where nothing is said."""

    launches: dict[str, int | None] = field(default_factory=dict)

    def made(self, name: str) -> dict[str, Any]:
        adversaries = [*self.scenes[name].adversaries]
        report = {} if self.launches[name] is None else {"report": {"launch_frame": self.launches[name]}}
        return {"source_scene": "scene-9901", "adversaries": adversaries, **report}

    def provenance(self) -> dict[str, Any] | None:
        return {"scenes": {name: self.made(name) for name in self.scenes}}

    def scene_facts(self, names: Any) -> dict[str, SceneFacts]:
        return {name: build_scene_facts(name, self.made(name)) for name in names}


def recording(seconds: float = 14.0) -> Scene:
    return scene_on_straight_road(CARS, ego_speed=8.0, seconds=seconds)


def cut_in(launch: int = LAUNCH, name: str = "scene-9901-cut", leaves: bool = False) -> Scene:
    """The car beside the ego changes into its lane and stops, or drives off at 30 m/s."""
    scene = recording()
    steps = np.arange(len(scene.timestamps_us) - launch) / 12.0
    x, y = scene.agents.position[0, launch, :2]
    speed = 30.0 if leaves else 8.0
    travel = speed * steps if leaves else speed * np.minimum(steps, 2.0) - 2.0 * np.minimum(steps, 2.0) ** 2
    poses = np.column_stack([x + travel, np.minimum(y + 2.0 * steps, 198.25), np.zeros(len(steps))])
    moved = replace(scene.with_adversary(0, slice(launch, len(scene.timestamps_us)), poses), name=name)
    # Instances of generated roots have identifiers of their own.
    ids = tuple(f"made-{number}" for number in range(len(moved.agents)))
    return replace(moved, agents=replace(moved.agents, ids=ids), adversaries=ids[:1])


def data(launches: int | None = LAUNCH, **changes: Any) -> Made:
    scene = cut_in(**changes)
    return Made({scene.name: scene}, launches={scene.name: launches})


RECORDED = FakeData({"scene-9901": recording()})


def unchanged_data() -> FakeData:
    return RECORDED


def two_variants() -> Made:
    """Of one recording, which is driven in two windows then."""
    made, gone = data(), data(60, launch=60, name="scene-9901-gone", leaves=True)
    return Made({**made.scenes, **gone.scenes}, launches={**made.launches, **gone.launches})


def settings(agents: str = "idm", **changes: Any) -> DriveSettings:
    changes.setdefault("window", "encounter")
    return DriveSettings("default", DefaultBackend(agents), agents, **changes)


def test_a_window_begins_three_seconds_before_the_launch() -> None:
    (window,) = find_windows(data(), ["scene-9901-cut"])["scene-9901-cut"]
    assert (window.departs_s, window.start, window.end) == (6.0, 6, 27) and window.adversaries == ("made-0",)
    (early,) = find_windows(data(14, launch=14), ["scene-9901-cut"])["scene-9901-cut"]
    assert early.start == 2
    (whole,) = find_windows(data(), ["scene-9901-cut"], whole=True)["scene-9901-cut"]
    assert (whole.start, whole.end) == (2, 27)


def test_without_a_launch_the_recording_tells_when_it_departs() -> None:
    scene = cut_in()
    (window,) = find_windows(data(None), [scene.name], RECORDED)[scene.name]
    first = np.flatnonzero(np.hypot(*(scene.agents.position - recording().agents.position)[0, :, :2].T) > 0.1)[0]
    assert window.departs_s == pytest.approx(scene.seconds[first], abs=1e-6)
    # Nothing is known of where it was: the whole scene, and none of it is a guess.
    (unknown,) = find_windows(data(None), [scene.name])[scene.name]
    assert (unknown.departs_s, unknown.start, unknown.end) == (None, 2, 27)


def test_of_several_adversaries_the_first_counts_and_a_new_one_departs_when_it_comes() -> None:
    scene = replace(cut_in(), adversaries=("made-0", "made-1"))
    assert find_departure(scene, {"made-0": 72, "made-1": 60}, None) == 5.0
    valid = scene.agents.valid.copy()
    valid[1, :48] = False
    position = scene.agents.position.copy()
    position[1, :, 1] = 205.0
    new = replace(scene, agents=replace(scene.agents, valid=valid, position=position))
    assert find_departure(new, {}, recording()) == pytest.approx(4.0)


def test_it_ends_when_the_adversary_has_been_gone_for_three_seconds() -> None:
    (window,) = find_windows(data(leaves=True), ["scene-9901-cut"])["scene-9901-cut"]
    scene = cut_in(leaves=True)
    apart = np.hypot(*(scene.agents.position[0, :, :2] - scene.ego.boxes[:, :2]).T)
    last_near = scene.seconds[np.flatnonzero(apart <= 50.0)[-1]]
    over = float(scene.seconds[scene.keyframes[window.end]])
    assert last_near + 3.0 <= over < last_near + 3.6 and window.end < 27


def test_up_to_the_window_the_ego_is_the_recorded_one_with_all_its_past() -> None:
    (window,) = find_windows(data(), ["scene-9901-cut"])["scene-9901-cut"]
    planner, scene = Watching(speed=3.0), cut_in()
    found = run_episode(staged(scene, DefaultBackend("idm", window=window)), planner)
    motion, start = found.motion, window.start
    assert found.primed == start + 1 and found.window == window
    before = motion.times_us <= scene.timestamps_us[scene.keyframes[start]]
    recorded = interpolate_recorded_poses(scene, motion.times_us[before])
    assert np.allclose(motion.ego[before, :2], recorded[:, :2], atol=1e-6) and before.sum() > start
    assert planner.seen[start].past_valid.all() and planner.seen[start].index == start
    assert motion.ego[-1, 3] < 4.0


def test_the_adversary_keeps_its_track_and_the_others_answer() -> None:
    (window,) = find_windows(data(), ["scene-9901-cut"])["scene-9901-cut"]
    scene = cut_in()
    found = run_episode(staged(scene, DefaultBackend("idm", until="fault", window=window)), Watching(speed=4.0))
    frames = np.searchsorted(scene.timestamps_us, found.motion.times_us)
    exact = scene.timestamps_us[np.minimum(frames, len(scene.timestamps_us) - 1)] == found.motion.times_us
    went, meant = found.motion.position[0, exact, :2], scene.agents.position[0, frames[exact], :2]
    assert np.allclose(went, meant, atol=1e-3)
    # The car behind would run into the slower ego; without a window idm drives the adversary too.
    assert found.touch is None or found.touch.agent == 0
    assert found.motion.position[1, -1, 0] < scene.agents.position[1, frames[-1], 0] - 1.0
    old = run_episode(staged(scene, DefaultBackend("idm", until="fault")), Watching(speed=4.0))
    assert abs(old.motion.position[0, -1, 0] - found.motion.position[0, -1, 0]) > 1.0


def test_the_recording_is_driven_in_the_same_windows() -> None:
    own = find_windows(data(), ["scene-9901-cut"])
    moved = transfer_windows(own, data(), RECORDED, ("scene-9901",))
    (window,) = moved["scene-9901"]
    assert replace(window, adversaries=("made-0",)) == own["scene-9901-cut"][0]
    assert window.adversaries == recording().agents.ids[:1]
    other = FakeData({"scene-1": replace(recording(), name="scene-1")})
    with pytest.raises(InputError, match="is a recording that the adversarial scenes"):
        transfer_windows(own, data(), other, ("scene-1",))
    with pytest.raises(InputError, match="too few for the window"):
        transfer_windows(own, data(), FakeData({"scene-9901": recording(8.0)}), ("scene-9901",))


def sides(made: Callable[[], Made], **changes: Any) -> list[tuple[str, DriveSettings, Callable[[], FakeData]]]:
    """Split, settings and data of both sides."""
    adversarial = settings(**changes)
    unchanged = api.follow_windows(adversarial, "adv", made(), RECORDED, "val")
    return [("val", unchanged, unchanged_data), ("adv", adversarial, made)]


def both(
    out: Path, planner: Planner | PlannerFactory | None = None, made: Callable[[], Made] = data, **changes: Any
) -> list[DriveRecord]:
    planner = planner or Straight()
    return [
        drive_split(source(), split, planner, out, how, reopen=source) for split, how, source in sides(made, **changes)
    ]


def test_records_of_windows_say_so_and_are_compared_in_pairs(tmp_path: Path) -> None:
    plain, made = both(tmp_path)
    assert made.facts.measured.world == "default, agents idm (adversary on its track), window encounter"
    assert plain.facts.measured.world == f"{made.facts.measured.world} of adv"
    assert made.directory.parent.name.startswith("default-idm-none-encounter-") and load_drives(made.directory) == made
    (row,), (partner,) = made.rows, plain.rows
    assert row.contact is not None and row.contact.adversary and row.contact.at_fault
    assert partner.window is not None and partner.window.of == row.scene and partner.contact is None
    assert made.summary.columns["with_bystander"].value == 0.0 and len(row.ttc_s) >= 3 and min(filter(None, row.ttc_s))
    (effect,) = collect_drive_effects([plain, made])
    measures = {each.measure: each for each in effect.effects}
    assert (measures["with_adversary"].adversarial, measures["with_adversary"].unchanged) == (1.0, 0.0)
    assert measures["km_per_incident"].unchanged == np.inf and measures["km_per_incident"].difference.value is None
    assert measures["with_adversary"].needed == 5 and effect.unpaired == 0
    names = [table.name for table in drive_tables([plain, made])]
    assert names[-1] == "drives-paired-adv-default-idm-encounter" and len(names) == 3
    assert len(drive_tables([made])) == 1


def test_a_drive_in_a_window_is_repeated_and_scored_anew(tmp_path: Path) -> None:
    plain, made = both(tmp_path)
    for record, source in ((plain, RECORDED), (made, data())):
        (row,) = record.rows
        assert EpisodeRow.model_validate_json(row.model_dump_json()) == row
        assert redrive_and_score(DefaultBackend("idm"), source.scene(row.scene), source, row) == row
        before = bytes_below(record.directory)
        assert rescore_drives(record.directory, source) == record and bytes_below(record.directory) == before
    assert row.window is not None
    spoilt = replace(row.window, end=99)
    with pytest.raises(InputError, match=r"the window of .* does not fit"):
        redrive_and_score(
            DefaultBackend("idm"), data().scene(row.scene), data(), row.model_copy(update={"window": spoilt})
        )


def test_both_sides_are_the_same_bytes_with_any_number_of_processes_and_in_shards(tmp_path: Path) -> None:
    for workers in (1, 2):
        both(tmp_path / str(workers), Factory(), two_variants, executor=LocalProcesses(workers), together=2)
    for number in (2, 1):
        for split, how, source in sides(two_variants):
            drive_shard(source(), split, [Factory()], tmp_path / "cut", how, Shard(number, 2), reopen=source)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("cut/**/drives/*")}
    assert len(kept) == 4 and not [*tmp_path.glob("cut/**/drive.json")]
    plain, made = both(tmp_path / "cut", Factory(), two_variants)
    assert all(path.stat().st_mtime_ns == at for path, at in kept.items())
    assert bytes_below(tmp_path / "1") == bytes_below(tmp_path / "2") == bytes_below(tmp_path / "cut")
    assert len(plain.rows) == len(made.rows) == 2


def test_nothing_is_driven_twice_but_what_has_another_window(tmp_path: Path) -> None:
    planner = Straight()
    drive_split(data(), "adv", planner, tmp_path / "again", settings())
    calls = planner.calls
    drive_split(data(), "adv", planner, tmp_path / "again", settings())
    assert planner.calls == calls > 0
    drive_split(data(60), "adv", planner, tmp_path / "again", settings())
    assert planner.calls > calls


def test_drives_without_a_window_are_written_as_before(tmp_path: Path) -> None:
    record = drive_split(data(), "adv", Straight(), tmp_path, settings("replay", window=None))
    assert record.directory.parent.name == "default-replay-none"
    text = "".join(path.read_text() for path in record.directory.glob("*.json*"))
    assert not any(f'"{name}"' in text for name in ("window", "windows_of", "ttc_s", "with_bystander"))
    # One that is not adversarial is not driven around anything.
    assert api.drive_settings("val").window is None and api.drive_settings("val").agents == "replay"
    usual = api.drive_settings("adv")
    assert (usual.window, usual.agents) == ("encounter", "idm")
    assert api.drive_settings("adv", agents="replay", window="scene").window is None
    assert api.drive_settings("adv", engine="neuroncap@code").agents == "replay"


@pytest.mark.parametrize(
    ("split", "options", "says"),
    [
        ("val", {}, "is for adversarial scenes"),
        ("adv", {"engine": "neuroncap@code"}, "a start of its own"),
        ("adv", {"agents": "adversary"}, "departs when the drive begins"),
    ],
)
def test_windows_that_there_are_not_are_refused(split: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        api.drive_settings(split, window="encounter", **options)
