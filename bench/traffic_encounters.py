"""Encounters over gRPC beside replayed traffic: ``python -m bench.traffic_encounters [--seeds N] [--limit N]``.

Recordings of the embedded town, seeds and two egos, each driven among replayed traffic and against the served adversary
without a map; with the first seed also against the adversary in process, which knows motion only too but has the map. A
careful human drives all of them as well. ``--seeds 17`` are 1,000 encounters; ``--no-socket`` hands the same bytes to
the service without a network between.
"""

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import benchmark
from adapters.registry import build_planner
from benchmark.api.serving import TRAFFIC_BUDGETS
from benchmark.closed_loop.adversary import AdversaryTrack, ScriptedTracks
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, EpisodeSpec, run_episode
from benchmark.closed_loop.observation_builder import NoSensor
from benchmark.closed_loop.reference_drivers import simulate_reference_drivers
from benchmark.extensions.alpasim.messages import METHODS, TRAFFIC, decode_message, encode_message
from benchmark.extensions.alpasim.server import GrpcServer
from benchmark.extensions.alpasim.traffic.client import RemoteTraffic, build_remote_traffic
from benchmark.extensions.alpasim.traffic.service import TrafficService, TrafficSettings
from benchmark.extensions.alpasim.traffic.session_log import EGO
from benchmark.extensions.alpasim.traffic.session_world import SessionWorld
from benchmark.geometry import box_corners
from benchmark.interactions.reaction import Driver
from benchmark.machine.extension import import_from_extension
from benchmark.runs.redriving import read_recorded_can
from benchmark.scene import Scene
from benchmark.untrusted.files import GRPC_SESSION

_LEFT_M = 0.5
EGOS = ("constant-velocity-on-path", "idm")


@dataclass(frozen=True)
class Encounter:
    """One drive: who was hit by whom, whether the careful human survives, where the adversary was.

    ``fair`` is of those in which the adversary was touched: whether a careful human in the ego's place, from the same
    instant, touches nobody on the same tracks.
    """

    scene: str
    seed: int
    ego: str
    traffic: str
    hit: bool
    by_adversary: bool
    fair: bool | None
    survives: bool | None
    careful_hit_by: str
    off_road: int
    poses: int
    seconds: float


def count_off_road(scene: Scene, track: AdversaryTrack | None) -> tuple[int, int]:
    """Poses with a corner off the true road, and all of them, of an adversary that ever left its recording."""
    if track is None or not len(track.poses):
        return 0, 0
    rest = slice(track.start, track.start + len(track.poses))
    there = scene.agents.valid[track.agent, rest]
    away = np.hypot(*(scene.agents.position[track.agent, rest, :2] - track.poses[:, :2])[there].T)
    if not (away > _LEFT_M).any():
        return 0, 0
    size = np.broadcast_to(scene.agents.size[track.agent, :2], (len(track.poses), 2))
    corners = box_corners(np.column_stack([track.poses[:, :2], size, track.poses[:, 2]]))
    return int((~scene.road_map.is_drivable(corners)).any(axis=1).sum()), len(track.poses)


def drive(data: Any, scene: Scene, seed: int, ego: str, traffic: str, backend: DefaultBackend) -> Encounter:
    begun = time.perf_counter()
    spec = EpisodeSpec(scene, read_recorded_can(data, scene.name), seed, backend, NoSensor(), 120.0)
    episode: Episode = run_episode(spec, build_planner(ego))
    track = episode.adversary
    survives, hit_by = None, ""
    if ego == EGOS[0]:
        outcome = simulate_reference_drivers(scene, backend.course(scene, seed), [Driver.CC])[Driver.CC]
        survives, own = outcome.survives, None if track is None else scene.agents.ids[track.agent]
        hit_by = "" if survives else "adversary" if outcome.agent == own and traffic != "replay" else "another"
    hit = episode.touch is not None
    by = hit and track is not None and episode.touch is not None and episode.touch.agent == track.agent
    fair = None
    if by and track is not None:
        again = DefaultBackend("adversary", adversary=ScriptedTracks({(scene.name, seed): track}, "replay"))
        fair = simulate_reference_drivers(scene, again.course(scene, seed), [Driver.CC])[Driver.CC].survives
    return Encounter(
        scene.name,
        seed,
        ego,
        traffic,
        hit,
        by,
        fair,
        survives,
        hit_by,
        *count_off_road(scene, track),
        time.perf_counter() - begun,
    )


@dataclass(frozen=True)
class Directly:
    """A service in this process, in the place of `RemoteTrafficMaker` and of a connection."""

    service: TrafficService
    others: str = "replay"
    url: str = "here"

    @property
    def facts(self) -> dict[str, Any]:
        """Who drives everybody."""
        return {"traffic": "here"}

    def possible(self, scene: Scene) -> bool:
        """Every scene is."""
        return True

    def policy(self, scene: Scene, run: int, start_us: int, others: Any) -> RemoteTraffic:
        """The policy of a scene, as if it were asked over gRPC."""
        return RemoteTraffic(scene, run, start_us, others(0), lambda: self)  # type: ignore[arg-type, return-value]

    def call(self, method: str, message: Any, deadline_s: float | None = None) -> Any:
        """The answer to a call, by its bytes."""
        answer = self.service.call(TRAFFIC + method, encode_message(message), {})
        return decode_message(METHODS[TRAFFIC + method][1], answer, GRPC_SESSION)

    def close(self) -> None:
        """Nothing is open."""


def compare_hits(encounters: list[Encounter], draws: int = 2000) -> str:
    """Hits per encounter, served less replayed, with the 95 % interval of recordings drawn anew."""
    replayed = {(each.scene, each.seed, each.ego): each.hit for each in encounters if each.traffic == "replay"}
    more: dict[str, list[int]] = {}
    for each in encounters:
        if each.traffic == "served":
            more.setdefault(each.scene, []).append(each.hit - replayed[each.scene, each.seed, each.ego])
    totals = np.array([[sum(values), len(values)] for values in more.values()])
    drawn = totals[np.random.default_rng(0).integers(0, len(totals), (draws, len(totals)))].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], [2.5, 97.5])
    return f"{totals[:, 0].sum() / totals[:, 1].sum():+.3f} ({low:+.3f} to {high:+.3f})"


def summarise(encounters: list[Encounter]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for traffic in dict.fromkeys(each.traffic for each in encounters):
        own = [each for each in encounters if each.traffic == traffic]
        careful = [each.survives for each in own if each.survives is not None]
        off, poses = sum(each.off_road for each in own), sum(each.poses for each in own)
        found[traffic] = {
            "encounters": len(own),
            "hits": {ego: sum(each.hit for each in own if each.ego == ego) for ego in EGOS},
            "by the adversary": sum(each.by_adversary for each in own),
            "of them fair": sum(bool(each.fair) for each in own),
            "careful survives": f"{sum(careful)}/{len(careful)}",
            "careful hit by the adversary": sum(each.careful_hit_by == "adversary" for each in own),
            "off road %": round(100.0 * off / poses, 2) if poses else None,
        }
    return found


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--limit", type=int, default=None)
    parser.add_argument("--budget", type=float, default=1e9, help="seconds after which no scene is begun")
    parser.add_argument("--data", default="mini", help="whose recordings")
    parser.add_argument("--search", choices=[*TRAFFIC_BUDGETS], default="quick")
    parser.add_argument("--no-socket", action="store_true")
    given = parser.parse_args()
    rounds, candidates = TRAFFIC_BUDGETS[given.search]
    maker = import_from_extension("agents", "adversary")(knows="motion-only", rounds=rounds, candidates=candidates)
    planned_s, bystanders, sessions = list[float](), list[tuple[str, str]](), list[str]()

    def end(world: SessionWorld) -> None:
        sessions.append(world.scene.name)
        planned_s.extend(world.planned_s)
        bystanders.extend(pair for pair in world.touched if EGO not in pair)

    service = TrafficService(TrafficSettings("adversary", maker), end)
    server = GrpcServer(service, limits=GRPC_SESSION, at_end=service.close)
    data, encounters, begun = benchmark.open_data(given.data), list[Encounter](), time.monotonic()
    with server:
        remote: Any = Directly(service) if given.no_socket else build_remote_traffic(server.url)
        backends = {
            "replay": DefaultBackend("replay"),
            "served": DefaultBackend("adversary", adversary=remote),
            "in process": DefaultBackend("adversary", adversary=maker),
        }
        for seed in range(given.seeds):
            for name in data.scene_names("val")[: given.limit]:
                if time.monotonic() - begun > given.budget:
                    break
                scene = data.scene(name)
                for ego in EGOS:
                    for traffic, backend in backends.items():
                        alone = traffic == "in process"
                        if alone and (seed or ego != EGOS[0] or not maker.possible(scene)):
                            continue
                        encounters.append(drive(data, scene, seed, ego, traffic, backend))
                        print(json.dumps(asdict(encounters[-1])), flush=True)
    print(json.dumps(summarise(encounters), indent=1))
    print(f"hits per encounter, served less replayed: {compare_hits(encounters)}")
    print(f"sessions {len(sessions)}, contacts of the adversary with bystanders {len(bystanders)}")
    if planned_s:
        found = (1000.0 * np.percentile(planned_s, [50, 95, 100])).round().tolist()
        print(f"plans {len(planned_s)}, ms at 50, 95, 100 %: {found}")
    return 1 if bystanders else 0


if __name__ == "__main__":
    sys.exit(main())
