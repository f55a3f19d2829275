"""The picture of a transfer matrix: always the same bytes, readable, safe with any name."""

import io
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from benchmark.drawing.plots import DARK
from benchmark.errors import InputError
from benchmark.metrics.transfer import TransferMatrix, transfer
from leaderboard.figures.heat_map import COLOURS, heat_map, heat_maps, relative_luminance, text_colour, write_heat_map
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
    first = heat_map(matrix, suffix)
    with mpl.rc_context({"font.size": 30, "savefig.facecolor": "red", "svg.hashsalt": "other", "text.color": "green"}):
        before = dict(mpl.rcParams)
        assert heat_map(matrix, suffix) == first
        assert dict(mpl.rcParams) == before
    assert heat_map(matrix_of("a", "c"), suffix) != first


def test_pictures_made_together_are_those_one_by_one() -> None:
    matrix = matrix_of("a", "b", "c")
    assert heat_maps(matrix) == (heat_map(matrix, ".png"), heat_map(matrix, ".svg"), heat_map(matrix, ".svg", DARK))


def test_text_stands_out_on_every_colour_and_lightness_alone_tells_the_order() -> None:
    colours = mpl.colormaps[COLOURS](np.linspace(0, 1, 101))[:, :3]
    lightness = [relative_luminance(colour) for colour in colours]
    assert (np.diff(lightness) > 0).all()
    for colour, own in zip(colours, lightness):
        other = {"white": 1.0, "black": 0.0}[text_colour(colour)]
        assert (max(own, other) + 0.05) / (min(own, other) + 0.05) >= 4.5


@pytest.mark.parametrize("count", [1, 2, 12])
def test_every_number_of_planners_can_be_drawn(count: int) -> None:
    picture = imread(io.BytesIO(heat_map(matrix_of(*(f"planner-{index}" for index in range(count))), ".png")))
    assert picture.shape[0] > 80 * count and picture.shape[1] > 80 * count
    assert picture[..., :3].std() > 0.05


def test_names_from_strangers_are_only_text() -> None:
    names = ("$x_{1$ \\frac", "<script>&--", "a\x00b\nc\ud800", "日本語", "x" * 500, "†", "")
    text = heat_map(matrix_of(*names), ".svg").decode()
    assert "<script" not in text
    ElementTree.fromstring(text)
    assert heat_map(matrix_of(*names), ".png").startswith(b"\x89PNG")


def test_a_file_is_written_or_refused_in_a_sentence(tmp_path: Path) -> None:
    matrix = matrix_of("a", "b")
    write_heat_map(matrix, tmp_path / "new" / "figure.svg")
    assert (tmp_path / "new" / "figure.svg").read_bytes() == heat_map(matrix, ".svg")
    with pytest.raises(InputError, match=r"figure\.pdf: name a file that ends in \.png or \.svg"):
        write_heat_map(matrix, tmp_path / "figure.pdf")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        write_heat_map(matrix, tmp_path / "file" / "figure.png")
