"""Colours and line patterns of pictures of scenes; nothing is told apart by colour alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

Rgb = tuple[int, int, int]

EGO: Final[Rgb] = (0, 158, 115)
ADVERSARY: Final[Rgb] = (213, 74, 0)
"""In every picture, film, figure and page, light or dark: its contrast is 3.9 on both grounds and 2.4 or more on both
roads, where it has an edge besides; white letters on it have 4.4. No planner's colour is near it."""
PATH: Final[Rgb] = (118, 190, 168)
"""Where the recorded ego went beside one that was driven: its colour, faint."""
INK: Final[Rgb] = (34, 36, 40)
FAINT_INK: Final[Rgb] = (104, 108, 116)
PAPER: Final[Rgb] = (255, 255, 255)
PANEL: Final[Rgb] = (250, 250, 248)
RULE: Final[Rgb] = (216, 218, 222)
TITLE: Final[Rgb] = (34, 38, 46)
TITLE_INK: Final[Rgb] = (245, 246, 248)
TITLE_FAINT: Final[Rgb] = (176, 182, 192)
CONTACT: Final[Rgb] = (176, 0, 32)
BYSTANDER: Final[Rgb] = (84, 92, 112)
"""Contacts that the adversary has no part in; their marks are hollow."""


@dataclass(frozen=True, slots=True)
class GroundColours:
    """Colours of everything but ego, adversary and plans, on a light or a dark page.

    ``land`` is where there is no road, pavement or car park, ``kerb`` the road's edge. ``cycle`` has two-wheelers,
    ``person`` animals too, ``thing`` all else; ``ink`` is for edges, ``paper`` for those of small things.
    """

    land: Rgb
    road: Rgb
    kerb: Rgb
    walkway: Rgb
    car_park: Rgb
    crossing: Rgb
    stripe: Rgb
    paint: Mapping[str, Rgb]
    vehicle: Rgb
    cycle: Rgb
    person: Rgb
    thing: Rgb
    ink: Rgb
    paper: Rgb


ON_LIGHT: Final = GroundColours(
    land=(243, 242, 237),
    road=(205, 207, 211),
    kerb=(164, 166, 170),
    walkway=(229, 223, 211),
    car_park=(218, 219, 224),
    crossing=(224, 226, 230),
    stripe=(250, 250, 250),
    paint={"white": (252, 252, 252), "yellow": (236, 186, 44)},
    vehicle=(128, 142, 162),
    cycle=(96, 96, 132),
    person=(92, 74, 66),
    thing=(172, 164, 148),
    ink=INK,
    paper=PAPER,
)
ON_DARK: Final = GroundColours(
    land=(25, 28, 31),
    road=(58, 62, 68),
    kerb=(93, 99, 107),
    walkway=(42, 43, 43),
    car_park=(49, 53, 59),
    crossing=(66, 71, 78),
    stripe=(92, 98, 106),
    paint={"white": (141, 147, 155), "yellow": (165, 122, 28)},
    vehicle=(135, 150, 173),
    cycle=(154, 154, 198),
    person=(208, 179, 164),
    thing=(125, 119, 107),
    ink=(241, 243, 245),
    paper=(16, 18, 20),
)

PATH_DASH: Final = (5.0, 6.0)
BEST, WORST = (68, 1, 84), (190, 214, 90)
"""Ends of the scale of candidates: the lower the score, the better, the darker."""

Dash = tuple[float, ...]
"""Lengths of strokes and gaps in pixels, alternating; empty for a solid line."""


@dataclass(frozen=True, slots=True)
class PlannerStyle:
    """Style of one planner; ``mark`` is a ``circle``, ``square``, ``triangle`` or ``diamond`` at each waypoint."""

    colour: Rgb
    dash: Dash
    mark: str


PLANNERS_ON_LIGHT: Final[tuple[Rgb, ...]] = (
    (0, 114, 178),
    (204, 92, 158),
    (184, 160, 0),
    (0, 0, 0),
    (86, 180, 233),
    (140, 109, 49),
)
"""Okabe and Ito's without those of ego and adversary; the purple darker, the orange a gold that is not taken for the
adversary, and the yellow brown, to be seen on a road."""
PLANNERS_ON_DARK: Final[tuple[Rgb, ...]] = (
    (74, 163, 223),
    (229, 143, 192),
    (222, 200, 60),
    (255, 255, 255),
    (143, 211, 255),
    (201, 168, 106),
)
"""The same on black."""
_DASHES: Final[tuple[Dash, ...]] = ((), (9.0, 4.0), (3.0, 4.0), (11.0, 4.0, 3.0, 4.0))
_MARKS: Final = ("circle", "square", "triangle", "diamond")


def choose_planner_style(index: int) -> PlannerStyle:
    """Style of the planner at a place of a list, from 0; they repeat after twelve."""
    return PlannerStyle(
        PLANNERS_ON_LIGHT[index % len(PLANNERS_ON_LIGHT)], _DASHES[index % len(_DASHES)], _MARKS[index % len(_MARKS)]
    )


def mix_colours(first: Rgb, second: Rgb, share: float) -> Rgb:
    """A colour between two: the first at share 0, the second at share 1."""
    return (
        round(first[0] + share * (second[0] - first[0])),
        round(first[1] + share * (second[1] - first[1])),
        round(first[2] + share * (second[2] - first[2])),
    )


def format_hexadecimal(colour: Rgb) -> str:
    """A colour as plots and pages take it, for example ``#d54a00``."""
    red, green, blue = colour
    return f"#{red:02x}{green:02x}{blue:02x}"
