"""A planner asked for one plan of a drive: what it raises, answers wrongly or takes too long for is a failure.

A failure has a reason of one word, which tables count, and a text. It is never scored.
"""

import contextlib
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from types import FrameType
from typing import Final

import numpy as np

from benchmark.machine.metering import Meter
from benchmark.planning import (
    CameraView,
    NoViews,
    NoViewsError,
    Observation,
    Plan,
    Planner,
    PlannerFailedError,
    PlannerGoneError,
    PlannerLateError,
    PlannerLostError,
    SupervisedPlanner,
    reads_message_after,
)
from benchmark.runs.plan_rows import FAILURES, BrokenImageError, format_failure, wrap_image_loader
from benchmark.untrusted.files import to_one_line

DEFAULT_TIMEOUT_S: Final = 120.0
"""For one plan; no car drives with so old a plan, so that this ends what hangs."""

LONGEST_TIMEOUT_S: Final = 86_400.0
"""Timers know no infinity."""


class FailureReason(StrEnum):
    """Why a drive failed."""

    RAISED = "raised"
    NO_PLAN = "no plan"
    UNUSABLE = "unusable plan"
    TIMEOUT = "timeout"
    DIED = "died"


@dataclass(frozen=True, slots=True)
class Failure:
    """Reason why there is no plan, in a word, and the error or fault in full."""

    reason: FailureReason
    text: str


class PlanTimeoutError(BaseException):
    """Raised inside a planner that takes too long; no `Exception`, so that a planner's own ``except`` lets it pass."""


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Interrupt code that takes longer by a `PlanTimeoutError`; what does not return to Python is late all the same."""
    started = time.monotonic()
    if threading.current_thread() is not threading.main_thread():
        # Only the main thread is interrupted by signals.
        yield
        _require_in_time(started, seconds)
        return

    def late(number: int, frame: FrameType | None) -> None:
        raise PlanTimeoutError

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    _require_in_time(started, seconds)


def request_plan(
    planner: Planner, observation: Observation, timeout_s: float, meter: Meter | None = None
) -> Plan | Failure:
    """Ask for a plan; why there is none, if there is none.

    A picture that cannot be had (`BrokenImageError`) and a planner elsewhere that cannot be asked (`PlannerGoneError`)
    are not the planner's fault. One that fails after it looked for images that no sensor makes is refused
    (`NoViewsError`).
    """
    views = _wrap_loaders(observation.views)
    ego = observation.ego if reads_message_after(planner) else replace(observation.ego, can_motion_after=None)
    try:
        # Stdout belongs to the command (--json); what a planner prints goes to stderr.
        timed = contextlib.nullcontext() if meter is None else meter.call()
        with contextlib.redirect_stdout(sys.stderr), _time_limit_of(planner, timeout_s), timed:
            plan = planner.plan(replace(observation, views=views, ego=ego))
    except PlanTimeoutError:
        return Failure(FailureReason.TIMEOUT, f"no plan within {timeout_s:g} s")
    except (BrokenImageError, PlannerGoneError):
        raise
    except PlannerLateError as error:
        return Failure(FailureReason.TIMEOUT, str(error))
    except FAILURES as failure:
        if getattr(failure, "looked", False) or (isinstance(views, NoViews) and views.looked):
            raise NoViewsError(
                f"{planner.name} needs images, and --sensor none provides none (it raised {_name_failure(failure)}); "
                "add --sensor schematic"
            ) from failure
        return _to_failure(failure)
    if not isinstance(plan, Plan):
        answer_type = type(plan).__name__
        return Failure(
            FailureReason.NO_PLAN,
            f"{planner.name} returned {answer_type}; a planner must return benchmark.planning.Plan",
        )
    # A plan is checked at construction; its numbers may have been changed since.
    if not np.isfinite(plan.waypoints).all():
        return Failure(FailureReason.UNUSABLE, "a plan's waypoints must be finite, but this plan has NaN or infinity")
    return plan


def _wrap_loaders(views: dict[str, CameraView]) -> dict[str, CameraView]:
    if isinstance(views, NoViews):
        return views
    return {name: replace(view, load=wrap_image_loader(view.load)) for name, view in views.items()}


def _name_failure(failure: BaseException) -> str:
    """What was raised, in a line."""
    if isinstance(failure, PlannerFailedError):
        return to_one_line(failure)
    return to_one_line("".join(traceback.format_exception_only(failure)))


def notify_planner(planner: Planner, tell: Callable[[], None], timeout_s: float) -> Failure | None:
    """Tell a planner something; why it failed, if it did, unless it cannot be told or refuses the rig's views."""
    try:
        with contextlib.redirect_stdout(sys.stderr), _time_limit_of(planner, timeout_s):
            tell()
    except PlanTimeoutError:
        return Failure(FailureReason.TIMEOUT, f"the call did not return within {timeout_s:g} s")
    except (NoViewsError, PlannerGoneError):
        raise
    except PlannerLateError as error:
        return Failure(FailureReason.TIMEOUT, str(error))
    except FAILURES as failure:
        return _to_failure(failure)
    return None


def _time_limit_of(planner: Planner, timeout_s: float) -> contextlib.AbstractContextManager[None]:
    """The time limit of a call; a planner in a subprocess has its own, enforced by killing the subprocess."""
    return contextlib.nullcontext() if isinstance(planner, SupervisedPlanner) else time_limit(timeout_s)


def _to_failure(failure: BaseException) -> Failure:
    """The exception that is being handled, as the failure of a plan."""
    if isinstance(failure, PlannerLostError):
        return Failure(FailureReason.TIMEOUT if failure.late else FailureReason.DIED, failure.text)
    return Failure(FailureReason.RAISED, format_failure(failure))


def _require_in_time(started: float, seconds: float) -> None:
    if time.monotonic() - started > seconds:
        raise PlanTimeoutError
