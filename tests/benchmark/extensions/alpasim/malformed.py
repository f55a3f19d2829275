"""Messages of AlpaSim that are spoiled: cut, flipped, joined, nested, counted wrongly, with odd numbers."""

import random
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmark.constants import CAMERA_NAMES
from benchmark.extensions.alpasim.cameras import encode_camera
from benchmark.extensions.alpasim.messages import EGODRIVER, build_message, encode_message
from benchmark.extensions.alpasim.poses import encode_states, encode_trajectory
from benchmark.untrusted.http_images import encode_picture
from tests.benchmark.closed_loop.seeing import picture, small_cameras
from tests.benchmark.extensions.alpasim.made import straight

UUID = "a"
_ODD = (float("nan"), float("inf"), -1e38, 0.0, 1e-45)


def sound_requests() -> list[tuple[str, bytes]]:
    """Requests of one session, in their order."""
    cameras = {camera.name: camera for camera in small_cameras()}
    declared = [encode_camera(cameras[name], name) for name in CAMERA_NAMES]
    poses, spec = straight(20), {"vehicle": {"available_cameras": declared}}
    states = encode_states(*(np.full((20, 3), value) for value in (5.0, 0.1, 0.0)))
    motion = {"trajectory": encode_trajectory(poses), "dynamic_states": states}
    route = {"waypoints": [{"x": 4.0 * step} for step in range(20)], "timestamp_us": int(poses.times_us[-1])}
    now_us = int(poses.times_us[-1])
    requests: list[tuple[str, str, dict[str, Any]]] = [
        ("get_version", "Empty", {}),
        ("start_session", "DriveSessionRequest", {"session_uuid": UUID, "rollout_spec": spec}),
        *(
            ("submit_image_observation", "RolloutCameraImage", {"session_uuid": UUID, "camera_image": image})
            for number, name in enumerate(CAMERA_NAMES)
            for image in [
                {"logical_id": name, "frame_end_us": now_us, "image_bytes": encode_picture(picture(number), "png")}
            ]
        ),
        ("submit_egomotion_observation", "RolloutEgoTrajectory", {"session_uuid": UUID, **motion}),
        ("submit_route", "RouteRequest", {"session_uuid": UUID, "route": route}),
        ("drive", "DriveRequest", {"session_uuid": UUID, "time_now_us": now_us, "time_query_us": now_us + 100_000}),
        ("close_session", "DriveSessionCloseRequest", {"session_uuid": UUID}),
    ]
    return [(EGODRIVER + name, encode_message(build_message(kind, **fields))) for name, kind, fields in requests]


def spoil(data: bytes, draw: random.Random) -> bytes:
    """The bytes with one to three faults."""
    spoiled = bytearray(data)
    for _ in range(draw.randint(1, 3)):
        place = draw.randrange(len(spoiled) + 1)
        fault = draw.randrange(8)
        if fault == 0:
            del spoiled[place:]
        elif fault == 1 and spoiled:
            spoiled[place % len(spoiled)] ^= 1 << draw.randrange(8)
        elif fault == 2:
            spoiled[place:place] = draw.randbytes(draw.randint(1, 12))
        elif fault == 3:
            spoiled[place : place + 4] = np.float32(draw.choice(_ODD)).tobytes()
        elif fault == 4:
            spoiled[place : place + 8] = b"\xff" * 8
        elif fault == 5:
            spoiled += spoiled[:place]
        elif fault == 6:
            # A length that is far beyond the end.
            spoiled[place:place] = b"\x0a\xff\xff\xff\xff\x0f"
        else:
            spoiled += b"\x1a\x00" * draw.choice((10, 1000, 200_000))
    return bytes(spoiled)


def malformed(count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """So many spoiled requests, each within the sound ones of its session."""
    draw, sound = random.Random(seed), sound_requests()
    for _ in range(count):
        place = draw.randrange(len(sound))
        yield from sound[:place]
        path, data = sound[place]
        yield path, spoil(data, draw) if data else draw.randbytes(draw.randint(1, 40))
        yield from sound[place + 1 :]
