"""Recorded traffic sessions of AlpaSim's runtime against our service, and its reactions to bad answers against ours."""

from typing import Any, Final

import numpy as np

from benchmark.extensions.alpasim.messages import METHODS, TRAFFIC, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import SECOND_US, Poses, encode_trajectory
from benchmark.extensions.alpasim.traffic.answers import TrafficAnswerError, find_faults, read_traffic
from benchmark.extensions.alpasim.traffic.service import TrafficService, TrafficSettings
from benchmark.extensions.alpasim.traffic.session_log import EGO, LoggedTrack, read_session
from benchmark.extensions.alpasim.verification import RecordedCall, compare_messages, compare_reactions, read_calls
from benchmark.geometry import Floats
from benchmark.untrusted.files import GRPC_SESSION
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet


def _compare_service(comparison: Comparison, folder: GoldenFolder) -> None:
    """Everybody answered, as in the log up to the hand-over, and nothing of the ego's recorded future in it."""
    for path in folder.named("*.bin.gz"):
        calls = read_calls(path)
        for agents in ("replay", "idm"):
            answers = _play(calls, agents, turned=False)
            _compare_answers(comparison, f"{path.name} {agents}", calls, answers)
            wrong = answers != _play(calls, agents, turned=True)
            comparison.verdicts("answers when the ego's future is another", wrong, where=f"{path.name} {agents}")


def _play(calls: list[RecordedCall], agents: str, *, turned: bool) -> list[bytes]:
    """Our answers to a session; ``turned`` has the ego's recorded places after the hand-over in reverse."""
    service = TrafficService(TrafficSettings(agents))
    return [service.call(call.path, _turn(call) if turned else call.request, {}) for call in calls]


def _turn(call: RecordedCall) -> bytes:
    if not call.path.endswith("start_session"):
        return call.request
    request = decode_message("TrafficSessionRequest", call.request, GRPC_SESSION)
    (ego,) = (track for track in request.logged_object_trajectories if track.object_id == EGO)
    later = [pose for pose in ego.trajectory.poses if pose.timestamp_us > request.handover_time_us]
    places = [build_message("Pose") for _ in later]
    for place, pose in zip(places, later):
        place.CopyFrom(pose.pose)
    for place, pose in zip(reversed(places), later):
        pose.pose.CopyFrom(place)
    return encode_message(request)


def _compare_answers(comparison: Comparison, where: str, calls: list[RecordedCall], answers: list[bytes]) -> None:
    tracks: tuple[LoggedTrack, ...] = ()
    handover_us, last_us, before = 0, 0, dict[str, Floats]()
    for call, answer in zip(calls, answers, strict=True):
        request = decode_message(METHODS[call.path][0], call.request, GRPC_SESSION)
        if call.path == TRAFFIC + "start_session":
            log = read_session(request)
            tracks, handover_us, last_us = log.others, log.handover_us, log.first_us
        if call.path != TRAFFIC + "simulate":
            continue
        query_us = request.time_query_us
        told = decode_message("TrafficReturn", answer, GRPC_SESSION)
        faults, before = find_faults(told, query_us, tracks, before, (query_us - last_us) / SECOND_US)
        comparison.verdicts("answers of our traffic", bool(faults), where=f"{where} {query_us} {faults}")
        last_us = query_us
        if query_us <= handover_us:
            logged = {track.uuid: track.at(query_us)[0] for track in tracks if track.covers(query_us)}
            wrong = before.keys() != logged.keys() or any((before[name] != logged[name]).any() for name in logged)
            comparison.verdicts("the log up to the hand-over", wrong, where=f"{where} {query_us}")


_QUERY_US: Final = 2_300_000
_TAKEN: Final = {
    "as it is": 2, "EGO in the answer": 2, "one object twice": 2, "query bracketed": 2, "jump of 30 m": 2,
    "empty answer": 0, "gone 2.0-2.5 s, then back": 0, "empty trajectory": 0, "pose only after the query": 0,
    "pose only before the query": 0,
}  # fmt: skip
"""How many of two road users are there then."""
_REFUSED: Final = {
    "unknown object": "unknown object", "unsorted": "times not rising", "quaternion zero": "quaternion not unit",
    "quaternion 1.1": "quaternion not unit", "NaN position": "NaN",
}  # fmt: skip


def _compare_bad_traffic(comparison: Comparison, folder: GoldenFolder) -> None:
    """Answers that are not as they should be: our client counts who is there as AlpaSim's runtime does."""
    for name, told in folder.facts("bad_traffic.json", gaps=True).items():
        if name not in _TAKEN and name not in _REFUSED:
            continue
        refused, found = "", {}
        try:
            found = read_traffic(_spoil(name), _QUERY_US, ("car", "parked"))
        except TrafficAnswerError as error:
            refused = str(error)
        runs_on = told["outcome"] == "runs on"
        present = [told[who]["at_2.3s"] is not None for who in ("car", "parked")] if runs_on else []
        wrong = not refused.startswith(_REFUSED.get(name, "")) or bool(refused) != (name in _REFUSED)
        wrong |= name in _TAKEN and not (runs_on and len(found) == sum(present) == _TAKEN[name])
        comparison.verdicts("reactions to bad traffic", wrong, where=name)


def _spoil(name: str) -> Any:
    """An answer of two road users at `_QUERY_US`, with the fault of that name."""
    times = np.array([_QUERY_US, _QUERY_US + 100_000])
    position, rotation = np.tile([36.5, 0.0, 0.8], (2, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    shift = {"pose only after the query": 50_000, "pose only before the query": -200_000, "query bracketed": -50_000}
    times += shift.get(name, 0)
    position[:, 0] += 30.0 * (name == "jump of 30 m")
    if name == "unsorted":
        times = times[::-1]
    elif name == "NaN position":
        position[0] = np.nan
    elif name.startswith("quaternion"):
        rotation *= float(name.split()[1].replace("zero", "0"))
    poses = Poses(times, position, rotation)
    trajectory = build_message("Trajectory") if name == "empty trajectory" else encode_trajectory(poses)
    names = [] if name == "empty answer" or name.startswith("gone") else ["car", "parked"]
    more = {"unknown object": "nobody", "EGO in the answer": EGO, "one object twice": "car"}
    names += [more[name]] if name in more else []
    updates = [{"object_id": who, "trajectory": trajectory} for who in names]
    return build_message("TrafficReturn", object_trajectory_updates=updates)


SESSIONS: Final = GoldenSet(
    name="alpasim traffic",
    files=("*.bin.gz", "*.jsonl.gz"),
    compare=(compare_messages, _compare_service),
    usual="traffic",
    holds="recorded sessions of AlpaSim's traffic",
)
REACTIONS: Final = GoldenSet(
    name="alpasim reactions",
    files=("bad_driver.json", "bad_traffic.json"),
    compare=(compare_reactions, _compare_bad_traffic),
    usual="reactions",
    holds="reactions of AlpaSim's runtime",
)
