"""Client and server as a pair: drives and evaluations over sockets are those of this process."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from adapters.registry import build_planner, planner_factory
from benchmark.closed_loop.default_engine import DefaultBackend, compute_rear_axle_waypoints
from benchmark.closed_loop.episodes import Episode, run_episode
from benchmark.closed_loop.simulation_state import SimulatorBackend
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.extensions.http.model import http_planner
from benchmark.extensions.http.values import HttpImageFormat
from benchmark.extensions.neuroncap.simulation_state import NeuroncapBackend
from benchmark.machine.workers import LocalProcesses
from benchmark.planning import CameraView, Planner
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches
from benchmark.runs.driving import DriveSettings, drive_split
from generation.render.sensor import SchematicSensor
from tests.benchmark.closed_loop.seeing import Looking, Painted, picture, small_cameras
from tests.benchmark.closed_loop.staged import staged
from tests.benchmark.extensions.http.made import Reply, free_port, scripted, serving
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.hand_made import Car, scene_on_straight_road

NEURONCAP = NeuroncapBackend(NeuroncapSwitches.named("neuroncap@code"))
SETTINGS = DriveSettings("default", DefaultBackend(), sensor=Painted())


def fingerprint_of(found: Episode) -> list[Any]:
    motion = [getattr(found.motion, name).tobytes() for name in ("ego", "position", "yaw", "present", "times_us")]
    plans = [plan.waypoints.tobytes() for plan in found.plans]
    return [motion, plans, found.commands, found.stations, found.end, found.touch and found.touch.time_us]


@pytest.mark.path
@pytest.mark.parametrize(
    ("make", "form", "maker"),
    [
        (Looking, HttpImageFormat.TORCH, DefaultBackend()),
        (Looking, HttpImageFormat.PNG, NEURONCAP),
        (partial(build_planner, "ego-status"), HttpImageFormat.PNG, DefaultBackend()),
    ],
)
def test_a_drive_over_sockets_is_the_drive_of_this_process(
    make: Callable[[], Planner], form: HttpImageFormat, maker: SimulatorBackend
) -> None:
    scene = scene_on_straight_road((Car(85.0, 198.25, 2.0),), ego_speed=8.0, seconds=7.0)
    stage = replace(staged(scene, maker), sensor=Painted())
    here = run_episode(stage, make())
    with serving(make()) as url:
        there = run_episode(stage, http_planner(url, image_format=form))
    assert there.failure is None and len(there.plans) > 6
    assert fingerprint_of(there) == fingerprint_of(here)


@pytest.mark.parametrize("name", ["uniad-mini", "sparsedrive-mini"])
def test_the_first_plan_of_a_miniature_is_the_same_within_a_millimetre(name: str) -> None:
    scene = scene_on_straight_road(seconds=3.0)
    scene = replace(scene, cameras=tuple(camera.resized(448, 256) for camera in scene.cameras))
    stage = replace(staged(scene, timeout_s=120.0), sensor=SchematicSensor("first"), most_plans=1)
    built = build_planner(name)
    here = run_episode(stage, built)
    with serving(built) as url:
        there = run_episode(stage, http_planner(url))
    wanted = compute_rear_axle_waypoints(here.plans[0], float(scene.lidar.translation[0]))
    assert there.failure is None
    assert np.abs(there.plans[0].waypoints - wanted).max() < 1e-3


def driven(out: Path, url: str, settings: DriveSettings = SETTINGS) -> DriveRecord:
    return drive_split(town_of_two(slow_leader=True), "val", http_planner(f"served={url}"), out, settings)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> DriveRecord:
    with serving(Looking()) as url:
        return driven(tmp_path_factory.mktemp("undisturbed"), url)


def test_a_split_is_driven_and_the_record_says_where(undisturbed: DriveRecord, tmp_path: Path) -> None:
    here = drive_split(town_of_two(slow_leader=True), "val", Looking(), tmp_path, SETTINGS)
    assert undisturbed.rows == here.rows and undisturbed.planner == "served"
    assert undisturbed.facts.planner.settings == {"image_format": "torch"}


@dataclass
class Relay:
    """Hands requests on to a planner's server; hangs up on bad ones by number, before or after they are handed on."""

    onward: str
    bad: set[int]
    after: bool = False
    count: int = 0

    def __call__(self, path: str, body: bytes) -> Reply:
        number, self.count = self.count, self.count + 1
        if number in self.bad and not self.after:
            return None
        method = "GET" if path == "/alive" else "POST"
        with httpx2.Client(trust_env=False, verify=False, timeout=20.0) as client:
            reply = client.request(method, self.onward + path, content=body)
        return None if number in self.bad else (reply.status_code, reply.content)


@pytest.mark.parametrize(("bad", "after"), [({0, 5, 9, 20}, False), ({3, 17, 18, 19}, True)])
def test_a_scene_whose_server_goes_away_begins_again_at_reset(
    bad: set[int], after: bool, undisturbed: DriveRecord, tmp_path: Path
) -> None:
    with serving(Looking()) as url, scripted(Relay(url, bad, after)) as between:
        record = driven(tmp_path, between.url)
    assert record.rows == undisturbed.rows and record.complete
    for number, path in enumerate(between.paths):
        if number in bad:
            # It waits until somebody is there, then begins the scene again: nothing is asked twice.
            following = [each for each in between.paths[number + 1 :] if each != "/alive"]
            assert following[0] == "/reset", (number, path)


def test_a_server_that_stays_away_ends_the_command_and_the_same_command_goes_on(
    undisturbed: DriveRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmark.extensions.http.model.RETURN_S", 0.3)
    first = len(undisturbed.rows[0].plans)
    with (
        serving(Looking()) as url,
        scripted(Relay(url, set(range(first + 5, 1000)))) as between,
        pytest.raises(InputError, match="the model server at"),
    ):
        driven(tmp_path, between.url)
    kept = [path.name for path in tmp_path.rglob("drives/*.json")]
    assert kept == ["scene-9901-0.json"] and not list(tmp_path.rglob("drive.json"))
    with serving(Looking()) as url, scripted(Relay(url, set())) as between:
        record = driven(tmp_path, between.url)
    assert record.rows == undisturbed.rows and between.paths.count("/reset") == 1
    assert load_drives(record.directory) == record


def test_a_server_that_dies_of_a_scene_is_not_tried_for_ever(tmp_path: Path) -> None:
    def dies(path: str, body: bytes) -> Reply:
        return None if path == "/infer" else (200, b"true")

    with scripted(dies) as server, pytest.raises(InputError, match="hung up before answering /infer"):
        driven(tmp_path, server.url)
    assert server.paths.count("/infer") == 6 and not list(tmp_path.rglob("drives/*.json"))


def test_several_processes_would_mix_scenes_and_one_drives(undisturbed: DriveRecord, tmp_path: Path) -> None:
    with serving(Looking()) as url:
        settings = replace(SETTINGS, executor=LocalProcesses(2))
        record = drive_split(town_of_two(slow_leader=True), "val", planner_factory(f"served={url}"), tmp_path, settings)
    assert record.rows == undisturbed.rows


def pictured() -> FakeData:
    views = {
        camera.name: CameraView(camera, Path(camera.name), 0, np.eye(4), partial(picture, 1))
        for camera in small_cameras()
    }
    return FakeData(town_of_two().scenes, views=views)


def test_an_evaluation_over_sockets_has_the_verdicts_of_this_process_and_goes_on_after_its_server_went_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = evaluate(pictured(), "val", Looking(), tmp_path / "here")
    monkeypatch.setattr("benchmark.extensions.http.model.RETURN_S", 0.3)
    with serving(Looking()) as url, scripted(Relay(url, {4, 25})) as between:
        there = evaluate(pictured(), "val", http_planner(f"m={between.url}"), tmp_path / "there")
    assert there.rows == here.rows and there.run.status == "complete"
    with (
        serving(Looking()) as url,
        scripted(Relay(url, set(range(20, 999)))) as between,
        pytest.raises(InputError, match="the model server"),
    ):
        evaluate(pictured(), "val", http_planner(f"m={between.url}"), tmp_path / "cut")
    with serving(Looking()) as url:
        again = evaluate(pictured(), "val", http_planner(f"m={url}"), tmp_path / "cut")
    assert again.rows == here.rows


@pytest.mark.slow
def test_a_killed_server_that_is_started_again(tmp_path: Path) -> None:
    port, killed = free_port(), threading.Event()
    command = [sys.executable, "-m", "benchmark", "serve", "--model", "constant-velocity", "--port", str(port)]
    started = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)]

    @dataclass(frozen=True)
    class Killing(Painted):
        """Ends the server's process at the tenth instant, as nobody can end a process politely."""

        def views(self, driven: Any) -> dict[str, CameraView]:
            if len(driven.keyframes) == 10 and not killed.is_set():
                killed.set()
                started[0].kill()
                started[0].wait()
                started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            return super().views(driven)

    try:
        one = http_planner(f"killed=http://127.0.0.1:{port}", image_format="png")
        until = time.monotonic() + 60.0
        while True:
            try:
                one.require_alive()
                break
            except InputError:
                assert time.monotonic() < until
                time.sleep(0.1)
        record = drive_split(town_of_two(), "val", one, tmp_path / "killed", replace(SETTINGS, sensor=Killing()))
    finally:
        for process in started:
            process.kill()
            process.wait()
    here = drive_split(town_of_two(), "val", build_planner("constant-velocity"), tmp_path / "here", SETTINGS)
    assert killed.is_set() and record.rows == here.rows and record.complete
