"""Options of policies at ``grpc://``, and of ``serve --protocol alpasim``."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

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
