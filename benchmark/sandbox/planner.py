"""A planner in a process of its own, as everybody here knows planners: `reset`, `plan`, and what else it can do."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from benchmark.errors import InputError
from benchmark.planning import (
    Forecasts,
    Observation,
    Plan,
    PlanFrame,
    PlannerFailedError,
    PlannerGoneError,
    PlannerLateError,
    PlannerLostError,
    SceneInfo,
)
from benchmark.records.run_schema import PlannerFacts
from benchmark.sandbox.frames import MalformedError
from benchmark.sandbox.limits import SandboxLimits
from benchmark.sandbox.observation_packing import ObservationPacker
from benchmark.sandbox.process import PlannerProcess
from benchmark.scene import Scene

_LONGEST_TYPE_NAME: Final = 100


@dataclass(frozen=True, slots=True)
class PlannerSpec:
    """How a planner is made in its process, with picklable arguments; messages name it as ``called``.

    ``reference`` is a function, ``package.module:name``, that returns the planner and its
    `benchmark.records.run_schema.PlannerFacts`.
    """

    called: str
    reference: str
    given: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PlannerIdentity:
    """Identity that a planner reports: who it is and what it can do.

    ``reveal`` is of a privileged planner, ``follow`` gets the route of a drive, and ``begin_run`` resets all state.
    ``memory_crosses_scenes`` is whether `benchmark.planning.Planner.reset` leaves what it remembers, and
    ``reads_message_after`` whether it is given the CAN message after the sample.
    """

    facts: PlannerFacts
    reveal: bool = False
    follow: bool = False
    begin_run: bool = False
    memory_crosses_scenes: bool = False
    reads_message_after: bool = False


def find_identity(maker: PlannerSpec, supervision: SandboxLimits) -> PlannerIdentity:
    """Build a planner in its process, ask for its identity, and end it."""
    process = PlannerProcess(supervision)
    try:
        return _build_planner(process, maker, supervision)
    except PlannerFailedError as error:
        error.add_note(error.text)
        raise InputError(f"model {maker.called!r} cannot be loaded: {error}") from error
    finally:
        process.end()


def make_sandboxed_planner(
    maker: PlannerSpec, identity: PlannerIdentity, supervision: SandboxLimits
) -> "SandboxedPlanner":
    """A planner in its process, started when a scene begins; it has the optional methods that the planner has."""
    return _choose_class(identity.reveal, identity.follow, identity.begin_run)(maker, identity, supervision)


class SandboxedPlanner:
    """A planner in a process of its own (`benchmark.planning.SupervisedPlanner`); attributes as `PlannerIdentity`."""

    def __init__(self, maker: PlannerSpec, identity: PlannerIdentity, supervision: SandboxLimits) -> None:
        """Nothing is started yet."""
        self.name = identity.facts.name
        self.reads_message_after = identity.reads_message_after
        self.memory_crosses_scenes = identity.memory_crosses_scenes
        self._maker = maker
        self._identity = identity
        self._supervision = supervision
        self._process: PlannerProcess | None = None
        self._seed: int | None = None
        self._packing = ObservationPacker()
        self._looked: tuple[str, ...] = ()

    @property
    def pid(self) -> int | None:
        """Its process; ``None`` while there is none, and where the system does not tell."""
        return None if self._process is None else self._process.pid

    def seed_generators(self, seed: int) -> None:
        """Global generators of its process begin there at the next `reset`."""
        self._seed = seed

    def reset(self, scene: SceneInfo) -> None:
        """Begin a scene, in a new process if the last one is gone."""
        seed, self._seed = self._seed, None
        self._asked("reset", seed, scene, doing="reset did not return")

    def plan(self, observation: Observation) -> Plan:
        """Ask for a plan; pictures are read when the planner looks at them.

        A return value of another type becomes a value of a type with the same name.
        """
        if self._process is None:
            raise PlannerLostError("the process of this planner is not running; call reset first")
        views = observation.views

        def picture(name: str) -> NDArray[np.uint8]:
            return views[name].load()

        looked, self._looked = self._looked, ()
        packed = self._packing.packed(observation)
        answer = self._asked("plan", packed, doing="no plan", picture=picture, ahead=looked)
        if answer[0] == "no plan":
            name = str(answer[1])
            # The object itself is not here, and only the name of its type is ever reported.
            return type(name if name.isidentifier() else "object", (), {})()  # type: ignore[no-any-return]
        # A planner that read a picture probably reads the next one of that camera.
        self._looked = tuple(name for name in answer[2] if name in views)
        return _plan(answer[1])

    def loaded_code(self) -> dict[str, str]:
        """Code that its process has loaded; raises as `reset` does."""
        if self._process is None:
            return {}
        hashes = self._asked("loaded", doing="the request for its loaded code did not return")[1]
        return {str(file): str(sha256) for file, sha256 in hashes.items()}

    def close(self) -> None:
        """End its process; the next scene starts another."""
        if self._process is not None:
            self._process.end()
            self._process = None

    def _asked(
        self,
        kind: str,
        *parts: Any,
        doing: str,
        picture: Callable[[str], NDArray[np.uint8]] | None = None,
        ahead: Sequence[str] = (),
    ) -> list[Any]:
        try:
            process, limit_s = self._start(), self._supervision.sample_s
            answer = process.ask(kind, *parts, doing=doing, limit_s=limit_s, picture=picture, ahead=ahead)
            return _check_answer(answer, ("plan", "no plan") if kind == "plan" else ("done", "loaded"))
        except (PlannerLostError, MalformedError) as error:
            self.close()
            raise error if isinstance(error, PlannerLostError) else _make_lost_error(error) from None
        except PlannerFailedError:
            raise
        except BaseException:
            # Possibly interrupted: the state of its process is unknown.
            self.close()
            raise

    def _start(self) -> PlannerProcess:
        if self._process is not None:
            return self._process
        self._process, self._packing, self._looked = PlannerProcess(self._supervision), ObservationPacker(), ()
        try:
            identity = _build_planner(self._process, self._maker, self._supervision)
            if identity.memory_crosses_scenes:
                doing, limit_s = "begin_run did not return", self._supervision.sample_s
                _check_answer(self._process.ask("begin_run", doing=doing, limit_s=limit_s), ("done",))
        except PlannerLostError:
            raise
        except (InputError, PlannerFailedError) as error:
            # It could be built before, so this is not a usage error.
            raise PlannerLostError(f"it cannot be built again: {error}") from error
        if identity != self._identity:
            raise PlannerLostError("it reports a different identity each time it is built")
        return self._process


class _SandboxedPrivilegedPlanner(SandboxedPlanner):
    def reveal(self, scene: Scene) -> None:
        """Privileged information; raises as `reset` does."""
        self._asked("tell", "reveal", scene, doing="reveal did not return")


class _SandboxedRouteFollower(SandboxedPlanner):
    def follow(self, route: Any) -> None:
        """The route of a drive; raises as `reset` does."""
        self._asked("tell", "follow", route, doing="follow did not return")


class _SandboxedContinuousPlanner(SandboxedPlanner):
    def begin_run(self) -> None:
        """Forget everything; a process that there is not yet has nothing to forget."""
        if self._process is not None:
            self._asked("begin_run", doing="begin_run did not return")


@cache
def _choose_class(reveal: bool, follow: bool, begin_run: bool) -> type[SandboxedPlanner]:
    """Class with exactly the planner's methods, since callers test for their presence."""
    chosen = (
        (_SandboxedPrivilegedPlanner, reveal),
        (_SandboxedRouteFollower, follow),
        (_SandboxedContinuousPlanner, begin_run),
    )
    bases = tuple(base for base, wanted in chosen if wanted)
    return type("Supervised", bases, {}) if bases else SandboxedPlanner


def _build_planner(process: PlannerProcess, maker: PlannerSpec, supervision: SandboxLimits) -> PlannerIdentity:
    answer = process.ask(
        "build",
        maker.reference,
        dict(maker.given),
        doing="importing and building it did not end",
        limit_s=supervision.longest_loading_s,
    )
    if answer[0] == "refused" and len(answer) == 3:
        refusal = InputError(str(answer[1]))
        refusal.add_note(str(answer[2]))
        raise refusal
    try:
        _check_answer(answer, ("built",))
        traits = {name: bool(value) for name, value in answer[2].items()}
        return PlannerIdentity(PlannerFacts.model_validate_json(answer[1]), **traits)
    except (MalformedError, ValidationError, TypeError, AttributeError, IndexError) as error:
        raise _make_lost_error(error) from error


def _check_answer(answer: list[Any], expected: tuple[str, ...]) -> list[Any]:
    """An answer that is one to what was asked, or what it raises."""
    kind, *rest = answer
    if kind in expected:
        return answer
    words = [str(word) for word in rest]
    if kind in ("raised", "raised unseeing") and len(words) == 2:
        raise PlannerFailedError(*words, looked=kind == "raised unseeing")
    if kind == "late" and words:
        raise PlannerLateError(words[0])
    if kind == "gone" and words:
        raise PlannerGoneError(words[0])
    raise MalformedError("its answer does not fit the request")


def _make_lost_error(error: Exception) -> PlannerLostError:
    return PlannerLostError(f"the planner's process broke the connection: {error}")


def _plan(answer: Any) -> Plan:
    """The plan that was answered; numbers of it are checked where those of every planner are."""
    try:
        forecasts, waypoints = answer["forecasts"], answer["waypoints"]
        sound = np.isfinite(waypoints)
        is_sound = bool(sound.all())
        plan = Plan(
            waypoints=waypoints if is_sound else np.where(sound, waypoints, waypoints.dtype.type(0)),
            frame=PlanFrame(answer["frame"]),
            modes=answer["modes"],
            mode_scores=answer["mode_scores"],
            forecasts=None if forecasts is None else Forecasts(**forecasts),
        )
        # The plan was valid when it was made there; callers check its numbers, which may have been changed since.
        if not is_sound:
            np.copyto(plan.waypoints, waypoints)
        return plan
    except (InputError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise PlannerFailedError(*[f"{type(error).__name__}: {error}"] * 2) from error
