"""``serve --protocol alpasim``, and ``drive`` and ``eval`` with policies at ``grpc://``, as a user runs them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import benchmark
from adapters.planners.constant_velocity import ConstantVelocity
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.extensions.alpasim.messages import build_message
from benchmark.extensions.alpasim.server import GrpcServer
from benchmark.records.drives import load_drives
from benchmark.runs.redriving import redrive_and_score
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.closed_loop.seeing import small_scene
from tests.benchmark.extensions.alpasim.made import Scripted, ahead, scripted, serving
from tests.generation.nuscenes_writer.written_roots import write_root


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene on disk with small pictures."""
    root = tmp_path_factory.mktemp("data") / "road"
    write_root(root, [small_scene()], version="v1.0-mini", frames="keyframes")
    return root


def drive(source: Path, out: Path, *options: Any) -> Any:
    same = ("--data", source, "--split", "val", "--out", out, "--no-baselines", "--sensor", "schematic")
    return run_here("drive", *same, "--workers", "2", "--json", *options)


def test_two_policies_are_kept_apart_by_their_names_and_a_drive_is_kept(source: Path, tmp_path: Path) -> None:
    with serving(ConstantVelocity) as one, scripted() as other:
        named = ("--model", f"one={one.url}", "--model", f"other={other.url}", "--remote-cameras", "CAM_FRONT=front")
        done = drive(source, tmp_path, *named)
        asked = len(other.asked)
        again = drive(source, tmp_path, *named)
        assert len([name for name, _ in other.asked[asked:] if name != "get_version"]) == 0
    assert done.code == again.code == 0, done.err
    rows = json.loads(done.out)
    assert [row["planner"] for row in rows] == ["one", "other"] and not any(row["failed"] for row in rows)
    settings = json.loads((Path(rows[0]["directory"]) / "drive.json").read_text())["planner"]["settings"]
    assert settings == {"cameras": {"CAM_FRONT": "front"}, "image_format": "jpeg", "route": "recorded path"}
    (row,) = load_drives(Path(rows[0]["directory"])).rows
    assert row.notes == ["1.5 s: began with 1.0 s of recorded motion, not 1.7 s"]
    assert "front" in {message.camera_image.logical_id for message in other.of("submit_image_observation")}


def test_plans_at_ten_hertz_are_another_table_and_can_be_scored_again(source: Path, tmp_path: Path) -> None:
    with serving(ConstantVelocity) as server:
        usual = drive(source, tmp_path, "--model", f"mine={server.url}")
        often = drive(source, tmp_path, "--model", f"mine={server.url}", "--plan-hz", "10")
    ((slow,), (fast,)) = json.loads(usual.out), json.loads(often.out)
    assert fast["measured"]["plan_hz"] == 10 and "plan_hz" not in slow["measured"]
    assert fast["directory"] != slow["directory"]
    (row,) = load_drives(Path(fast["directory"])).rows
    assert [len(plans) for plans in row.between[2:-1]] == [4] * (len(row.plans) - 3)
    data = benchmark.open_data(source)
    assert redrive_and_score(DefaultBackend(), data.scene(row.scene), data, row) == row


def test_an_evaluation_asks_at_key_frames_and_notes_what_was_peculiar(source: Path, tmp_path: Path) -> None:
    def short(log: Scripted, request: Any) -> Any:
        return ahead(log, request, seconds=2.0)

    with scripted(drive=short) as policy:
        done = run_here(
            "eval", "--data", source, "--split", "val", "--out", tmp_path, "--model", f"mine={policy.url}", "--json"
        )
    assert done.code == 0, done.err
    (row,) = json.loads(done.out)
    assert row["failed"] == 0 and len(policy.of("drive")) == row["samples"]
    (samples,) = tmp_path.rglob("samples.jsonl")
    notes = [json.loads(line).get("note") for line in samples.read_text().splitlines()]
    assert notes == ["ends after 2.0 s, last pose held"] * row["samples"]
    assert policy.asked[-1][0] == "close_session"
    steps = np.diff([request.time_now_us for request in policy.of("drive")])
    assert (np.abs(steps - 500_000) < 60_000).all()


def test_a_policy_that_ends_the_drive_has_a_score(source: Path, tmp_path: Path) -> None:
    def answer(log: Scripted, request: Any) -> Any:
        made = ahead(log, request)
        made.terminate_session = len(log.of("drive")) == 5
        return made

    with scripted(drive=answer) as policy:
        done = drive(source, tmp_path, "--model", f"mine={policy.url}")
    assert done.code == 0, done.err
    (told,) = json.loads(done.out)
    (row,) = load_drives(Path(told["directory"])).rows
    assert row.terminated and row.status == "ok" and len(row.plans) == 4 and "terminate_session" in row.notes[-1]


def test_a_failed_policy_is_no_zero_and_says_why(source: Path, tmp_path: Path) -> None:
    with scripted(drive=lambda log, request: build_message("DriveResponse")) as policy:
        done = drive(source, tmp_path, "--model", f"mine={policy.url}")
    (told,) = json.loads(done.out)
    assert done.code == 1 and told["failed"] == 1
    (row,) = load_drives(Path(told["directory"])).rows
    assert row.failure is not None and "empty: the trajectory has no poses" in row.failure.text and row.scores is None


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("drive", "--sensor", "schematic", "--model", "a=grpcs://127.0.0.1:1"), "only plain gRPC"),
        (("drive", "--sensor", "schematic", "--model", "a=grpc://127.0.0.1:1", "--frame", "ego"), "--frame"),
        (("drive", "--sensor", "schematic", "--model", "a=grpc://127.0.0.1:1", "--image-format", "torch"), "jpeg or"),
        (("drive", "--model", "a=grpc://127.0.0.1:1"), "--sensor schematic"),
        (("drive", "--model", "stop", "--remote-cameras", "CAM_FRONT=a"), "--remote-cameras is only for"),
        (("drive", "--model", "stop", "--plan-hz", "10", "--engine", "neuroncap@code"), "--engine default"),
        (("serve", "--protocol", "alpasim", "--model", "idm", "--port", "0"), "requests do not carry"),
        (("serve", "--protocol", "alpasim", "--model", "stop", "--accept-torch-tensors"), "only for the protocol"),
        (("serve", "--protocol", "alpasim", "--model", "stop", "--cameras", "CAM_FRONT"), "NAME=OTHER"),
        (("serve", "--protocol", "alpasim", "--model", "a=grpc://127.0.0.1:1"), "is a server already"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(command: tuple[str, ...], says: str, tmp_path: Path) -> None:
    out = () if command[0] == "serve" else ("--out", tmp_path)
    done = run_here(*command, *out)
    assert done.code == 2 and says in done.err and len(done.err.strip().splitlines()) == 1, done.err


def test_serve_listens_where_the_challenge_says(monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[GrpcServer] = []

    def serve(self: GrpcServer) -> None:
        served.append(self)
        self.close()

    monkeypatch.setattr(GrpcServer, "serve", serve)
    monkeypatch.setenv("ALPASIM_DRIVER_HOST", "0.0.0.0")
    monkeypatch.setenv("ALPASIM_DRIVER_PORT", "0")
    monkeypatch.setenv("ALPASIM_CONTESTANT_REPLICA_INDEX", "3")
    monkeypatch.setenv("ALPASIM_CONTESTANT_REPLICAS", "16")
    done = run_here("serve", "--protocol", "alpasim", "--model", "constant-velocity")
    assert done.code == 0 and served[0].host == "0.0.0.0" and served[0].port > 0
    assert (
        "replica 3 of 16" in done.err and "sessions side by side" in done.err and "open to other machines" in done.err
    )
    monkeypatch.setenv("ALPASIM_DRIVER_PORT", "port")
    assert "which is no port" in run_here("serve", "--protocol", "alpasim", "--model", "stop").err
    taken = run_here("serve", "--protocol", "alpasim", "--model", "stop", "--host", "203.0.113.7", "--port", "1")
    assert taken.code == 2 and "choose another --port or --host" in taken.err


def test_a_planner_is_served_from_python() -> None:
    with benchmark.serve_planner("constant-velocity", protocol="alpasim") as server:
        assert server.url.startswith("grpc://127.0.0.1:") and not server.is_open
