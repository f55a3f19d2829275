"""The picture of a transfer matrix: always the same bytes, readable, safe with any name."""

import io
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from benchmark.errors import InputError
from benchmark.metrics.transfer import TransferMatrix, transfer
from benchmark.report.plots import DARK
from leaderboard.figures.heat_map import (
    AROUND_CHANCE,
    COLOURS,
    HeatMapCell,
    build_lift_cells,
    build_share_cells,
    choose_text_colour,
    compute_relative_luminance,
    draw_heat_map,
    draw_heat_maps,
    draw_lift_map,
    draw_lift_maps,
    write_heat_map,
    write_lift_map,
)  # fmt: skip
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made


def matrix_of(*names: str) -> TransferMatrix:
    """The first planner fails nothing, each further one a scene more."""
    return transfer(
        [
            hand_made(name, {f"s{index:02}": [HIT if index < count else CLEAN] for index in range(12)})
            for count, name in enumerate(names)
        ]
    )


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_same_matrix_gives_the_same_bytes_whatever_the_users_settings(suffix: str) -> None:
    matrix = matrix_of("a", "b")
    first = draw_heat_map(matrix, suffix)
    with mpl.rc_context({"font.size": 30, "savefig.facecolor": "red", "svg.hashsalt": "other", "text.color": "green"}):
        before = dict(mpl.rcParams)
        assert draw_heat_map(matrix, suffix) == first
        assert dict(mpl.rcParams) == before
    assert draw_heat_map(matrix_of("a", "c"), suffix) != first


def test_pictures_made_together_are_those_one_by_one() -> None:
    matrix = matrix_of("a", "b", "c")
    for draw, together in ((draw_heat_map, draw_heat_maps), (draw_lift_map, draw_lift_maps)):
        png, svg, dark = together(matrix)
        assert (png, svg, dark()) == (draw(matrix, ".png"), draw(matrix, ".svg"), draw(matrix, ".svg", DARK))


def attacked_by(*verdicts: str) -> TransferMatrix:
    """Planners by letters, one scene a letter: f touches the adversary first, F a bystander, . nobody."""
    records = []
    for place, letters in enumerate(verdicts):
        scenes = {f"s{number:02}": letter for number, letter in enumerate(letters)}
        records.append(told(attacked(f"planner-{place}", scenes, dict.fromkeys(scenes, True))))
    return transfer(records, adversary_only=True)


def texts(squares: list[list[HeatMapCell | None]]) -> list[list[tuple[str, str] | None]]:
    return [[None if one is None else (one.text, one.below) for one in row] for row in squares]


def test_shares_of_contacts_with_the_adversary_leave_bystanders_out() -> None:
    matrix = attacked_by("ffF...", "fFF.f.", "......")
    assert texts(build_share_cells(matrix)) == [
        [None, ("50 %", "1/2"), ("0 %", "0/2")],
        [("50 %", "1/2"), None, ("0 %", "0/2")],
        [None, None, None],
        [("33 %", "2/6"), ("33 %", "2/6"), ("0 %", "0/6")],
    ]
    drawn = draw_heat_map(matrix, ".svg").decode()
    assert "Contacts with the adversary" in drawn and "Failures on" not in drawn


def test_lift_stands_above_the_diagonal_phi_below_and_what_is_undefined_is_hatched() -> None:
    # Lift of the first two 1 * 6 / (2 * 2); phi (1 * 3 - 1 * 1) / (2 * 4).
    first, second, never = build_lift_cells(attacked_by("ffF...", "fFF.f.", "......"))
    assert first[0] is second[1] is never[2] is None
    assert first[1] is not None and first[1].text == "1.50×"
    assert second[0] is not None and second[0].text == "φ 0.25"
    assert (first[2], second[2], never[:2]) == (None, None, [None, None])


def test_only_numbers_whose_interval_leaves_chance_out_are_bold() -> None:
    matrix = attacked_by("ffffffff........", "fffffff.........", ".f.f.f.f.f.f.f.f", "........ffffffff")
    squares = build_lift_cells(matrix)
    bold = {(row, column) for row, cells in enumerate(squares) for column, one in enumerate(cells) if one and one.bold}
    assert bold == {(0, 1), (1, 0), (0, 3), (3, 0), (1, 3), (3, 1)}
    like = {(row, column) for row, column in bold if (one := squares[row][column]) and one.colour[0] > one.colour[2]}
    assert like == {(0, 1), (1, 0)}
    for row, column in ((0, 2), (2, 0)):
        cell = squares[row][column]
        assert cell is not None and cell.text in ("1.00×", "φ 0.00") and min(cell.colour) > 0.95
        assert cell.below.startswith("[") and cell.below.endswith("]")


def test_text_stands_out_on_every_colour_and_lightness_alone_tells_the_order() -> None:
    share, chance = (mpl.colormaps[name](np.linspace(0, 1, 101))[:, :3] for name in (COLOURS, AROUND_CHANCE))
    lightness = np.array([compute_relative_luminance(colour) for colour in share])
    assert (np.diff(lightness) > 0).all()
    for colour, own in zip(share, lightness):
        other = {"white": 1.0, "black": 0.0}[choose_text_colour(colour)]
        assert (max(own, other) + 0.05) / (min(own, other) + 0.05) >= 4.5
    # Colours around chance are lightest in the middle.
    lightness = np.array([compute_relative_luminance(colour) for colour in chance])
    assert (np.diff(lightness[:51]) > 0).all() and (np.diff(lightness[50:]) < 0).all()
    assert {choose_text_colour(colour) for colour in chance} == {"black", "white"}


@pytest.mark.parametrize("count", [1, 7])
@pytest.mark.parametrize("draw", [draw_heat_map, draw_lift_map])
def test_every_number_of_planners_can_be_drawn(draw: Callable[[TransferMatrix, str], bytes], count: int) -> None:
    picture = imread(io.BytesIO(draw(matrix_of(*(f"planner-{index}" for index in range(count))), ".png")))
    assert picture.shape[0] > 80 * count and picture.shape[1] > 80 * count
    assert picture[..., :3].std() > 0.05


def test_names_from_strangers_are_only_text() -> None:
    matrix = matrix_of("$x_{1$ \\frac", "<script>&--", "a\x00b\nc\ud800", "日本語", "x" * 500, "†", "")
    text = draw_heat_map(matrix, ".svg").decode()
    assert "<script" not in text
    ElementTree.fromstring(text)
    assert all(draw(matrix, ".png").startswith(b"\x89PNG") for draw in (draw_heat_map, draw_lift_map))


def test_a_file_is_written_or_refused_in_a_sentence(tmp_path: Path) -> None:
    matrix = matrix_of("a", "b")
    write_heat_map(matrix, tmp_path / "new" / "figure.svg")
    assert (tmp_path / "new" / "figure.svg").read_bytes() == draw_heat_map(matrix, ".svg")
    write_lift_map(matrix, tmp_path / "lift.svg")
    assert (tmp_path / "lift.svg").read_bytes() == draw_lift_map(matrix, ".svg")
    with pytest.raises(InputError, match=r"figure\.pdf: name a file that ends in \.png or \.svg"):
        write_heat_map(matrix, tmp_path / "figure.pdf")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        write_heat_map(matrix, tmp_path / "file" / "figure.png")
