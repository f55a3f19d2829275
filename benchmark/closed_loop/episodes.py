"""The main path of a drive: see, ask, drive half a second, see again, until something ends it.

Several drives can be under way side by side, which is faster where their engine steps many worlds together.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, cast

from benchmark.closed_loop.adversary import AdversaryTrack
from benchmark.closed_loop.observation_builder import NoCameras, ObservationBuilder, SceneCameras, Sensor
from benchmark.closed_loop.planner_calls import Failure, FailureReason, notify_planner, request_plan
from benchmark.closed_loop.route import Route, RouteFollower, build_driven_scene, build_ride
from benchmark.closed_loop.simulation_state import (
    CollisionEvent,
    EpisodeMotion,
    RecordedCan,
    RejectedPlanError,
    ReplanningBackend,
    SimulationState,
    SimulatorBackend,
)
from benchmark.errors import InputError
from benchmark.machine.metering import Meter
from benchmark.planning import (
    CameraView,
    Command,
    NoViews,
    Plan,
    Planner,
    PrivilegedPlanner,
    SceneInfo,
    SessionPlanner,
)
from benchmark.records.drive_schema import NeuroncapScore
from benchmark.records.encounter_window import EncounterWindow
from benchmark.scene import Camera, Scene

USUAL_HZ: Final = 2
"""How often planners are asked."""
End = Literal["contact", "end", "failed"]
"""Cause of the end of an episode: a contact, the end of the scene, or the planner's failure."""


@dataclass(frozen=True, slots=True)
class Episode:
    """Outcome of one scene and one run.

    Attributes:
        primed: Planning instants at which the ego was the recorded one.
        plans: One for each planning instant that was planned from; those of primed instants were not driven.
            ``commands`` and ``stations`` (metres along the route) are of the same instants.
        touch: The contact that ended it.
        neuroncap: The engine's own score; ``None`` of engines without one, and of a failed drive.
        adversary: Where an adversary went, if there was one that answers or was given its track.
        passed: Contacts before that did not end it; they are not the ego's fault.
        between: Plans between two instants, of each, where the planner was asked more often.
        notes: What was peculiar in answers that were taken all the same. ``terminated`` where the planner ended it.
        window: Part of the scene that was driven around an encounter, if only that was.
    """

    motion: EpisodeMotion
    primed: int
    plans: tuple[Plan, ...]
    commands: tuple[Command, ...]
    stations: tuple[float, ...]
    end: End
    touch: CollisionEvent | None
    failure: Failure | None
    neuroncap: NeuroncapScore | None
    adversary: AdversaryTrack | None = None
    passed: tuple[CollisionEvent, ...] = ()
    window: EncounterWindow | None = None
    between: tuple[tuple[Plan, ...], ...] = ()
    notes: tuple[str, ...] = ()
    terminated: bool = False


@dataclass(frozen=True, slots=True)
class EpisodeSpec:
    """One scene with one run, ready to be driven; ``family`` says which scenario of the scene, where it has any.

    ``can`` is measured motion at its keyframes; ``most_plans`` ends the drive after so many, to see how long it takes.
    Planners are asked ``plan_hz`` times a second, 2 or 10.
    """

    scene: Scene
    can: RecordedCan
    run: int
    maker: SimulatorBackend
    sensor: Sensor
    timeout_s: float
    family: str = ""
    most_plans: int | None = None
    meter: Meter | None = None
    plan_hz: int = USUAL_HZ

    @property
    def window(self) -> EncounterWindow | None:
        """The window of its engine; only the default one has any."""
        return getattr(self.maker, "window", None)


def run_episode(stage: EpisodeSpec, planner: Planner) -> Episode:
    """Drive one scene; errors that are not the planner's are raised: `InputError`, `BrokenImageError`."""
    return next(episode for _, episode in run_episodes([stage], [planner]))


def run_episodes(stages: Sequence[EpisodeSpec], planners: Sequence[Planner]) -> Iterator[tuple[int, Episode]]:
    """Drive several scenes of one engine side by side; yields places among the stages, and their drives, as they end.

    None changes a byte of another. Each drive has its own planner, since a planner has a memory; one that draws numbers
    from a generator of the process would be given others than alone. Errors that are not a planner's, `InputError` and
    `BrokenImageError`, are raised after the drives of the others.
    """
    errors: dict[int, InputError] = {}
    seats: dict[int, _Simulation] = {}
    for place, (stage, planner) in enumerate(zip(stages, planners, strict=True)):
        with _defer_input_errors(errors, place):
            seats[place] = _Simulation.of(stage, planner)
    while seats:
        plans: dict[int, Plan] = {}
        for place, seat in [*seats.items()]:
            with _defer_input_errors(errors, place):
                plan = seat.planned()
                if plan is None:
                    yield place, seat.ended()
                else:
                    plans[place] = plan
        seats = {place: seats[place] for place in plans}
        if seats:
            _advance_simulations(list(seats.values()), list(plans.values()))
    if errors:
        raise errors[min(errors)]


@contextlib.contextmanager
def _defer_input_errors(errors: dict[int, InputError], place: int) -> Iterator[None]:
    """Put errors that are not the planner's aside until the others have arrived."""
    try:
        yield
    except InputError as error:
        errors[place] = error


class _DriveOverError(Exception):
    """The planner gave no plan between two planning instants: it failed, or ended the drive."""


def _advance_simulations(seats: "Sequence[_Simulation]", plans: Sequence[Plan]) -> None:
    if seats[0].stage.plan_hz != USUAL_HZ:
        for seat, plan in zip(seats, plans, strict=True):
            seat.advance_replanning(plan)
        return
    later = seats[0].stage.maker.advance_together([seat.ride for seat in seats], plans)
    for seat, ride in zip(seats, later, strict=True):
        if isinstance(ride, RejectedPlanError):
            seat.failure = Failure(FailureReason.UNUSABLE, str(ride))
        else:
            seat.ride = ride


@dataclass(slots=True)
class _Simulation:
    """Drive under way; plans, commands and stations are those so far, one for each planning instant."""

    stage: EpisodeSpec
    planner: Planner
    ride: SimulationState
    eyes: "_PlannerInterface"
    failure: Failure | None
    plans: list[Plan] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    stations: list[float] = field(default_factory=list)
    between: list[tuple[Plan, ...]] = field(default_factory=list)
    notes: dict[str, list[float]] = field(default_factory=dict)
    terminated: bool = False

    @classmethod
    def of(cls, stage: EpisodeSpec, planner: Planner) -> "_Simulation":
        """The simulation of one episode, after the planner was given the scene."""
        if stage.meter is not None:
            # A restarted episode drops the latencies measured before.
            stage.meter.latency_s.clear()
        scene, ride = stage.scene, stage.maker.begin(stage.scene, stage.run, stage.can, stage.family)
        route, look = Route.of(scene), stage.sensor.look(scene)
        observer = ObservationBuilder.of(scene, stage.can, ride.start, ride.primed)
        eyes = _PlannerInterface(scene, route, look, observer, stage.timeout_s, stage.meter, stage.plan_hz)
        failure = notify_planner(
            planner, lambda: _introduce_scene(planner, scene, look.cameras, route), stage.timeout_s
        )
        return cls(stage, planner, ride, eyes, failure)

    def planned(self) -> Plan | None:
        """The plan of this instant; ``None`` where the drive has ended or the planner fails."""
        if self.failure is not None or self.terminated or not self.ride.is_running:
            return None
        if len(self.plans) == self.stage.most_plans:
            return None
        ride, route = self.ride, self.eyes.route
        place = route.place(ride.motion.ego[-1], self.stations[-1] if self.stations else None)
        self.stations.append(place.station)
        seconds, own = route.seconds_of(int(ride.motion.times_us[-1])), ride.command
        self.commands.append(route.command(place.station, seconds) if own is None else own)
        plan = self._ask(self.eyes, ride)
        if plan is None:
            if self.terminated:
                del self.commands[-1], self.stations[-1]
            return None
        self.plans.append(plan)
        return plan

    def _ask(self, eyes: "_PlannerInterface", ride: SimulationState) -> Plan | None:
        """A plan now; none where the planner fails or ends the drive."""
        plan = eyes.planned(self.planner, ride, self.commands[-1])
        if isinstance(self.planner, SessionPlanner):
            note, seconds = self.planner.take_note(), eyes.route.seconds_of(int(ride.motion.times_us[-1]))
            if note.text:
                self.notes.setdefault(note.text, []).append(seconds)
            self.terminated = note.ends_drive
            if self.terminated:
                return None
        if isinstance(plan, Failure):
            self.failure = plan
            return None
        return plan

    def advance_replanning(self, plan: Plan) -> None:
        """Half a second, with plans at the instants between; where there is none, the drive ended where it began."""
        between: list[Plan] = []
        eyes = self.eyes.between_keyframes()

        def replan(ride: SimulationState) -> Plan:
            made = self._ask(eyes, ride)
            if made is None:
                raise _DriveOverError
            between.append(made)
            return made

        try:
            later = cast(ReplanningBackend, self.stage.maker).advance_replanning(self.ride, plan, replan)
            if isinstance(later, RejectedPlanError):
                self.failure = Failure(FailureReason.UNUSABLE, str(later))
            else:
                self.ride = later
        except _DriveOverError:
            if self.terminated:
                del self.plans[-1], self.commands[-1], self.stations[-1]
                return
        self.between.append(tuple(between))

    def ended(self) -> Episode:
        """The finished episode."""
        failed = self.failure is not None
        ride = self.ride if failed else self.ride.finished()
        touch = None if failed else ride.touch
        return Episode(
            motion=ride.motion,
            primed=ride.primed,
            plans=tuple(self.plans),
            commands=tuple(self.commands),
            stations=tuple(self.stations),
            end="failed" if failed else "end" if touch is None else "contact",
            touch=touch,
            failure=self.failure,
            neuroncap=None if failed else ride.neuroncap_score(),
            adversary=ride.adversary,
            passed=() if failed else ride.passed,
            window=self.stage.window,
            between=tuple(self.between),
            notes=tuple(_format_note(text, times) for text, times in self.notes.items()),
            terminated=self.terminated,
        )


def _format_note(text: str, seconds: Sequence[float]) -> str:
    again = f", and {len(seconds) - 1} times more" if len(seconds) > 1 else ""
    return f"{seconds[0]:.1f} s: {text}{again}"


@dataclass(frozen=True, slots=True)
class _PlannerInterface:
    """Builds the observations of one episode and asks the planner for plans."""

    scene: Scene
    route: Route
    look: SceneCameras
    observer: ObservationBuilder
    timeout_s: float
    meter: Meter | None
    plan_hz: int

    def between_keyframes(self) -> "_PlannerInterface":
        """Where nothing was measured: motion is that of the poses."""
        return replace(self, observer=replace(self.observer, can=self.observer.can.at(slice(0))))

    def planned(self, planner: Planner, ride: SimulationState, command: Command) -> Plan | Failure:
        """The plan of this instant; the privileged see the world as driven, and none sees its future."""
        views: dict[str, CameraView] = NoViews()
        reveals = isinstance(planner, PrivilegedPlanner) and not isinstance(planner, RouteFollower)
        if reveals or isinstance(planner, SessionPlanner) or not isinstance(self.look, NoCameras):
            driven = build_driven_scene(self.scene, self.route, ride.motion)
            if isinstance(planner, SessionPlanner):
                until = int(ride.motion.times_us[ride.motion.ticks[: ride.primed][-1]])
                last, step_us = len(driven.timestamps_us) - 1, 1_000_000 // self.plan_hz
                planner.take_ride(build_ride(driven, self.scene.ego.position, last, until, step_us))
            if reveals:
                failure = notify_planner(
                    planner, lambda: cast(PrivilegedPlanner, planner).reveal(driven), self.timeout_s
                )
                if failure is not None:
                    return failure
            views = self.look.views(driven)
        observation = self.observer.observation(ride.motion, views, command, ride.can)
        return request_plan(planner, observation, self.timeout_s, self.meter)


def _introduce_scene(planner: Planner, scene: Scene, cameras: tuple[Camera, ...], route: Route) -> None:
    planner.reset(SceneInfo(scene.name, scene.road_map.location, cameras))
    if isinstance(planner, RouteFollower):
        planner.follow(route)
