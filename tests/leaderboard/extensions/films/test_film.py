"""Films: what is in a frame, what becomes of it on disk, and what is said when something is missing."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from benchmark.errors import InputError
from benchmark.records.run import RunRecord
from benchmark.report.overlays import CollisionParty
from benchmark.report.palette import ADVERSARY, CONTACT, EGO, TITLE
from leaderboard.extensions.films.film import HEIGHT_PX, TITLE_PX, WIDTH_PX, Film, FilmLayout, FilmSettings
from leaderboard.extensions.films.filming import FilmFormat, find_scene_page_folders, write_film
from leaderboard.extensions.films.panel import compute_adversary_gap
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, UNCOUNTED
from tests.benchmark.report.one_scene import FRAMES, broken_picture, record, sheet, written

SMALL = FilmSettings(width_px=320, fps=6)
HOSTILE = "../\x00<img src=x>日本語 " + "y" * 90


def pixels_of(image: NDArray[np.uint8], colour: tuple[int, int, int]) -> int:
    return int((np.abs(image.astype(int) - colour).max(axis=-1) <= 2).sum())


@pytest.mark.parametrize("layout", FilmLayout)
def test_frames_have_one_size_and_the_scenes_length(tmp_path: Path, layout: FilmLayout) -> None:
    stored = written(tmp_path)
    assert len(Film(stored, [record("p")], ["p"], FilmSettings(layout=layout))) == FRAMES
    frames = list(Film(stored, [record("p")], ["p"], FilmSettings(layout=layout, begin_s=0.9, end_s=1.0)))
    assert {frame.shape for frame in frames} == {(HEIGHT_PX, WIDTH_PX, 3)} and tuple(frames[0][4, 700]) == TITLE
    assert (pixels_of(frames[-1], EGO) > 300) == (layout is not FilmLayout.CAMERAS)


def test_pictures_are_held_and_the_adversarys_edges_are_drawn_on_theirs(tmp_path: Path) -> None:
    film = Film(written(tmp_path), [], [], FilmSettings(layout=FilmLayout.CAMERAS))
    frames = [frame[TITLE_PX : TITLE_PX + 488] for frame in film]
    assert [pixels_of(frame, ADVERSARY) > 300 for frame in frames] == [6 <= number < 12 for number in range(FRAMES)]
    assert np.array_equal(frames[7], frames[11]) and not np.array_equal(frames[5], frames[6])
    columns = np.flatnonzero((np.abs(frames[6].astype(int) - ADVERSARY).max(axis=-1) <= 2).sum(axis=0) > 100)
    # Column 60 of 120, in a picture that is as much wider as there is room.
    assert abs(float(columns.mean()) - ((WIDTH_PX - 1220) // 2 + 60.5 / 120 * 1220)) < 2.5


def test_what_a_planner_came_to_is_shown_up_to_now_only(tmp_path: Path) -> None:
    ran = touching(record("p", [CLEAN, CLEAN, CLEAN, HIT, FAILED]), True)
    film = Film(written(tmp_path), [ran], ["p"], FilmSettings(layout=FilmLayout.CAMERAS))
    red = [pixels_of(frame[TITLE_PX + 488 :], CONTACT) for frame in film]
    assert max(red[:18]) == 0 and min(red[18:24]) > 500
    (track,) = film.tracks
    tallies = [track.tally_until(frame) for frame in (0, 17, 18, 24)]
    counts = [(tally.touches.get(CollisionParty.ADVERSARY, 0), tally.counted) for tally in tallies]
    assert counts == [(0, 1), (0, 3), (1, 4), (1, 4)]
    last = track.at(24)
    assert last is not None and last.plan is None and last.verdict.words == "the planner failed"
    fading = [plan.opacity for frame in range(6) if (plan := track.at(frame)) is not None]
    assert fading == sorted(fading, reverse=True) and fading[0] == 1.0 and fading[-1] > 0.5


def touching(ran: RunRecord, adversary: bool | None) -> RunRecord:
    """The same record, which says whom each contact is with, or does not."""
    rows = []
    for row in ran.rows:
        hit = row.status == "ok" and any(row.outcomes["exact"].collision or ())
        facts = {} if adversary is None else {"hit_adversary": adversary if hit else None}
        outcomes = {name: each.model_copy(update={"facts": facts}) for name, each in row.outcomes.items()}
        rows.append(row.model_copy(update={"outcomes": outcomes}))
    return RunRecord(ran.directory, ran.run, tuple(rows), ran.summary)


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is written beside the pictures."""
    words: list[str] = []
    monkeypatch.setattr("leaderboard.extensions.films.panel.write_text", lambda _, text, *__, **___: words.append(text))
    return words


@pytest.mark.parametrize(
    ("adversary", "tally"),
    [(True, "1 of 2 hit it, 0 another"), (False, "0 of 2 hit it, 1 another"), (None, "– of 2 hit it")],
)
def test_contacts_with_others_than_the_adversary_have_a_mark_and_a_number_of_their_own(
    tmp_path: Path, said: list[str], adversary: bool | None, tally: str
) -> None:
    ran = touching(record("p", [CLEAN, HIT, *[UNCOUNTED] * 3]), adversary)
    settings = FilmSettings(layout=FilmLayout.CAMERAS, begin_s=1.9)
    last = list(Film(written(tmp_path), [ran], ["p"], settings))[-1]
    assert tally in said and ("◇" in said) == (adversary is False)
    assert (pixels_of(last[TITLE_PX + 488 :], CONTACT) > 300) == (adversary is True)
    said.clear()
    list(Film(written(tmp_path / "none", agents=[]), [ran], ["p"], settings))
    assert "1 of 2 collide" in said


def test_a_miniature_carries_its_mark(tmp_path: Path, said: list[str]) -> None:
    ran, stored = record("p"), written(tmp_path)
    planner = ran.run.planner.model_copy(update={"miniature": True})
    small = replace(ran, run=ran.run.model_copy(update={"planner": planner}))
    next(iter(Film(stored, [small], ["p"], FilmSettings())))
    assert "p §" in said and "§ miniature: demonstrates the pipeline; not for ranking" in said
    said.clear()
    next(iter(Film(stored, [ran], ["p"], FilmSettings())))
    assert "p" in said and not any("§" in text for text in said)


@pytest.mark.parametrize(
    ("samples", "changes"),
    [
        ([UNCOUNTED] * 5, {"agents": []}),
        ([FAILED] * 5, {"road": {}}),
        ([HIT, HIT], {"labels": [], "description": HOSTILE}),
        ([], {"keyframes": [], "sample_tokens": []}),
    ],
)
def test_any_samples_can_be_shown_and_what_a_sheet_lacks_is_left_out(
    tmp_path: Path, samples: list[str | None], changes: dict[str, Any]
) -> None:
    whole, lacking = written(tmp_path / "whole"), written(tmp_path / "lacking", **changes)
    if samples:
        assert len(list(Film(whole, [record("p", samples)], ["p"], SMALL))) == 13
    for layout in FilmLayout:
        assert len(list(Film(lacking, [], [], FilmSettings(layout=layout, width_px=320, end_s=0.1)))) == 2


def test_without_cameras_the_scene_is_shown_from_above_and_damaged_pictures_are_one_sentence(tmp_path: Path) -> None:
    blind, stored = written(tmp_path / "blind", pictures=False), written(tmp_path)
    assert Film(blind, [], [], SMALL).layout is FilmLayout.BIRDSEYE
    with pytest.raises(InputError, match="--layout birdseye"):
        Film(blind, [], [], FilmSettings(layout=FilmLayout.CAMERAS))
    for data in (b"", b"not a readable picture", b"RIFF\x00\x00\x00\x00WEBP"):
        broken_picture(stored, data)
        with pytest.raises(InputError, match="challenger-bench sheets again"):
            list(Film(stored, [], [], SMALL))


@pytest.mark.parametrize("name", [HOSTILE, "", "\u202e\n"])
def test_names_from_strangers_are_only_text(tmp_path: Path, name: str) -> None:
    stored, short = written(tmp_path, scene=HOSTILE), FilmSettings(width_px=320, fps=6, end_s=0.4)
    run = record(name, scene=HOSTILE)
    path = write_film(stored.directory, [run], [name], tmp_path / "films", FilmFormat.PNG, short)
    assert path.parent == tmp_path / "films" and len(list(path.iterdir())) == 3


@pytest.mark.path
def test_a_film_decodes_to_its_frames_and_is_the_same_bytes_again(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    folder = written(tmp_path / "sheets").directory
    runs = [record("p", [HIT] * 5), record("q")]
    for form in FilmFormat:
        first, second = (write_film(folder, runs, ["q", "p"], tmp_path / to, form, SMALL) for to in "ab")
        assert form is FilmFormat.PNG or first.read_bytes() == second.read_bytes()
    with av.open(str(tmp_path / "a" / "scene-1.webm")) as container:
        shapes = [frame.to_ndarray(format="rgb24").shape for frame in container.decode(video=0)]
        assert container.streams.video[0].average_rate == 6 and shapes == [(180, 320, 3)] * 13
    with Image.open(tmp_path / "a" / "scene-1.webp") as picture:
        assert (picture.size, getattr(picture, "n_frames", 1)) == ((320, 180), 13)
    pictures = sorted((tmp_path / "a/scene-1").iterdir())
    assert [path.name for path in pictures] == [f"{number:06d}.png" for number in range(13)]
    assert all(path.read_bytes() == (tmp_path / "b/scene-1" / path.name).read_bytes() for path in pictures)
    with Image.open(pictures[5]) as picture:
        assert picture.size == (320, 180)


def test_what_cannot_be_written_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An animated WebP that would fill the memory, video without PyAV (frames are written), frames of another film."""
    folder, to = written(tmp_path).directory, tmp_path / "films"
    monkeypatch.setattr("leaderboard.extensions.films.filming.LONGEST_WEBP", 12)
    with pytest.raises(InputError, match="13; choose a part"):
        write_film(folder, [], [], to, FilmFormat.WEBP, SMALL)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"challenger-bench\[video\].*--format png"):
        write_film(folder, [], [], to, FilmFormat.WEBM, SMALL)
    assert write_film(folder, [], [], to, FilmFormat.PNG, SMALL).is_dir()
    with pytest.raises(InputError, match="other frames"):
        write_film(folder, [], [], to, FilmFormat.PNG, FilmSettings(width_px=320, fps=6, end_s=1.0))


def test_a_part_of_the_scene_at_any_rate(tmp_path: Path) -> None:
    stored = written(tmp_path)
    for settings, frames in (
        (FilmSettings(begin_s=0.5, end_s=1.0), range(6, 13)),
        (FilmSettings(fps=2.0), range(0, 25, 6)),
        (FilmSettings(begin_s=2.0), range(24, 25)),
    ):
        film = Film(stored, [], [], settings)
        assert film.frames == tuple(frames) and len(film) == len(film.frames)


def test_settings_out_of_range_are_one_sentence() -> None:
    wrong: dict[str, tuple[float, ...]] = {
        "fps": (0.0, -1.0, 1e9, float("nan")),
        "width_px": (0, 100, 330, 2560),
        "extent_m": (0.0, float("inf")),
        "begin_s": (-1.0, float("nan")),
    }
    for settings in [{name: value} for name, values in wrong.items() for value in values] + [
        {"begin_s": 3, "end_s": 2}
    ]:
        with pytest.raises(InputError, match="must be"):
            FilmSettings(**settings)  # type: ignore[arg-type]


def test_what_is_missing_is_named_with_the_command_that_makes_it(tmp_path: Path) -> None:
    stored = written(tmp_path)
    other = record("p", data="d", scene="scene-1", split="adv", samples=[CLEAN] * 6)
    cases: tuple[tuple[list[RunRecord], list[str], FilmSettings, str], ...] = (
        ([record("p")], ["q"], SMALL, "challenger-bench eval --split adv --model q"),
        ([other], ["p"], SMALL, "other content"),
        ([record("p"), record("p")], ["p"], SMALL, "ran 2 times"),
        ([], [f"p{number}" for number in range(9)], SMALL, "8 planners"),
        ([], [], FilmSettings(begin_s=9.0), "earlier --from"),
    )
    for runs, names, settings, said in cases:
        with pytest.raises(InputError, match=said):
            Film(stored, runs, names, settings)
    for data, scenes, said in (
        ("d", ["scene-2"], "sheets --data d --split adv"),
        ("other", None, "sheets --data other"),
    ):
        with pytest.raises(InputError, match=f"challenger-bench {said}"):
            find_scene_page_folders(tmp_path, data, "adv", scenes)
    assert find_scene_page_folders(tmp_path, "anywhere/d", "adv", None) == [stored.directory]
    gap = compute_adversary_gap(sheet())
    assert gap == pytest.approx(5.0 - 1.0 - 1.85 / 2)
    assert np.isnan(compute_adversary_gap(sheet(agents=[]))).all()
