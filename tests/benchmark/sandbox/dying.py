"""A planner that dies in as many ways as scenes have names, for tests; built in processes of its own."""

import ctypes
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from benchmark.planning import Forecasts, Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.run_schema import PlannerFacts

AT: Final = 2
"""Sample at which it dies."""


class Wordless(Exception):
    """Has no words, and not even that can be asked."""

    def __str__(self) -> str:
        raise RuntimeError("not have")

    __repr__ = __str__


class Own(BaseException):
    """No `Exception`."""


def raising(error: BaseException) -> NoReturn:
    raise error


def spin() -> NoReturn:
    while True:
        pass


def deaf() -> None:
    """Hangs, and no signal that can be caught ends it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP})
    time.sleep(1000.0)


def close_streams() -> None:
    for each in (0, 1, 2):
        os.close(each)


def say_much() -> None:
    os.write(1, b"planners print\n" * 1000)
    print("more")


def connection() -> int:
    """Descriptor of the connection, which nobody told it: the socket that is there."""
    return next(int(each.name) for each in Path("/proc/self/fd").iterdir() if _is_socket(each))


def _is_socket(link: Path) -> bool:
    try:
        return link.readlink().name.startswith("socket:")
    except OSError:
        return False


def answer_before_it_is_asked() -> None:
    """What the last question was answered with, once more: whoever takes it is an answer behind for ever."""
    from benchmark.sandbox.frames import encode_answer

    os.write(connection(), encode_answer(1, ["done"]))


def outliving(notes: Path) -> None:
    """Starts somebody who wants to outlive it."""
    child = subprocess.Popen(["sleep", "1000"], start_new_session=True)
    (notes / f"outliving-{child.pid}").touch()


def leave_a_process(notes: Path) -> None:
    outliving(notes)
    os._exit(1)


def return_twice() -> None:
    os.fork()


def leave_a_copy(notes: Path) -> None:
    """A copy of a copy, as daemons are made."""
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            (notes / f"copy-{os.getpid()}").touch()
            time.sleep(1000.0)
        os._exit(0)


WAYS: Final[dict[str, Callable[[Path], Any]]] = {
    "spins": lambda _: spin(),
    "deaf": lambda _: deaf(),
    "segmentation-fault": lambda _: ctypes.string_at(0),
    "leaves": lambda _: os._exit(0),
    "leaves-with-3": lambda _: os._exit(3),
    "kills-itself": lambda _: os.kill(os.getpid(), signal.SIGKILL),
    "closes-everything": lambda _: os.closerange(0, 256),
    "talks-nonsense": lambda _: os.write(connection(), b"x" * 64),
    "answers-before": lambda _: answer_before_it_is_asked(),
    "leaves-a-process": leave_a_process,
    "raises": lambda _: raising(ValueError("no idea")),
    "exits": lambda _: sys.exit(0),
    "interrupts": lambda _: raising(KeyboardInterrupt()),
    "own-base-exception": lambda _: raising(Own("mine")),
    "wordless": lambda _: raising(Wordless()),
    "wordy": lambda _: raising(ValueError("\ud800" + "long " * 100_000)),
    "takes-memory": lambda _: np.ones(1 << 31, np.uint8),
    "recursion": lambda _: (lambda f: f(f))(lambda f: f(f)),
    "returns-none": lambda _: None,
    "too-much": lambda _: None,
    "no-numbers": lambda _: None,
    "closes-streams": lambda _: close_streams(),
    "prints": lambda _: say_much(),
    "forks": lambda _: return_twice(),
    "leaves-a-copy": leave_a_copy,
    "starts-a-process": outliving,
}


class Dying:
    """Plans that say of which sample they are, and dies at one as the scene is called."""

    name = "dying"
    settings: dict[str, Any] = {"colour": "black"}  # noqa: RUF012 - as strangers write it

    def __init__(self, notes: Path) -> None:
        self._notes = notes
        (notes / f"planner-{os.getpid()}").touch()
        self._scene = ""

    def reset(self, scene: SceneInfo) -> None:
        self._scene = scene.name
        if scene.name == "dies-in-reset":
            os._exit(7)

    def plan(self, observation: Observation) -> Plan:
        waypoints = np.column_stack([np.full(6, float(observation.index)), np.arange(6.0)])
        if observation.index == AT and self._scene in WAYS:
            WAYS[self._scene](self._notes)
            if self._scene == "returns-none":
                return None  # type: ignore[return-value]
            if self._scene == "too-much":
                return Plan(waypoints, PlanFrame.EGO, modes=np.zeros((10_000_000, 6, 2), np.float32))
            if self._scene == "no-numbers":
                return Plan(waypoints, PlanFrame.EGO, modes=np.array([object()]))
        return Plan(waypoints, PlanFrame.EGO)


class Silent(Dying):
    """Hangs so that nothing else of its process goes on."""

    def plan(self, observation: Observation) -> Plan:
        if observation.index == AT and self._scene == "holds-the-lock":
            ctypes.PyDLL(None).pause()
        if observation.index == AT and self._scene == "is-stopped":
            os.kill(os.getpid(), signal.SIGSTOP)
        return super().plan(observation)


class Drawing:
    """Draws from every global generator, looks at pictures, keeps some and writes into them, and says all it can."""

    name = "drawing"

    def __init__(self) -> None:
        self._kept: list[Any] = []

    def reset(self, scene: SceneInfo) -> None:
        self._kept = []

    def plan(self, observation: Observation) -> Plan:
        for view in observation.views.values():
            picture = view.load()
            self._kept.append(picture)
            if picture.flags.writeable:
                picture[0, 0] = 7
        del self._kept[:-8]
        seen = sum(float(each.sum(dtype=np.float64)) * (place + 1) for place, each in enumerate(self._kept)) % 100.0
        drawn = np.random.normal(0.0, 1.0, (3, 6, 2)).astype(np.float32)
        forecasts = Forecasts(
            boxes=np.array([[5.0, 1.0, 4.0, 2.0, 0.1]]),
            trajectories=np.full((1, 2, 6, 2), random.random()),
            scores=np.array([[0.25, 0.75]], np.float32),
        )
        return Plan(drawn[0] + np.float32(seen), PlanFrame.LIDAR, drawn, [0.1, 0.2, 0.7], forecasts)  # type: ignore[arg-type]


class LoadsElsewhere(Drawing):
    """Loads its pictures in threads, and one more when the sample is over."""

    name = "loads-elsewhere"

    def __init__(self) -> None:
        super().__init__()
        self._build_late_error: list[Any] = []

    def plan(self, observation: Observation) -> Plan:
        found: dict[str, float] = {}

        def load(name: str) -> None:
            found[name] = float(observation.views[name].load().mean())

        threads = [threading.Thread(target=partial(load, name)) for name in observation.views]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
        assert len(found) == len(observation.views)
        late, self._build_late_error = self._build_late_error, [view.load for view in observation.views.values()]
        refused = 0
        for again in late:
            try:
                again()
            except RuntimeError:
                refused += 1
        return Plan(np.full((6, 2), sum(found.values()) + 1000.0 * refused), PlanFrame.EGO)


MADE: Final = {each.__name__: each for each in (Dying, Silent, Drawing, LoadsElsewhere)}


def made(kind: str, **given: Any) -> tuple[Any, PlannerFacts]:
    """A planner and who it is."""
    planner: Any = MADE[kind](**given)
    return planner, PlannerFacts(name=planner.name, privileged=False)
