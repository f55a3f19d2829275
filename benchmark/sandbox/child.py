"""A planner's process: builds the planner, then answers requests until the connection is closed.

Any exception of a planner is an answer. The parent (`process.py`) detects any end of this process. What the planner
prints goes to stderr: stdout belongs to the command, and this process does not have it.
"""

import atexit
import contextlib
import importlib
import os
import resource
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.planning import (
    Forecasts,
    NoViews,
    Plan,
    Planner,
    PlannerGoneError,
    PlannerLateError,
    PrivilegedPlanner,
    SceneInfo,
    reads_message_after,
)
from benchmark.runs.code_identity import hash_loaded_code
from benchmark.runs.plan_rows import FAILURES, format_traceback, seed_everything
from benchmark.sandbox.frames import ClosedError, encode_answer, receive_question
from benchmark.sandbox.limits import BEAT_S, seed_torch_on_import, use_one_thread
from benchmark.sandbox.observation_packing import ObservationUnpacker
from benchmark.sandbox.shared_images import SharedImageReader
from benchmark.untrusted.answers import UnencodableValueError
from benchmark.untrusted.files import to_one_line

_LONGEST_TEXT: Final = 20_000
"""Characters of a traceback; its beginning and its end say what happened."""


class PictureError(InputError):
    """A picture that the other process could not read; it knows why."""


def main(channel: int, pictures: int, memory_bytes: int) -> None:
    """Answer requests until the connection closes; descriptors of it and of shared memory. 0 bytes: no limit."""
    _apply_memory_limit(memory_bytes)
    stream = socket.socket(fileno=channel)
    # A fork that the planner makes of this process must not answer for it.
    os.register_at_fork(after_in_child=stream.close)
    PlannerRequestHandler(stream, SharedImageReader(pictures)).go_on()


def _apply_memory_limit(memory_bytes: int) -> None:
    limits = [(resource.RLIMIT_CORE, 0)]
    if memory_bytes:
        # Reserved address space does not count there: networks and GPUs reserve far more than they use.
        limits.append((resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS, memory_bytes))
    for limit, most in limits:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(limit, (most, most))


@dataclass(slots=True)
class PlannerRequestHandler:
    """Planner of this process and its connection to the parent; ``number`` is that of the present question, or 0."""

    stream: socket.socket
    viewer: SharedImageReader
    planner: Planner | None = None
    number: int = 0
    _asking: threading.Lock = field(default_factory=threading.Lock)
    _unpacking: ObservationUnpacker = field(default_factory=ObservationUnpacker)
    _ready: dict[str, tuple[int, tuple[int, ...], bool]] = field(default_factory=dict)
    _looked: dict[str, None] = field(default_factory=dict)
    _process: int = field(default_factory=os.getpid)

    def go_on(self) -> None:
        """Answer requests until the connection is closed."""
        threading.Thread(target=self._beat, daemon=True).start()
        while True:
            try:
                number, kind, parts = receive_question(self.stream)
            except (ClosedError, OSError):
                # Exits at once: freeing the memory piece by piece would only take time.
                atexit._run_exitfuncs()
                os._exit(0)
            self.number = number
            answered = self._answer(kind, parts)
            self._exit_in_forked_copy()
            with self._asking:
                self.number = 0
                try:
                    self.stream.sendall(_encode_or_report(number, [self.viewer.collect_released(), answered]))
                except OSError:
                    os._exit(1)

    def _beat(self) -> None:
        pause = threading.Event()
        while True:
            self.viewer.beat()
            pause.wait(BEAT_S)

    def _exit_in_forked_copy(self) -> None:
        """Ends the copy of a planner that forks and returns twice: it must not answer."""
        if os.getpid() != self._process:
            os._exit(0)

    def _answer(self, kind: str, parts: tuple[Any, ...]) -> list[Any]:
        """The answer to a request, even if the planner raises."""
        try:
            return _KINDS[kind](self, *parts)
        except PictureError:
            return ["picture missing"]
        except PlannerLateError as error:
            return ["late", to_one_line(error)]
        except PlannerGoneError as error:
            return ["gone", to_one_line(error)]
        except BaseException as error:
            return ["raised", *_describe_error(error)]

    def build(self, reference: str, given: Mapping[str, Any]) -> list[Any]:
        """Build the planner and say who it is; bad input is a sentence."""
        try:
            module, _, name = reference.partition(":")
            self.planner, facts = getattr(importlib.import_module(module), name)(**given)
            use_one_thread()
            return ["built", facts.model_dump_json(), _list_abilities(self.planner)]
        except InputError as error:
            return ["refused", str(error), _sanitise_text(f"in the process of the planner:\n{traceback.format_exc()}")]

    def begin_run(self) -> list[Any]:
        """Forget everything."""
        cast("Any", self.planner).begin_run()
        return ["done"]

    def reset(self, seed: int | None, scene: SceneInfo) -> list[Any]:
        """Begin a scene; with a seed, generators of this process begin there."""
        if seed is not None:
            seed_everything(seed)
            seed_torch_on_import(seed)
        self._planner.reset(scene)
        return ["done"]

    def loaded(self) -> list[Any]:
        """Code that this process has loaded."""
        return ["loaded", hash_loaded_code()]

    def tell(self, method: str, what: Any) -> list[Any]:
        """``reveal`` or ``follow``."""
        getattr(self._planner, method)(what)
        return ["done"]

    def plan(self, packed: Sequence[Any], ready: dict[str, tuple[int, tuple[int, ...], bool]]) -> list[Any]:
        """Plan; pictures that are not ready are asked for when the planner looks."""
        self._ready, self._looked = ready, {}
        observation = self._unpacking.unpack(packed, partial(self.picture, self.number))
        try:
            plan = self._planner.plan(observation)
        except FAILURES as error:
            if isinstance(observation.views, NoViews) and observation.views.looked:
                return ["raised unseeing", *_describe_error(error)]
            raise
        left, self._ready = self._ready, {}
        self.viewer.release_unread(place for place, _, _ in left.values())
        if not isinstance(plan, Plan):
            return ["no plan", type(plan).__name__]
        return ["plan", _plain_plan(plan), list(self._looked)]

    def picture(self, number: int, name: str) -> NDArray[np.uint8]:
        """A picture of the sample that is being planned, which the other process reads."""
        if os.getpid() != self._process:
            raise RuntimeError("pictures can be loaded in the process that plan was called in, not in a fork of it")
        with self._asking:
            if number != self.number:
                raise RuntimeError("the sample is over: its pictures can be loaded while plan is under way")
            self._looked[name] = None
            reply = self._ready.pop(name, None)
            if reply is None:
                self.stream.sendall(encode_answer(number, [self.viewer.collect_released(), ["picture", name]]))
                _, kind, parts = receive_question(self.stream)
                if kind == "broken":
                    raise PictureError(*parts)
                reply = parts
        place, shape, writable = reply
        return self.viewer.look(place, shape, writable=writable)

    @property
    def _planner(self) -> Planner:
        assert self.planner is not None
        return self.planner


_KINDS: Final[dict[str, Callable[..., list[Any]]]] = {
    "build": PlannerRequestHandler.build,
    "begin_run": PlannerRequestHandler.begin_run,
    "reset": PlannerRequestHandler.reset,
    "loaded": PlannerRequestHandler.loaded,
    "tell": PlannerRequestHandler.tell,
    "plan": PlannerRequestHandler.plan,
}


def _list_abilities(planner: Planner) -> dict[str, bool]:
    return {
        "reveal": isinstance(planner, PrivilegedPlanner),
        "follow": hasattr(planner, "follow"),
        "begin_run": hasattr(planner, "begin_run") and hasattr(planner, "memory_crosses_scenes"),
        "memory_crosses_scenes": bool(getattr(planner, "memory_crosses_scenes", False)),
        "reads_message_after": reads_message_after(planner),
    }


def _plain_plan(plan: Plan) -> dict[str, Any]:
    forecasts = plan.forecasts
    return {
        "waypoints": _plain(plan.waypoints),
        "frame": str(plan.frame.value),
        "modes": _plain(plan.modes),
        "mode_scores": _plain(plan.mode_scores),
        "forecasts": None
        if forecasts is None
        else {
            forecast_field.name: _plain(getattr(forecasts, forecast_field.name)) for forecast_field in fields(Forecasts)
        },
    }


def _plain(value: Any) -> Any:
    """Arrays and plain values as they are, tensors as arrays."""
    if value is None or isinstance(value, np.ndarray | np.generic | list | tuple | int | float):
        return value
    return np.asarray(value)


def _encode_or_report(number: int, answered: list[Any]) -> bytes:
    try:
        return encode_answer(number, answered)
    except (UnencodableValueError, TypeError, ValueError, RecursionError, MemoryError) as error:
        why = f"{type(error).__name__}: the answer cannot be sent: {to_one_line(error)}"
        return encode_answer(number, [answered[0], ["raised", why, why]])


def _describe_error(error: BaseException) -> tuple[str, str]:
    """The exception in one line and as a traceback, even if its own text cannot be produced."""
    try:
        text = _sanitise_text(format_traceback())
    except BaseException:
        text = f"{type(error).__name__}: its traceback cannot be printed"
    try:
        line = _sanitise_text(to_one_line("".join(traceback.format_exception_only(error))))
    except BaseException:
        line = type(error).__name__
    return line, text


def _sanitise_text(text: str) -> str:
    """Text that can be encoded, cut to a readable length."""
    sound = text.encode(errors="backslashreplace").decode()
    half = _LONGEST_TEXT // 2
    return sound if len(sound) <= _LONGEST_TEXT else f"{sound[:half]}\n  ...\n{sound[-half:]}"
