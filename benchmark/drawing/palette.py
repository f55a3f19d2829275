"""Colours and line patterns of pictures of scenes; nothing is told apart by colour alone."""

from dataclasses import dataclass
from typing import Final

Rgb = tuple[int, int, int]

LAND: Final[Rgb] = (243, 242, 237)
ROAD: Final[Rgb] = (205, 207, 211)
KERB: Final[Rgb] = (164, 166, 170)
WALKWAY: Final[Rgb] = (229, 223, 211)
CAR_PARK: Final[Rgb] = (218, 219, 224)
CROSSING: Final[Rgb] = (224, 226, 230)
STRIPE: Final[Rgb] = (250, 250, 250)
PAINT: Final[dict[str, Rgb]] = {"white": (252, 252, 252), "yellow": (236, 186, 44)}

EGO: Final[Rgb] = (0, 158, 115)
ADVERSARY: Final[Rgb] = (213, 74, 0)
VEHICLE: Final[Rgb] = (128, 142, 162)
CYCLE: Final[Rgb] = (96, 96, 132)
PERSON: Final[Rgb] = (92, 74, 66)
THING: Final[Rgb] = (172, 164, 148)

INK: Final[Rgb] = (34, 36, 40)
FAINT_INK: Final[Rgb] = (104, 108, 116)
PAPER: Final[Rgb] = (255, 255, 255)
PANEL: Final[Rgb] = (250, 250, 248)
RULE: Final[Rgb] = (216, 218, 222)
TITLE: Final[Rgb] = (34, 38, 46)
TITLE_INK: Final[Rgb] = (245, 246, 248)
TITLE_FAINT: Final[Rgb] = (176, 182, 192)
CONTACT: Final[Rgb] = (176, 0, 32)

BEST, WORST = (68, 1, 84), (190, 214, 90)
"""Ends of the scale of candidates: the lower the score, the better, the darker."""

Dash = tuple[float, ...]
"""Lengths of strokes and gaps in pixels, alternating; empty for a solid line."""


@dataclass(frozen=True, slots=True)
class PlannerStyle:
    """How one planner is drawn.

    Attributes:
        colour: Of everything that is its.
        dash: Pattern of its plan's line.
        mark: Shape at each waypoint: ``circle``, ``square``, ``triangle`` or ``diamond``.
    """

    colour: Rgb
    dash: Dash
    mark: str


_COLOURS: Final[tuple[Rgb, ...]] = (
    (0, 114, 178),
    (204, 92, 158),
    (230, 159, 0),
    (0, 0, 0),
    (86, 180, 233),
    (140, 109, 49),
)
"""Okabe and Ito's without those of ego and adversary; the purple darker and the yellow brown, to be seen on a road."""
_DASHES: Final[tuple[Dash, ...]] = ((), (9.0, 4.0), (3.0, 4.0), (11.0, 4.0, 3.0, 4.0))
_MARKS: Final = ("circle", "square", "triangle", "diamond")


def planner_style(index: int) -> PlannerStyle:
    """The style of the planner that stands at a place of a list; they repeat after twelve.

    Args:
        index: Its place, from 0.

    Returns:
        The style.
    """
    return PlannerStyle(_COLOURS[index % len(_COLOURS)], _DASHES[index % len(_DASHES)], _MARKS[index % len(_MARKS)])


def mixed(first: Rgb, second: Rgb, share: float) -> Rgb:
    """A colour between two.

    Args:
        first: At share 0.
        second: At share 1.
        share: Where between.

    Returns:
        The colour.
    """
    return (
        round(first[0] + share * (second[0] - first[0])),
        round(first[1] + share * (second[1] - first[1])),
        round(first[2] + share * (second[2] - first[2])),
    )
