"""Planners by name, whichever package or machine they are of."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.api.driving import require_sensor, uses_images
from benchmark.api.opening import notify_once, worker_count
from benchmark.api.sources import select_matching_options
from benchmark.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from adapters.registry import NamedPlanner
    from benchmark.datasets.roots import DataSet
    from benchmark.records.statistics import TrafficStatistics
    from benchmark.sandbox.limits import SandboxLimits
    from generation.pipeline.panel import PlannerPanel
    from generation.pipeline.surrogate import PlannerUnderTest

_DEVICE: Final = re.compile(r"auto|cpu|cuda(:\d+)?")
_PRECISIONS: Final = ("float32", "bfloat16")


def load_planner(
    name: str,
    checkpoint: Path | None = None,
    *,
    data: str | Path = "mini",
    seed: int = 0,
    device: str | None = None,
    precision: str | None = None,
    as_published: "Sequence[str]" = (),
    over_http: "Mapping[str, Any] | None" = None,
    supervision: "SandboxLimits | None" = None,
    options: "Mapping[str, Any] | None" = None,
) -> "NamedPlanner":
    """A planner by name, for `benchmark.evaluate`.

    Args:
        name: Planner name, ``package.module:Class``, or the address of a model server (docs/extensions/http.md).
        checkpoint: Its weights, if not its own.
        data: What it will drive on: on ``mini`` a miniature runs where the full model has no weights, and says so.
        seed: For planners that take one.
        device: Where a network runs: cpu, cuda, cuda:1; the first GPU by default, if there is one.
        precision: Of a network: float32 or bfloat16.
        as_published: What a network does as in its published runs: ``memory``, ``can-once``, ``can-after``, or ``all``
            that it knows of these (docs/models.md).
        over_http: How a model server is asked: ``image_format``, ``deadline_s``, and the ``frame`` of its answers; or
            ``remote_cameras`` of a policy at ``grpc://`` (docs/extensions/alpasim.md).
        supervision: Limits of a planner of another package, which runs in a process of its own (docs/planners.md).
        options: Values of the options that the planner's extension declares (docs/extending.md).

    Returns:
        What builds it in any process.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from adapters.registry import planner_factory

    chosen = find_runnable_model(name, checkpoint, data=data)
    if chosen != name:
        notify_once(f"no weights found for {name}: running {chosen} instead (docs/miniatures.md)")
    return planner_factory(
        chosen,
        checkpoint=checkpoint,
        seed=seed,
        device=device,
        precision=precision,
        as_published=as_published,
        over_http=over_http,
        supervision=supervision,
        options=options,
    )


def find_runnable_model(name: str, checkpoint: Path | None = None, *, data: str | Path = "mini") -> str:
    """Planner that `load_planner` builds: a miniature on embedded data where the full model has no weights.

    Nothing is loaded.

    Raises:
        InputError: If there is no such planner, or it is a network that has no weights.
    """
    from adapters.planners.names import require_known

    require_known(name)
    from adapters.checkpoints.stand_in import require_weights, stand_in

    chosen = stand_in(name, checkpoint, str(data))
    require_weights(chosen, checkpoint)
    return chosen


def planner_under_test(
    name: str,
    checkpoint: Path | None = None,
    *,
    data: str | Path = "mini",
    seed: int = 0,
    workers: int = 0,
    supervision: "SandboxLimits | None" = None,
) -> "PlannerUnderTest":
    """A planner that decides about generated scenes: the surrogate of a build, or who drives in an ablation.

    Args:
        name: Planner name or ``package.module:Class``.
        checkpoint: Its weights, if not its own.
        data: The data set that scenes are generated from.
        seed: For planners that take one.
        workers: Processes that run it; 0 takes all processors.
        supervision: As in `load_planner`.

    Returns:
        The planner, and whether it looks at images.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from generation.pipeline.surrogate import PlannerUnderTest

    factory = load_planner(name, checkpoint, data=data, seed=seed, supervision=supervision)
    return PlannerUnderTest(factory, images=uses_images(name) is not False, workers=worker_count(workers))


PANEL_MEMBERS: Final = (("noisy-log", 10), ("constant-velocity-on-path", 1))
"""Planners without images whose contacts choose scenes, with the number of their seeds."""


def planner_panel(per_scene: int | None = None) -> "PlannerPanel":
    """The panel that ranks the scenes of ``generate --preset effect``.

    Args:
        per_scene: Most scenes of a recording that are kept; two by default.

    Returns:
        Its members and how they are made.
    """
    from adapters.models import build_baseline
    from generation.pipeline.panel import PlannerPanel

    return PlannerPanel(PANEL_MEMBERS, build_baseline, per_scene or 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannerSource:
    """Planners by name that are checked before anything is built, and loaded when they are needed.

    ``sample_limit`` (seconds for a plan) and ``memory_limit`` (GiB) are of planners of other packages. ``frame`` is the
    one in which a model server, or a file, plans; a model server has a limit of its own beside ``deadline_s``.
    ``of_extensions`` are options that extensions declare, by planner.
    """

    names: "Sequence[str]"
    data: str = "mini"
    checkpoint: Path | None = None
    seed: int = 0
    device: str | None = None
    precision: str | None = None
    as_published: "Sequence[str]" = ()
    sample_limit: float | None = None
    memory_limit: float | None = None
    frame: str | None = None
    image_format: str | None = None
    deadline_s: float | None = None
    of_extensions: "Mapping[str, Mapping[str, Any]]" = field(default_factory=dict)

    @classmethod
    def of(cls, options: Any, **others: Any) -> "PlannerSource":
        """Planners that options of a command name, not checked yet; ``others`` take the place of options.

        Options count that are called as the attributes here; ``model`` is one name or several.
        """
        named = getattr(options, "model", ())
        values = {**select_matching_options(cls, options), "names": (named,) if isinstance(named, str) else named}
        return cls(**{**values, "as_published": values.get("as_published") or (), **others})

    def require(self) -> "PlannerSource":
        """Itself, once all planners are known, have weights, and can run so; a limit needs a planner that it is for."""
        from adapters.models import MODELS

        for runs in self.runnable_names:
            # A planner of another package checks its own devices and precisions.
            if runs not in MODELS or MODELS[runs].network is None:
                continue
            if self.device is not None:
                require_devices(self.device)
            if self.precision is not None and self.precision not in _PRECISIONS:
                raise InputError(f"unknown precision {self.precision!r}; use {' or '.join(_PRECISIONS)}")
        _ = self.supervision
        return self

    def require_frame(self, *, of_file: bool = False) -> None:
        """Refuse ``--frame`` where no file and no model server is named: classes say in which frame they plan."""
        if self.frame is not None and not of_file and not self._served:
            raise InputError(
                "--frame is for plan files and models at http://HOST:PORT; a class states its frame with "
                "PlanFrame in its Plan; leave --frame out"
            )
        if self.frame is not None and any(scheme == "grpc" for scheme in self._served.values()):
            raise InputError("--frame is for models at http://; a policy at grpc:// has a frame; leave --frame out")

    def require_servers(self, sensor: str = "none", *, tensors: bool = False) -> None:
        """Refuse servers that do not answer or would get no pictures, and options of servers where none is named."""
        from benchmark.machine.address import Address, is_address
        from benchmark.machine.extension import import_from_extension, require_extra

        if self.image_format is not None and not self._served:
            raise InputError("--image-format applies only to a model at http:// or grpc://HOST:PORT; leave it out")
        if tensors and not is_address(sensor):
            raise InputError("--accept-torch-tensors is only for a renderer at --sensor http://HOST:PORT; leave it out")
        require_sensor(sensor)
        for name, scheme in self._served.items():
            own = self.of_extensions.get(scheme, {})
            if self.image_format is not None:
                own = {**own, "image_format": self.image_format}
            import_from_extension("planner scheme", scheme)(name, **own).require_alive()
        if is_address(sensor):
            require_extra("httpx2", "asking over HTTP", "serve")
            import_from_extension("sensor", "http")(Address.of(sensor, "--sensor")).require_alive()

    def remembers_across_scenes(self) -> bool:
        """Whether any planner repeats a behaviour of published runs that makes plans depend on the scenes before.

        A planner without such a behaviour is refused where one is asked for.
        """
        from adapters.as_published import CROSS_SCENES, select_options
        from adapters.models import MODELS

        if self.as_published and not self.names:
            raise InputError("--as-published applies only to networks named with --model; leave it out")
        done: set[str] = set()
        for runs in self.runnable_names if self.as_published else ():
            network = MODELS[runs].network if runs in MODELS else None
            done |= set(select_options(runs, {} if network is None else network.as_published, self.as_published))
        return not CROSS_SCENES.isdisjoint(done)

    @property
    def runnable_names(self) -> list[str]:
        """Names of what runs: miniatures on embedded data where a full model has no weights."""
        return [find_runnable_model(name, self.checkpoint, data=self.data) for name in self.names]

    @property
    def supervision(self) -> "SandboxLimits":
        """Limits of planners of other packages; `InputError` where there is no such planner or no such number."""
        from adapters.planners.names import is_third_party
        from benchmark.sandbox.limits import SandboxLimits

        given = {"--sample-limit": self.sample_limit, "--memory-limit": self.memory_limit}
        given_option = next((option for option, value in given.items() if value is not None), None)
        if given_option is not None and not any(is_third_party(name) for name in self.names):
            raise InputError(
                f"{given_option} is of planners of other packages, which run in a process of their own "
                "(docs/planners.md); leave it out"
            )
        return SandboxLimits.of(self.sample_limit, self.memory_limit)

    def load(self, supervision: "SandboxLimits | None" = None) -> "list[NamedPlanner]":
        """Load them; ``supervision`` replaces the limits that options name."""
        served = {"image_format": self.image_format, "frame": self.frame, "deadline_s": self.deadline_s}
        of_served = {name: {**served, **self.of_extensions.get(scheme, {})} for name, scheme in self._served.items()}
        return [
            load_planner(
                planner_name,
                self.checkpoint,
                data=self.data,
                seed=self.seed,
                device=self.device,
                precision=self.precision,
                as_published=self.as_published,
                over_http={name: value for name, value in of_served.get(planner_name, {}).items() if value is not None},
                supervision=supervision or self.supervision,
                options=self.of_extensions.get(planner_name),
            )
            for planner_name in self.names
        ]

    def under_test(self, workers: int) -> "PlannerUnderTest":
        """The one planner, loaded to decide about generated scenes in so many processes."""
        (name,) = self.names
        return planner_under_test(
            name, self.checkpoint, data=self.data, seed=self.seed, workers=workers, supervision=self.supervision
        )

    @property
    def _served(self) -> dict[str, str]:
        """Schemes of planners elsewhere, by their addresses."""
        from benchmark.machine.address import find_scheme

        return {name: scheme for name in self.names if (scheme := find_scheme(name)) is not None}


def require_device(name: str) -> None:
    """Refuse what names no device; whether this machine has it is only known to torch, which is slow to import."""
    if not _DEVICE.fullmatch(name):
        raise InputError(f"unknown device {name!r}; use cpu, cuda, cuda:1 or auto")


def require_devices(names: str) -> None:
    """`require_device` of each of several, which commas separate."""
    from benchmark.machine.several_devices import parse_device_names

    for name in parse_device_names(names):
        require_device(name)


def measure_traffic(
    data: "DataSet", split: str | None = None, *, recordings: "DataSet | None" = None, workers: int = 0
) -> "TrafficStatistics":
    """Traffic around the recorded ego, and what planners without images collide in (docs/data.md).

    Args:
        data: The data set.
        split: One of its splits; all of its scenes by default.
        recordings: What its scenes were made from, for data sets that do not name their adversaries.
        workers: Processes; 0 takes all processors.

    Returns:
        Figures over all samples and by scene, and rates under ``exact``.

    Raises:
        InputError: If there is no such split, or a scene is broken.
    """
    from adapters.models import baselines, build_baseline
    from benchmark.fairness.traffic import measure_scenes

    draws = {name: model.draws for name, model in baselines().items()}
    names = data.scene_names(split)
    return measure_scenes(data, names, draws, build_baseline, workers=worker_count(workers), recordings=recordings)
