"""Implementation of ``serve``: a planner is built here, and the protocol's extension answers with it."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.api.opening import open_data
from benchmark.api.planners import find_runnable_model
from benchmark.errors import InputError
from benchmark.machine.storage import make_token

if TYPE_CHECKING:
    from benchmark.machine.listening import PlannerService, ServingProtocol
    from benchmark.planning import Planner
    from benchmark.sandbox.limits import SandboxLimits
    from benchmark.scene import Scene


def find_serving_protocol(name: str) -> "ServingProtocol":
    """A protocol by its name; `InputError` where its extension or its packages are not installed."""
    from benchmark.machine.extension import import_from_extension, require_extra

    protocol: ServingProtocol = import_from_extension("protocol", name)()
    for package in protocol.packages:
        require_extra(package, "serving", protocol.extra)
    return protocol


def serve_planner(
    name: str,
    checkpoint: Path | None = None,
    *,
    protocol: str = "neuroncap",
    host: str | None = "127.0.0.1",
    port: int | None = 0,
    accept_torch_tensors: bool = False,
    device: str | None = None,
    precision: str | None = None,
    seed: int = 0,
    supervision: "SandboxLimits | None" = None,
    options: Mapping[str, Any] | None = None,
) -> "PlannerService":
    """A planner as a model server for NeuroNCAP, AlpaSim, or other clients of their protocols.

    Args:
        name: Planner name or ``package.module:Class``; no miniature stands in for a model without weights.
        checkpoint: Its weights, if not its own.
        protocol: ``neuroncap`` or ``alpasim``.
        host: Where to listen; this machine alone by default, and for ``None`` what is usual for the protocol.
        port: Where; 0 takes a free one, ``None`` what is usual for the protocol.
        accept_torch_tensors: Whether pictures may be saved tensors, which are pickles; ``neuroncap`` alone has them.
        device: Where a network runs.
        precision: Of a network.
        seed: For planners that take one.
        supervision: Limits of a planner of another package, which runs in a process of its own (docs/planners.md).
        options: Values of the protocol's own options.

    Returns:
        It listens; ``with`` answers in a thread, `serve` until interrupted.

    Raises:
        InputError: If the planner cannot be built or wants what is not on the wire, or the port is taken.
    """
    from adapters.models import MODELS
    from adapters.planners.names import is_third_party
    from adapters.registry import build_planner, planner_factory
    from benchmark.machine.address import is_address
    from benchmark.machine.metering import disable_malloc_trim_for

    if is_address(name):
        raise InputError(f"{name} is a server already; serve a planner by its name")
    own = dict(options or {})
    if accept_torch_tensors:
        own["accept_torch_tensors"] = True
    found = find_serving_protocol(protocol)
    runs = find_runnable_model(name, checkpoint, data="")

    def build() -> "Planner":
        built: Planner
        if is_third_party(runs):
            built = planner_factory(
                runs, checkpoint=checkpoint, seed=seed, device=device, precision=precision, supervision=supervision
            )()
        else:
            built = build_planner(runs, checkpoint=checkpoint, seed=seed, device=device, precision=precision)
        disable_malloc_trim_for(getattr(built, "weights_sha256", None))
        require_servable(built)
        return built

    own["wants_images"] = runs in MODELS and not MODELS[runs].blind
    server: PlannerService = found.make(build, *found.find_address(host, port), seed=seed, **own)
    return server


def require_servable(planner: "Planner") -> None:
    """Refuse planners that want what no request carries, or remember beyond a scene."""
    from benchmark.closed_loop.route import RouteFollower
    from benchmark.planning import PrivilegedPlanner, remembers_across_scenes

    if isinstance(planner, PrivilegedPlanner | RouteFollower):
        raise InputError(
            f"{planner.name} sees boxes, the map or the recorded path, which requests do not carry; serve a planner "
            "that uses sensors only"
        )
    if remembers_across_scenes(planner):
        raise InputError(f"{planner.name} keeps state across scenes, but each scene on the wire begins anew")


def serve_traffic(
    protocol: str = "alpasim-traffic",
    *,
    host: str | None = "127.0.0.1",
    port: int | None = 0,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
) -> "PlannerService":
    """Traffic for another simulator: everybody but the ego, one of them challenging it (docs/extensions/alpasim.md).

    Args:
        protocol: ``alpasim-traffic``.
        host: Where to listen; this machine alone by default, and for ``None`` what is usual for the protocol.
        port: Where; 0 takes a free one, ``None`` what is usual for the protocol.
        seed: Added to that of each session.
        options: Values of the protocol's own options, as ``serve`` has them.

    Returns:
        It listens; ``with`` answers in a thread, `serve` until interrupted.

    Raises:
        InputError: If the adversary's extension or the protocol's is not installed, or the port is taken.
    """
    from benchmark.closed_loop.adversary import ADVERSARY
    from benchmark.machine.extension import import_from_extension

    found, own = find_serving_protocol(protocol), dict(options or {})
    agents, maker, sessions = own.pop("traffic", ADVERSARY), None, own.pop("sessions", None)
    maps = own.pop("maps", "")
    rounds, candidates = TRAFFIC_BUDGETS[own.pop("adversary_budget", "quick")]
    every_s, others = own.pop("adversary_every", 1.0), own.pop("adversary_others", "replay")
    if agents == ADVERSARY:
        build = import_from_extension("agents", ADVERSARY)
        maker = build(knows="motion-only", every_s=every_s, others=others, rounds=rounds, candidates=candidates)
    if maps:
        own["maps"] = open_data(maps)
    if sessions is not None:
        own["write"] = SessionStore(sessions).write
    server: PlannerService = found.make(maker, *found.find_address(host, port), agents=agents, seed=seed, **own)
    return server


TRAFFIC_BUDGETS: Final[Mapping[str, tuple[int | None, int | None]]] = {"quick": (3, 96), "full": (None, None)}
"""Rounds and candidates of each, of an adversary that is waited for; ``full`` is that of ``drive``."""


_FIRST_US: Final = 1_500_000_000_000_000
_APART_US: Final = 3_600_000_000
"""Clocks of sessions begin at 0, those of a data set do not, and no two scenes are at the same time."""


class SessionStore:
    """Sessions of served traffic as a data set: adversarial scenes in ``adv``, the others in ``val``.

    ``sessions.json`` beside the tables has the report of each.
    """

    def __init__(self, root: Path) -> None:
        """Sessions that the root has stay."""
        from benchmark.untrusted.text_files import read_json

        self._root, self._list = root, root / "sessions.json"
        self._kept: list[dict[str, Any]] = read_json(self._list) if self._list.is_file() else []

    def write(self, scene: "Scene", report: dict[str, Any]) -> None:
        """Add a session; raises `InputError` where the disk refuses."""
        from dataclasses import replace

        from benchmark.machine.storage import lock_folder, write_json
        from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene

        name = f"scene-{2001 + len(self._kept):04d}"
        plan = DataSetPlan(root=self._root, split="adv")
        with lock_folder(self._root):
            given = f"session-{len(self._kept)}"
            tokens = {identifier: make_token(given, identifier) for identifier in scene.agents.ids}
            named = replace(
                scene,
                name=name,
                token=make_token(given, scene.token),
                log=given,
                timestamps_us=scene.timestamps_us - scene.timestamps_us[0] + _FIRST_US + _APART_US * len(self._kept),
                agents=replace(scene.agents, ids=tuple(tokens.values())),
                adversaries=tuple(tokens[identifier] for identifier in scene.adversaries),
            )
            key = write_scene(plan, named, name=name, source_scene=name, report=report)
            split = "adv" if scene.adversaries else "val"
            kept = [*self._kept, {"name": name, "key": key, "split": split, **report}]
            recorded = [session["name"] for session in kept if session["split"] == "val"]
            finish_data_set(
                plan, [session["key"] for session in kept], extra_splits={"val": recorded} if recorded else {}
            )
            write_json(self._list, kept)
            self._kept = kept
