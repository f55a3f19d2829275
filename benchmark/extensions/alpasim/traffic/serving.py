"""A server of traffic that listens, and what is said at the end of each of its sessions."""

import sys

import numpy as np

from benchmark.closed_loop.adversary import AdversaryFactory
from benchmark.datasets.roots import DataSet
from benchmark.extensions.alpasim.server import GrpcServer
from benchmark.extensions.alpasim.traffic.given_maps import find_map_in
from benchmark.extensions.alpasim.traffic.recording import SessionRecorder, SessionWriter
from benchmark.extensions.alpasim.traffic.service import TrafficService, TrafficSettings
from benchmark.extensions.alpasim.traffic.session_log import EGO
from benchmark.extensions.alpasim.traffic.session_scene import estimate_frame
from benchmark.extensions.alpasim.traffic.session_world import SessionWorld
from benchmark.report.words import pluralise
from benchmark.untrusted.files import GRPC_SESSION, to_one_line


def make_traffic_server(
    maker: AdversaryFactory | None,
    host: str,
    port: int,
    *,
    agents: str,
    seed: int,
    adversary: str = "",
    write: SessionWriter | None = None,
    maps: DataSet | None = None,
) -> GrpcServer:
    """A server that listens; arguments are those of `TrafficSettings`, ``write`` keeps sessions that are over.

    Without ``maps``, a data set with the scenes of sessions, roads are estimated.
    """
    find = estimate_frame if maps is None else find_map_in(maps)
    recorder = None if write is None else SessionRecorder(write, _notify)

    def end(world: SessionWorld) -> None:
        _notify(describe_session(world))
        if recorder is not None:
            recorder.record(world)

    service = TrafficService(TrafficSettings(agents, maker, adversary, find, seed), end)

    def close() -> None:
        service.close()
        if recorder is not None:
            recorder.close()

    return GrpcServer(service, host, port, GRPC_SESSION, close)


def _notify(sentence: str) -> None:
    print(to_one_line(sentence, 400), file=sys.stderr, flush=True)


def describe_session(world: SessionWorld) -> str:
    """One line on a session: who challenged, who was touched, and how long plans took."""
    track, names = world.adversary, world.scene.agents.ids
    said = ["nobody could challenge" if track is None else f"{to_one_line(names[track.agent], 60)} challenged"]
    said += [f"{EGO} touched {to_one_line(one, 60)}" for one, other in world.touched if other == EGO]
    among = sum(EGO not in pair for pair in world.touched)
    if among or world.everybody_answers:
        said.append(f"{pluralise(among, 'contact')} among the others")
    if world.planned_s:
        half, most, longest = 1000.0 * np.percentile(world.planned_s, [50, 95, 100])
        said.append(
            f"{pluralise(len(world.planned_s), 'plan')} in {half:.0f} ms (half), {most:.0f} ms (95 %), "
            f"{longest:.0f} ms (longest)"
        )
    return f"session of {to_one_line(world.scene.name, 60)}: {', '.join(said)}"
