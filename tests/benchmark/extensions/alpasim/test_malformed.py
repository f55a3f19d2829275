"""A sample of spoiled messages, to our server and to our client; `python -m bench.messages` sends a thousand."""

import random

import numpy as np

from benchmark.extensions.alpasim.answers import EgodriverAnswerError, read_answer
from benchmark.extensions.alpasim.messages import METHODS, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import encode_trajectory
from benchmark.extensions.alpasim.session import EgodriverService
from benchmark.extensions.alpasim.sessions import MOST_SESSIONS, CallRefusedError
from benchmark.untrusted.files import GRPC_MESSAGE, GRPC_PICTURE
from tests.benchmark.closed_loop.seeing import Looking
from tests.benchmark.extensions.alpasim.made import straight
from tests.benchmark.extensions.alpasim.malformed import UUID, malformed, sound_requests, spoil

CODES = (
    *("INVALID_ARGUMENT", "NOT_FOUND", "ALREADY_EXISTS", "FAILED_PRECONDITION"),
    *("INTERNAL", "RESOURCE_EXHAUSTED"),
)


def test_sound_requests_are_answered() -> None:
    service = EgodriverService(Looking, cameras={}, wants_images=True)
    answers = {path: service.call(path, data, {}) for path, data in sound_requests()}
    drive = decode_message("DriveResponse", answers["/egodriver.EgodriverService/drive"], GRPC_MESSAGE)
    assert len(drive.trajectory.poses) == 7


def test_spoiled_requests_are_answered_or_refused_and_the_next_session_is_sound() -> None:
    refused = 0
    service = EgodriverService(Looking, cameras={}, wants_images=True)
    for path, data in malformed(60, seed=1):
        try:
            decode_message(METHODS[path][1], service.call(path, data, {}), GRPC_PICTURE)
        except CallRefusedError as error:
            refused += 1
            assert str(error) and error.code in CODES, error
        assert len(service._sessions) <= MOST_SESSIONS
    assert refused > 20
    service._sessions.close(UUID)
    for path, data in sound_requests():
        service.call(path, data, {})


def test_spoiled_answers_are_plans_or_failures() -> None:
    draw, now = random.Random(2), straight(1)
    sound = encode_message(build_message("DriveResponse", trajectory=encode_trajectory(straight(40))))
    plan, _ = read_answer(decode_message("DriveResponse", sound, GRPC_MESSAGE), now)
    assert len(plan.waypoints) == 7
    taken = 0
    for _ in range(200):
        try:
            answer = decode_message("DriveResponse", spoil(sound, draw), GRPC_MESSAGE)
        except ValueError:
            continue
        try:
            plan, _ = read_answer(answer, now)
        except EgodriverAnswerError:
            continue
        taken += 1
        assert np.isfinite(plan.waypoints).all()
    assert taken < 150
