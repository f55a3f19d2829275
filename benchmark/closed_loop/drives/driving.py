"""The main path of a drive: see, ask, drive half a second, see again, until something ends it."""

from dataclasses import dataclass
from typing import Literal

from benchmark.closed_loop.drives.asking import Failure, Reason, asked, told
from benchmark.closed_loop.drives.driven_scene import driven_scene
from benchmark.closed_loop.drives.observing import Observer
from benchmark.closed_loop.drives.riding import (
    Motion,
    NeuroncapScore,
    RecordedCan,
    Ride,
    RideMaker,
    Touch,
    UndrivablePlanError,
)
from benchmark.closed_loop.drives.route import Route, RouteFollower
from benchmark.closed_loop.drives.sensors import Look, Sensor
from benchmark.planning import Command, Plan, Planner, PrivilegedPlanner, SceneInfo
from benchmark.scene import Camera, Scene

End = Literal["contact", "end", "failed"]
"""What ends a drive: the first contact, the end of the scene, or the planner's failure."""


@dataclass(frozen=True, slots=True)
class Drive:
    """What came of one scene and one run.

    Attributes:
        motion: Everything that happened.
        primed: Planning instants at which the ego was the recorded one.
        plans: One for each planning instant that was planned from; those of primed instants were not driven.
        commands: Of the same instants.
        stations: Of the same instants: metres along the route.
        end: What ended it.
        touch: The first contact.
        failure: Why the planner failed.
        neuroncap: The engine's own score; ``None`` of engines without one, and of a failed drive.
    """

    motion: Motion
    primed: int
    plans: tuple[Plan, ...]
    commands: tuple[Command, ...]
    stations: tuple[float, ...]
    end: End
    touch: Touch | None
    failure: Failure | None
    neuroncap: NeuroncapScore | None


@dataclass(frozen=True, slots=True)
class Stage:
    """One scene with one run, ready to be driven.

    Attributes:
        scene: The scene.
        can: Measured motion at its keyframes.
        run: Index of the run.
        maker: The engine.
        sensor: What cameras see.
        timeout_s: How long a plan may take.
        family: Which scenario of the scene, where it has any.
        most_plans: Ends the drive after so many plans, to see how long it takes.
    """

    scene: Scene
    can: RecordedCan
    run: int
    maker: RideMaker
    sensor: Sensor
    timeout_s: float
    family: str = ""
    most_plans: int | None = None


def drive(stage: Stage, planner: Planner) -> Drive:
    """Drive one scene.

    Args:
        stage: What is driven.
        planner: Who plans.

    Returns:
        The drive.

    Raises:
        InputError: If the scene cannot be driven, whoever plans.
        BrokenImageError: If a picture cannot be had.
    """
    scene, ride = stage.scene, stage.maker.begin(stage.scene, stage.run, stage.can, stage.family)
    route, look = Route.of(scene), stage.sensor.look(scene)
    eyes = _Eyes(scene, route, look, Observer.of(scene, stage.can, ride.start, ride.primed), stage.timeout_s)
    failure = told(lambda: _introduce(planner, scene, look.cameras, route), stage.timeout_s)
    plans: list[Plan] = []
    commands: list[Command] = []
    stations: list[float] = []
    while failure is None and ride.goes_on and len(plans) != stage.most_plans:
        place = route.place(ride.motion.ego[-1], stations[-1] if stations else None)
        stations.append(place.station)
        seconds = route.seconds_of(int(ride.motion.times_us[-1]))
        own = ride.command
        commands.append(route.command(place.station, seconds) if own is None else own)
        plan = eyes.planned(planner, ride, commands[-1])
        if isinstance(plan, Failure):
            failure = plan
            break
        plans.append(plan)
        try:
            ride = ride.after(plan)
        except UndrivablePlanError as error:
            failure = Failure(Reason.UNUSABLE, str(error))
    ride = ride if failure is not None else ride.finished()
    touch = None if failure is not None else ride.touch
    return Drive(
        motion=ride.motion,
        primed=ride.primed,
        plans=tuple(plans),
        commands=tuple(commands),
        stations=tuple(stations),
        end="failed" if failure is not None else "end" if touch is None else "contact",
        touch=touch,
        failure=failure,
        neuroncap=None if failure is not None else ride.neuroncap_score(),
    )


@dataclass(frozen=True, slots=True)
class _Eyes:
    """What stands between a world and a planner in one drive."""

    scene: Scene
    route: Route
    look: Look
    observer: Observer
    timeout_s: float

    def planned(self, planner: Planner, ride: Ride, command: Command) -> Plan | Failure:
        """The plan of this instant; the privileged see the world as driven, and its future is revealed to nobody."""
        driven = driven_scene(self.scene, self.route, ride.motion)
        if isinstance(planner, PrivilegedPlanner) and not isinstance(planner, RouteFollower):
            failure = told(lambda: planner.reveal(driven), self.timeout_s)
            if failure is not None:
                return failure
        observation = self.observer.observation(ride.motion, self.look.views(driven), command, ride.can)
        return asked(planner, observation, self.timeout_s)


def _introduce(planner: Planner, scene: Scene, cameras: tuple[Camera, ...], route: Route) -> None:
    planner.reset(SceneInfo(scene.name, scene.road_map.location, cameras))
    if isinstance(planner, RouteFollower):
        planner.follow(route)
