"""A drive as it is drawn: the world as it was driven, each instant's plan, the recorded path, the contact."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.encounter_window import EncounterWindow
from benchmark.records.scene_pages import PageAgent, StoredScenePage
from benchmark.records.search_trace import SearchTraceFrame
from benchmark.report.fault_words import describe_fault
from benchmark.report.overlays import (
    CandidatesOverlay,
    CollisionMark,
    PathOverlay,
    PlanOverlay,
    PlanVerdict,
    rank_candidates,
)
from benchmark.report.palette import PlannerStyle
from benchmark.report.placement import PlacedPlan, frame_seconds

STRIP_S: Final = 3.0
"""Time to collision at which its strip is empty."""
STEP_S: Final = 0.5
"""Of a strip."""
PLAN_VISIBLE_S: Final = 3.0
"""A contact is announced so long before."""


@dataclass(frozen=True, slots=True)
class EpisodePage:
    """Everything that is shown of one drive.

    Attributes:
        stored: Sheet of the world as it was driven; its pictures are what the planner saw.
        begins: Frame from which plans were driven; before it the ego is the recorded one.
        plans: By the frame at which each was made; ``None`` of one that is too short to be drawn.
        recorded: (T, 2) centres of the recorded ego's body at the scene's frames.
        recorded_speed: (T,) its speed, m/s.
        recorded_seconds: (T,) times of both after the sheet's first frame.
        speed: (F,) of the driven ego at the sheet's frames, m/s.
        contact: The first, in the sheet's metres and seconds after the sheet's first frame.
        considered: What an adversary considered, where that was kept.
    """

    stored: StoredScenePage
    row: EpisodeRow
    begins: int
    plans: dict[int, PlacedPlan | None]
    recorded: Floats
    recorded_speed: Floats
    recorded_seconds: Floats
    speed: Floats
    contact: CollisionMark | None
    considered: tuple[SearchTraceFrame, ...] = ()

    @property
    def seconds(self) -> Floats:
        """(F,) time of each frame since the first."""
        return frame_seconds(self.stored.sheet)

    @property
    def last(self) -> int:
        """Frame at which the drive is over: the first that does not come before the contact, or the last one."""
        end = len(self.seconds) - 1
        if self.contact is None:
            return end
        return min(int(np.searchsorted(self.seconds, self.contact.seconds - 1e-6)), end)

    def path(self) -> PathOverlay:
        """The recorded path."""
        return PathOverlay(self.recorded)

    def search_trace_at(self, frame: int) -> SearchTraceFrame | None:
        """The planning frame of the adversary that is in force at a frame of the sheet, where it was kept."""
        now_us = self.stored.sheet.timestamps_us[frame]
        past = [trace_frame for trace_frame in self.considered if trace_frame.time_us <= now_us]
        return past[-1] if past else None

    def candidates_at(self, frame: int) -> CandidatesOverlay | None:
        """Candidates of the adversary at the planning frame in force; ``None`` where it did not search."""
        trace_frame = self.search_trace_at(frame)
        if trace_frame is None or not trace_frame.candidates:
            return None
        paths = np.array(trace_frame.candidates, np.float64) - np.array(self.stored.sheet.origin_m)
        return rank_candidates(paths, trace_frame.scores, trace_frame.chosen)

    def plan_at(self, frame: int, name: str, style: PlannerStyle) -> PlanOverlay | None:
        """The last plan that was made, or ``None`` before the first, and the contact that comes, if it comes soon."""
        planned_at = max((planned_frame for planned_frame in self.plans if planned_frame <= frame), default=None)
        if planned_at is None:
            return None
        time_s, plan_time_s = float(self.seconds[frame]), float(self.seconds[planned_at])
        contact, soon = None, self.contact
        if soon is not None and soon.seconds - time_s <= PLAN_VISIBLE_S:
            contact = replace(soon, seconds=soon.seconds - plan_time_s)
        verdict = PlanVerdict(contact is not None, "", "", counted=False)
        return PlanOverlay(name, style, self.plans[planned_at], contact, verdict, age_s=time_s - plan_time_s)


@dataclass(frozen=True, slots=True)
class StripStep:
    """Half a second of the strip below a drive: from ``start_s`` to ``end_s``, the smallest time to collision."""

    start_s: float
    end_s: float
    ttc_s: float

    @property
    def share(self) -> float:
        """0 without danger to 1 at a contact."""
        return 1.0 - self.ttc_s / STRIP_S


def list_strip_steps(row: EpisodeRow, begins_s: float) -> list[StripStep]:
    """Half seconds of a drive in a window with a time to collision; ``begins_s`` is when driving begins."""
    steps = (
        (begins_s + STEP_S * number, ttc) for number, ttc in enumerate(row.ttc_s) if ttc is not None and ttc < STRIP_S
    )
    return [StripStep(start, start + STEP_S, ttc) for start, ttc in steps]


def list_touches(row: EpisodeRow, begins_s: float) -> list[tuple[float, str, bool]]:
    """When the ego touched whom, and whether that was the adversary; seconds and words."""
    return [
        (
            begins_s + touch.seconds,
            f"{'the adversary' if touch.adversary else touch.category}, {describe_fault(touch)}",
            touch.adversary,
        )
        for touch in row.touches
    ]


def mark_from_departure(
    agents: Iterable[PageAgent], window: EncounterWindow | None, seconds: Floats
) -> Iterator[PageAgent]:
    """Agents of a sheet, those of a window as others until it departs and as adversaries from then on.

    ``seconds`` are (F,) of the sheet's frames.
    """
    for agent in agents:
        if window is None or agent.id not in window.adversaries:
            yield agent
            continue
        departs_s = 0.0 if window.departs_s is None else window.departs_s
        at = max(int(np.searchsorted(seconds, departs_s - 1e-3)) - agent.first, 0)
        before, after = (
            {name: getattr(agent, name)[part] for name in ("x_m", "y_m", "yaw_rad")}
            for part in (slice(at), slice(at, None))
        )
        if before["x_m"]:
            yield agent.model_copy(update={**before, "adversary": False})
        yield agent.model_copy(update={**after, "adversary": True, "first": agent.first + at})


def compute_speeds(points: Floats, seconds: Floats) -> Floats:
    """(T,) speeds in m/s of something that is at (T, 2) points in metres at (T,) rising times."""
    if len(points) < 2:
        return np.zeros(len(points))
    return np.asarray(np.hypot(*np.gradient(points, seconds, axis=0).T))
