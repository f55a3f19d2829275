"""Options of policies at ``grpc://``, and of ``serve`` in AlpaSim's protocols."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from benchmark.cli.settings import Option


@dataclass(frozen=True, slots=True, kw_only=True)
class EgodriverOptions:
    """Options of ``drive`` and ``eval`` with a policy at ``grpc://``."""

    RARE: ClassVar = ("remote_cameras",)

    remote_cameras: Annotated[
        str, Option("The policy's names of our cameras: CAM_FRONT=camera_front_wide_120fov,...", "Planner")
    ] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlpasimServeOptions:
    """Options of ``serve`` for AlpaSim's protocol."""

    cameras: Annotated[
        str, Option("The simulator's names of nuScenes' cameras: CAM_FRONT=camera_front_wide_120fov,...", "Planner")
    ] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlpasimTrafficOptions:
    """Options of ``serve`` for AlpaSim's traffic; the adversary always knows motion only."""

    traffic: Annotated[
        Literal["adversary", "replay", "idm"],
        Option("One challenges the ego, or all keep to the log, or keep distance.", "Search"),
    ] = "adversary"
    adversary: Annotated[
        str, Option("Who challenges, by its object_id; chosen at hand-over if not given.", "Search")
    ] = ""
    adversary_others: Annotated[
        Literal["replay", "idm"], Option("adversary: how everybody else behaves.", "Search")
    ] = "replay"
    adversary_every: Annotated[float, Option("adversary: seconds between its plans, at most 3.", "Search")] = 1.0
    adversary_budget: Annotated[
        Literal["quick", "full"],
        Option("adversary: 3 rounds of 96 candidates, or the 5 of 256 that drive has.", "Search"),
    ] = "quick"
    maps: Annotated[
        str, Option("Data set whose scenes sessions name; roads are estimated from tracks if not given.", "Input")
    ] = ""
    sessions: Annotated[Path | None, Option("Data set to which each session is added when it is over.", "Output")] = (
        None
    )
