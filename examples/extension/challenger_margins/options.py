"""Options that ``eval``, ``drive`` and ``generate`` show in a panel of this extension."""

from dataclasses import dataclass
from typing import Annotated

from benchmark.cli.settings import Option


@dataclass(frozen=True, slots=True, kw_only=True)
class EasingOptions:
    """Options of the planner ``easing``."""

    easing_m_s2: Annotated[float, Option("easing: how hard it brakes, m/s^2.", min=0.0, max=10.0)] = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlineOptions:
    """Options of the renderer ``outline``."""

    outline_px: Annotated[int, Option("outline: width of the lines, pixels.", min=1, max=20)] = 1
