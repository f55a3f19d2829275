"""Recorded sessions of AlpaSim's runtime and of ``carla-driver-interface``, against our messages, client and server."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.extensions.alpasim.answers import EgodriverAnswerError, read_answer
from benchmark.extensions.alpasim.messages import (
    EGODRIVER,
    METHODS,
    build_message,
    decode_message,
    encode_message,
)
from benchmark.extensions.alpasim.model import Session
from benchmark.extensions.alpasim.poses import (
    SECOND_US,
    LocalFrame,
    Poses,
    decode_trajectory,
    encode_trajectory,
)
from benchmark.extensions.alpasim.session import EgodriverService
from benchmark.extensions.alpasim.sessions import CallRefusedError
from benchmark.planning import EgoState, Observation, Plan, PlanFrame, Ride, SceneInfo
from benchmark.untrusted.files import GRPC_PICTURE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet, unpack_gzip

_MODEL: Final = "carla"
"""Whose answers to calls out of order ours are: ``errors_carla_...``."""


@dataclass(frozen=True, slots=True)
class RecordedCall:
    """A recorded call: its path, the bytes of request and answer, and the line of text about it."""

    path: str
    request: bytes
    answer: bytes
    told: Mapping[str, Any]

    @property
    def known(self) -> bool:
        """Whether it is of a service that is ours."""
        return self.path in METHODS


def _split(data: bytes) -> Iterator[bytes]:
    """Parts of a file, each behind its length."""
    at = 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if at + 4 + length > len(data):
            raise ValueError("it is cut off")
        yield data[at + 4 : at + 4 + length]
        at += 4 + length


def read_calls(path: Path) -> list[RecordedCall]:
    """The calls of a recorded session, in order."""
    parts = list(_split(unpack_gzip(path)))
    lines = unpack_gzip(path.with_name(path.name.replace(".bin.", ".jsonl."))).splitlines()
    told = [json.loads(line) for line in lines]
    if len(parts) != 2 * len(told):
        raise ValueError(f"{path.name} has {len(parts)} messages of {len(told)} calls")
    return [RecordedCall(call["method"], parts[2 * at], parts[2 * at + 1], call) for at, call in enumerate(told)]


def compare_messages(comparison: Comparison, folder: GoldenFolder) -> None:
    """Each message decoded, encoded to the same bytes, and read as the text beside it says."""
    others = 0
    for path in folder.named("*.bin.gz"):
        for call in read_calls(path):
            others += not call.known
            if not call.known:
                continue
            for data, name, text in zip((call.request, call.answer), METHODS[call.path], ("request", "response")):
                message = decode_message(name, data, GRPC_PICTURE)
                comparison.verdicts("messages, bytes", encode_message(message) != data, where=path.name)
                wrong = not _agrees(message, call.told.get(text) or {})
                comparison.verdicts("messages, values", wrong, where=path.name)
    for path in folder.named("*.asl.gz"):
        for data in _split(unpack_gzip(path)):
            message = decode_message("LogEntry", data, GRPC_PICTURE)
            comparison.verdicts("log entries, bytes", encode_message(message) != data, where=path.name)
    if others:
        comparison.note("messages, bytes", f"{others} calls of services that are not ours are left out")


def _agrees(message: Any, told: Mapping[str, Any]) -> bool:
    """Whether a message has the values of its text, and no others; pictures and enumerations are told otherwise."""
    fields = {descriptor.name: value for descriptor, value in message.ListFields()}
    return fields.keys() == told.keys() and all(_same(fields[name], text) for name, text in told.items())


def _same(value: Any, text: Any) -> bool:
    if hasattr(value, "ListFields"):
        return isinstance(text, Mapping) and _agrees(value, text)
    if isinstance(value, bytes):
        return bool(len(value) == text["bytes"] and value[:8].hex() == text["begins"])
    if isinstance(value, bool | str):
        return bool(value == text)
    if isinstance(text, list):
        return len(value) == len(text) and all(_same(*pair) for pair in zip(value, text))
    if isinstance(value, int):
        return not str(text).isdecimal() or value == int(text)
    # Texts have the shortest decimals of single precision.
    return bool(np.array_equal(np.float32(value), np.float32(text), equal_nan=True))


class _Coasting:
    """Straight ahead as fast as it goes."""

    name = "coasting"

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered."""

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of the rear axle."""
        ahead = 0.5 * np.arange(1, 7) * float(observation.ego.velocity[0])
        return Plan(np.column_stack([ahead, np.zeros(6)]), PlanFrame.EGO)


def _compare_server(comparison: Comparison, folder: GoldenFolder) -> None:
    """Recorded requests fed to our server: well-formed answers, and the errors of calls out of order."""
    for path in folder.named("*.bin.gz"):
        service = EgodriverService(_Coasting, cameras={})
        ordered = "errors" not in path.name
        last: dict[str, Poses] = {}
        for call in sorted(read_calls(path), key=lambda call: int(call.told["call"])):
            if not call.path.startswith(EGODRIVER):
                continue
            code = "OK"
            try:
                answer = decode_message(METHODS[call.path][1], service.call(call.path, call.request, {}), GRPC_PICTURE)
            except CallRefusedError as refused:
                code = refused.code
            expected = call.told["error"][0] if call.told.get("error") else "OK"
            # A policy that crashed on a route of NaN says nothing of its service.
            if (ordered or _MODEL in path.name) and expected != "UNKNOWN":
                comparison.verdicts("codes of our server", code != expected, where=f"{path.name} {call.told['call']}")
            name = call.path.removeprefix(EGODRIVER)
            request = decode_message(METHODS[call.path][0], call.request, GRPC_PICTURE)
            if name == "submit_egomotion_observation" and code == "OK" and len(request.trajectory.poses):
                last[request.session_uuid] = decode_trajectory(request.trajectory).at(slice(-1, None))
            if ordered and name == "drive":
                wrong = not _is_well_formed(answer, request, last[request.session_uuid])
                comparison.verdicts("answers of our server", wrong, where=f"{path.name} {call.told['call']}")


def _is_well_formed(answer: Any, request: Any, now: Poses) -> bool:
    """From the present pose on, times rising, unit quaternions, as far as was asked."""
    told = decode_trajectory(answer.trajectory)
    if len(told) < 2 or not told.are_unit or not np.isfinite(told.position).all():
        return False
    begins = told.times_us[0] == request.time_now_us and np.array_equal(told.position[0], now.position[-1])
    rises = bool((np.diff(told.times_us) > 0).all())
    return bool(begins and rises and told.times_us[-1] >= request.time_query_us)


def _compare_client(comparison: Comparison, folder: GoldenFolder) -> None:
    """What our client sends from the recorded poses: times of drives, egomotion, and routes to the recording's end."""
    for path in folder.named("*.asl.gz"):
        first = decode_message("LogEntry", next(_split(unpack_gzip(path))), GRPC_PICTURE).rollout_metadata
        recorded = decode_trajectory(first.ego_rig_recorded_ground_truth_trajectory)
        calls = read_calls(path.with_name(path.name.replace(".asl.", ".bin.")))
        _compare_rollout(comparison.at(path.name), first, recorded, calls)


def _compare_rollout(comparison: Comparison, metadata: Any, recorded: Poses, calls: list[RecordedCall]) -> None:
    told = {"submit_egomotion_observation": [], "submit_route": [], "drive": []}  # type: dict[str, list[Any]]
    for call in sorted(calls, key=lambda call: int(call.told["call"])):
        name = call.path.removeprefix(EGODRIVER)
        if call.path.startswith(EGODRIVER) and name in told:
            told[name].append(decode_message(METHODS[call.path][0], call.request, GRPC_PICTURE))
    batches = [decode_trajectory(request.trajectory) for request in told["submit_egomotion_observation"]]
    standing = EgoState(np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(2), np.zeros(2), 0.0, None, "derived")
    frame, session = LocalFrame(np.zeros(3), SECOND_US), None
    for number, (request, route) in enumerate(zip(told["drive"], told["submit_route"], strict=True)):
        seen = batches[: number + 1]
        ride = Ride(
            np.concatenate([batch.times_us for batch in seen]),
            np.concatenate([batch.position for batch in seen]),
            np.concatenate([batch.rotation for batch in seen]),
            recorded.position,
            int(recorded.times_us[-1]),
        )
        session = session or Session(ride, frame, 0.0)
        egomotion, ours = (message for _, message in session.observe(ride, standing))
        asked = session.encode_drive(metadata.session_metadata.control_timestep_us)
        times = (request.time_now_us, request.time_query_us, route.route.timestamp_us)
        comparison.numbers(
            "times of drives", (asked.time_now_us, asked.time_query_us, ours.route.timestamp_us), times, 0.0
        )
        sent = decode_trajectory(egomotion.trajectory)
        comparison.verdicts(
            "new poses", encode_trajectory(sent) != told["submit_egomotion_observation"][number].trajectory
        )
        theirs = np.array([[point.x, point.y, point.z] for point in route.route.waypoints]).reshape(-1, 3)
        theirs = theirs[np.isfinite(theirs).all(axis=1)]
        made = np.array([[point.x, point.y, point.z] for point in ours.route.waypoints]).reshape(-1, 3)
        comparison.series("routes, m", made, theirs)


_NOW_US: Final = 10_000_000
_REACTIONS: Final = {
    "empty": "empty", "one_pose_now": "one pose", "starts_late_0.5s": "start off", "starts_0.3s_in_past": "start off",
    "all_in_past": "all in the past", "nan_position": "NaN", "nan_quaternion": "NaN",
    "zero_quaternion": "quaternion not unit", "unnormalised_quaternion": "quaternion not unit",
    "unsorted": "times not rising", "duplicate_times": "times not rising", "ends_before_query": "",
    "reverse_motion": "", "terminate": "", "thirty_cm_apart": "",
}  # fmt: skip
"""The name under which ours refuses an answer; nothing where it is taken. Errors of gRPC have their own."""
_STRICTER: Final = ("nan_position", "starts_0.3s_in_past", "all_in_past")
"""Taken by AlpaSim's runtime, which then rolls, or drives a displaced plan; not by ours."""


def compare_reactions(comparison: Comparison, folder: GoldenFolder) -> None:
    """Answers that are not as they should be: what AlpaSim's runtime fails at, ours does not take."""
    now = Poses(np.array([_NOW_US]), np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    for name, told in folder.facts("bad_driver.json").items():
        if name not in _REACTIONS:
            continue
        refused = ""
        try:
            read_answer(_spoil(name), now)
        except EgodriverAnswerError as error:
            refused = str(error)
        taken = told["outcome"] == "runs on" and name not in _STRICTER
        wrong = bool(refused) is taken or not refused.startswith(_REACTIONS[name])
        comparison.verdicts("reactions to bad answers", wrong, where=name)


def _spoil(name: str) -> Any:
    """An answer at `_NOW_US` of a car at the origin, with the fault of that name."""
    seconds = np.arange(51) / 10
    times = (_NOW_US + seconds * SECOND_US).astype(np.int64)
    position, rotation = np.zeros((51, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (51, 1))
    position[:, 0] = (-1.0 if name == "reverse_motion" else 5.0) * seconds
    shift = {"starts_late_0.5s": 500_000, "starts_0.3s_in_past": -300_000, "all_in_past": -6_000_000}
    times += shift.get(name, 0)
    kept = {"empty": 0, "one_pose_now": 1, "ends_before_query": 2}.get(name, 51)
    if name == "ends_before_query":
        times[1] = times[0] + 50_000
    elif name == "nan_position":
        position[3] = np.nan
    elif name in ("nan_quaternion", "zero_quaternion", "unnormalised_quaternion"):
        rotation[3] = {"nan": np.nan, "zero": 0.0}.get(name.split("_")[0], 2.0 * rotation[3])
    elif name == "unsorted":
        times = times[::-1]
    elif name == "duplicate_times":
        times[1] = times[0]
    elif name == "thirty_cm_apart":
        position[1:, 1] += 0.3
    trajectory = encode_trajectory(Poses(times[:kept], position[:kept], rotation[:kept]))
    return build_message("DriveResponse", trajectory=trajectory, terminate_session=name == "terminate")


SESSIONS: Final = GoldenSet(
    name="alpasim sessions",
    files=("*.bin.gz", "*.jsonl.gz"),
    compare=(compare_messages, _compare_server, _compare_client),
    quantities={"routes, m": 1e-4},
    usual="sessions",
    holds="recorded sessions of AlpaSim",
)
