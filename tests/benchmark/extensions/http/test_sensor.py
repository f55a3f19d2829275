"""A renderer over HTTP: exactly NeuroNCAP's requests, everybody where they are, and what does not fit refused."""

import base64
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import run_episode
from benchmark.errors import InputError
from benchmark.extensions.http.requests import CAMERAS, InferRequest
from benchmark.extensions.http.sensor import (
    HttpSensor,
    MovedActor,
    build_moved_actors,
    encode_image_request,
    encode_moved_actors,
    parse_actors,
)
from benchmark.extensions.http.values import HttpImageFormat, NeuroncapHttpError, encode_image
from benchmark.geometry import transform_matrix
from benchmark.machine.address import Address
from benchmark.planning import PlannerGoneError
from benchmark.scene import Scene
from tests.benchmark.closed_loop.seeing import Looking, picture, small_scene
from tests.benchmark.closed_loop.staged import staged
from tests.benchmark.extensions.http.made import SHARED, Reply, free_port, scripted


@dataclass
class Renderer:
    """A renderer of a scene; its pictures say which camera they are of."""

    scene: Scene
    form: HttpImageFormat = HttpImageFormat.TORCH
    bare: bool = True
    shape: tuple[int, int] = (6, 8)

    def actors(self) -> list[dict[str, Any]]:
        times = self.scene.timestamps_us[self.scene.keyframes].tolist()
        pose = np.eye(4).tolist()
        return [
            {"uuid": name, "poses": [pose] * len(times), "timestamps": times, "dims": [1.9, 4.6, 1.7]}
            for name in self.scene.agents.ids
        ]

    def __call__(self, path: str, body: bytes) -> Reply:
        if path == "/get_actors":
            return 200, json.dumps(self.actors()).encode()
        if path == "/render_image":
            number = CAMERAS.index(json.loads(body)["camera_name"])
            text = encode_image(picture(number, self.shape), self.form).encode()
            return 200, text if self.bare else base64.b64decode(text)
        return 200, b"null" if path == "/update_actors" else b"true"


def sensor(url: str, *, tensors: bool = True) -> HttpSensor:
    return HttpSensor(Address.of(f"drawn={url}", "--sensor"), tensors)


@pytest.mark.parametrize(
    ("form", "bare", "tensors"),
    [(HttpImageFormat.TORCH, True, True), (HttpImageFormat.PNG, False, False), (HttpImageFormat.PNG, True, False)],
)
def test_a_drive_is_shown_by_a_renderer(form: HttpImageFormat, bare: bool, tensors: bool) -> None:
    scene, planner = small_scene(), Looking()
    with scripted(Renderer(scene, form, bare)) as server:
        found = run_episode(replace(staged(scene), sensor=sensor(server.url, tensors=tensors)), planner)
    assert found.failure is None and len(found.plans) > 4
    # No file is behind a picture.
    assert {view.path for view in planner.seen[0].views.values()} == set(map(Path, CAMERAS))
    step = ["/update_actors", *["/render_image"] * 6]
    assert server.paths == ["/get_actors", *step * len(found.plans)]
    for index, seen in enumerate(planner.seen):
        for number, name in enumerate(CAMERAS):
            assert (seen.views[name].load() == picture(number)).all()
            wanted = json.loads(server.asked[2 + 7 * index + number][3])
            more = [] if tensors else ["image_format"]
            assert list(wanted) == ["pose", "timestamp", "camera_name", *more]
            assert (wanted["camera_name"], wanted["timestamp"]) == (name, seen.timestamp_us)
            camera = seen.views[name].camera
            pose = seen.views[name].global_T_ego @ transform_matrix(camera.rotation, camera.translation)
            assert wanted["pose"] == pose.tolist()


def test_everybody_is_put_where_they_are_and_nobodys_future_is_told() -> None:
    scene, planner = small_scene(), Looking()
    with scripted(Renderer(scene)) as server:
        run_episode(replace(staged(scene, DefaultBackend("idm")), sensor=sensor(server.url)), planner)
    bodies = [json.loads(body) for _, path, _, body in server.asked if path == "/update_actors"]
    for seen, actors in zip(planner.seen, bodies, strict=True):
        assert [each["uuid"] for each in actors] == list(scene.agents.ids)
        for each in actors:
            assert list(each) == ["timestamps", "poses", "dims", "uuid", "is_target_actor"]
            assert each["timestamps"][-2:] == [seen.timestamp_us, seen.timestamp_us + 500_000]
            assert np.shape(each["poses"]) == (len(each["timestamps"]), 4, 4)
            assert each["dims"] == [1.9, 4.6, 1.7] and each["is_target_actor"] is False
    now = bodies[-1][1]["poses"]
    # Ten metres a second straight on: half a second further, by the last step and not by what will come.
    assert now[-1][0][3] - now[-2][0][3] == pytest.approx(5.0, abs=0.3)


def test_tracks_are_told_without_gaps_and_by_whoever_is_there() -> None:
    scene = replace(small_scene(), adversaries=(small_scene().agents.ids[0],))
    valid = scene.agents.valid.copy()
    valid[0, :10], valid[1, -1] = False, False
    driven = replace(scene, agents=replace(scene.agents, valid=valid))
    (only,) = build_moved_actors(driven, frozenset(scene.agents.ids), scene.adversaries)
    assert only.uuid == scene.agents.ids[0] and only.is_target
    assert only.timestamps[0] == scene.timestamps_us[10] and len(only.timestamps) == len(scene.timestamps_us) - 10 + 1
    one = replace(driven, timestamps_us=scene.timestamps_us[:1], agents=replace(
        scene.agents, valid=valid[:, :1] | True, position=scene.agents.position[:, :1], yaw=scene.agents.yaw[:, :1]
    ))  # fmt: skip
    first = build_moved_actors(one, frozenset(scene.agents.ids), ())[0]
    assert len(first.timestamps) == 2 and (first.poses[0] == first.poses[1]).all()
    assert build_moved_actors(driven, frozenset(), ()) == []


def first(**values: Any) -> Callable[[list[dict[str, Any]]], Any]:
    return lambda actors: [{**actors[0], **values}, *actors[1:]]


NOT_ACTORS: dict[str, tuple[Callable[[list[dict[str, Any]]], Any], str]] = {
    "another scene": (first(uuid="stranger"), "stranger.*--scenes"),
    "another time": (lambda actors: first(timestamps=[1] * len(actors[0]["timestamps"]))(actors), "outside scene"),
    "no list": (lambda actors: {"actors": actors}, "not a list"),
    "poses of another shape": (first(poses=[[0.0] * 16]), "4 x 4"),
    "NaN": (first(dims=[float("nan"), 1, 1]), "NaN"),
    "nobody of a name": (first(uuid=""), "not a string"),
    "times with points": (first(timestamps=[1.5]), "whole microseconds"),
}
NOT_PICTURES: dict[str, tuple[str, Reply, str]] = {
    "a route less": ("/", (404, b"Not Found"), "/get_actors with status 404"),
    "a web page": ("/", (200, b"<html></html>"), "a web page"),
    "nothing": ("/", None, "hung up before answering"),
    "a failure": ("/render", (500, b"out of memory"), "/render_image with status 500: out of memory"),
    "no picture": ("/render", (200, b"hello"), "not base64"),
}
WRONG = (*NOT_ACTORS, *NOT_PICTURES, "another size")


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_ends_the_command_and_is_nobodys_failure(name: str) -> None:
    scene = small_scene()
    good = Renderer(scene, shape=(3, 4) if name == "another size" else (6, 8))
    change, of_actors = NOT_ACTORS.get(name, (None, ""))
    path_wrong, reply, of_paths = NOT_PICTURES.get(name, ("none", None, ""))

    def answer(path: str, body: bytes) -> Reply:
        if path == "/get_actors" and change is not None:
            return 200, json.dumps(change(good.actors())).encode()
        return reply if path.startswith(path_wrong) else good(path, body)

    says = of_actors or of_paths or "4 x 3 pixels, but the calibration is for 8 x 6"
    with scripted(answer) as server, pytest.raises(InputError, match=says) as refused:
        run_episode(replace(staged(scene), sensor=sensor(server.url)), Looking())
    assert server.url in str(refused.value) and not isinstance(refused.value, PlannerGoneError)


def test_what_a_renderer_cannot_show_or_send_is_refused() -> None:
    scene = small_scene()
    with scripted(Renderer(scene)) as server:
        with pytest.raises(InputError, match="has no CAM_FRONT"):
            sensor(server.url).look(replace(scene, cameras=()))
        assert server.asked == []
        with pytest.raises(InputError, match="--accept-torch-tensors if you trust it"):
            run_episode(replace(staged(scene), sensor=sensor(server.url, tensors=False)), Looking())
    for body in (b"", b"[", b"[1]", b'[{"uuid": "a"}]', b"null"):
        with pytest.raises(NeuroncapHttpError):
            parse_actors(body)
    known = Renderer(replace(scene, agents=replace(scene.agents, ids=scene.agents.ids[:1])))
    threatened = replace(scene, adversaries=(scene.agents.ids[1],))
    with scripted(known) as server, pytest.raises(InputError, match="the adversary of scene"):
        sensor(server.url).look(threatened)
    with scripted(known) as server:
        assert sensor(server.url).look(scene).cameras == tuple(
            next(camera for camera in scene.cameras if camera.name == name) for name in CAMERAS
        )


def test_what_was_measured_names_the_renderer() -> None:
    plain = HttpSensor(Address.of("http://127.0.0.1:8000", "--sensor"))
    assert plain.name == "127.0.0.1:8000"
    assert plain.facts == {"protocol": "neuroncap", "image_format": "png", "address": "http://127.0.0.1:8000"}
    assert "address" not in sensor("http://127.0.0.1:8000").facts
    with pytest.raises(InputError, match="nobody answers"):
        sensor(f"http://127.0.0.1:{free_port()}").require_alive()


@pytest.mark.skipif(not SHARED.exists(), reason="the recorded sessions are not here")
@pytest.mark.parametrize("name", ["session_plain", "session_with_objects_and_dim_jitter"])
def test_recorded_requests_to_a_renderer_are_written_again_to_the_byte(name: str) -> None:
    exchanges = json.loads((SHARED / f"{name}.json").read_text())["exchanges"]
    infer = next(each for each in exchanges if each["path"] == "/infer")
    request = InferRequest.read(infer["request_body"].encode())
    wanted = [each for each in exchanges[: infer["order"]] if each["path"] == "/render_image"]
    assert len(wanted) == 6
    for camera, each in zip(CAMERAS, wanted, strict=True):
        pose = np.array(json.loads(each["request_body"])["pose"])
        assert encode_image_request(pose, request.timestamp, camera).decode() == each["request_body"]
        # The product itself differs in its last digits from library to library.
        np.testing.assert_allclose(request.ego2world @ request.camera2ego[camera], pose, rtol=1e-13, atol=1e-13)
    actors = parse_actors(next(each for each in exchanges if each["path"] == "/get_actors")["response_body"].encode())
    assert len(actors) == 3 and all(len(actor.poses) == len(actor.timestamps) for actor in actors)
    update = next(each for each in exchanges if each["path"] == "/update_actors")
    told = []
    for each in json.loads(update["request_body"]):
        times, poses, dims = (np.array(each[name]) for name in ("timestamps", "poses", "dims"))
        told.append(MovedActor(times, poses, dims, each["uuid"], each["is_target_actor"]))
    assert encode_moved_actors(told).decode() == update["request_body"]
