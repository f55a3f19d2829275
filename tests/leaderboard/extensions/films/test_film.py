"""Films: what is in a frame, what becomes of it on disk, and what is said when something is missing."""

import io
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
    frames = list(Film(stored, [record("p")], ["p"], FilmSettings(layout=layout)))
    assert len(frames) == FRAMES
    assert {frame.shape for frame in frames} == {(HEIGHT_PX, WIDTH_PX, 3)}
    assert tuple(frames[0][4, 700]) == TITLE
    assert (pixels_of(frames[12], EGO) > 300) == (layout is not FilmLayout.CAMERAS)


def test_pictures_are_held_and_the_adversarys_edges_are_drawn_on_theirs(tmp_path: Path) -> None:
    film = Film(written(tmp_path), [], [], FilmSettings(layout=FilmLayout.CAMERAS))
    frames = [frame[TITLE_PX : TITLE_PX + 488] for frame in film]
    marked = [pixels_of(frame, ADVERSARY) > 300 for frame in frames]
    assert marked == [6 <= number < 12 for number in range(FRAMES)]
    assert np.array_equal(frames[7], frames[11]) and not np.array_equal(frames[5], frames[6])
    columns = np.flatnonzero((np.abs(frames[6].astype(int) - ADVERSARY).max(axis=-1) <= 2).sum(axis=0) > 100)
    # Column 60 of 120, in a picture that is as much wider as there is room.
    left, width = (WIDTH_PX - 1220) // 2, 1220
    assert abs(float(columns.mean()) - (left + 60.5 / 120 * width)) < 2.5


def test_what_a_planner_came_to_is_shown_up_to_now_only(tmp_path: Path) -> None:
    stored = written(tmp_path)
    samples = [CLEAN, CLEAN, CLEAN, HIT, FAILED]
    film = Film(stored, [touching(record("p", samples), True)], ["p"], FilmSettings(layout=FilmLayout.CAMERAS))
    red = [pixels_of(frame[TITLE_PX + 488 :], CONTACT) for frame in film]
    assert max(red[:18]) == 0 and min(red[18:24]) > 500
    (track,) = film.tracks
    tallies = [track.tally_until(frame) for frame in (0, 17, 18, 24)]
    assert [(tally.touches.get(CollisionParty.ADVERSARY, 0), tally.counted) for tally in tallies] == [
        (0, 1),
        (0, 3),
        (1, 4),
        (1, 4),
    ]
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


@pytest.mark.parametrize(
    ("adversary", "said"),
    [(True, "1 of 2 hit it, 0 another"), (False, "0 of 2 hit it, 1 another"), (None, "– of 2 hit it")],
)
def test_contacts_with_others_than_the_adversary_have_a_mark_and_a_number_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, adversary: bool | None, said: str
) -> None:
    written_words: list[str] = []
    monkeypatch.setattr(
        "leaderboard.extensions.films.panel.write_text", lambda _, text, *__, **___: written_words.append(text)
    )
    stored = written(tmp_path)
    ran = touching(record("p", [CLEAN, HIT, *[UNCOUNTED] * 3]), adversary)
    film = Film(stored, [ran], ["p"], FilmSettings(layout=FilmLayout.CAMERAS))
    last = list(film)[-1]
    assert said in written_words
    assert (pixels_of(last[TITLE_PX + 488 :], CONTACT) > 300) == (adversary is True)
    assert ("◇" in written_words) == (adversary is False)
    none = written(tmp_path / "none", agents=[])
    written_words.clear()
    list(Film(none, [ran], ["p"], FilmSettings(layout=FilmLayout.CAMERAS)))
    assert "1 of 2 collide" in written_words


def test_a_miniature_carries_its_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = record("p")
    small = replace(
        ran,
        run=ran.run.model_copy(update={"planner": ran.run.planner.model_copy(update={"miniature": True})}),
    )
    said: list[str] = []
    monkeypatch.setattr(
        "leaderboard.extensions.films.panel.write_text", lambda image, text, *_, **__: said.append(text)
    )
    stored = written(tmp_path)
    next(iter(Film(stored, [small], ["p"], FilmSettings())))
    assert "p §" in said and "§ miniature: demonstrates the pipeline; not for ranking" in said
    said.clear()
    next(iter(Film(stored, [ran], ["p"], FilmSettings())))
    assert "p" in said and not any("§" in text for text in said)


@pytest.mark.parametrize("samples", [[UNCOUNTED] * 5, [FAILED] * 5, [HIT] * 5, [HIT, HIT]])
def test_any_samples_can_be_shown(tmp_path: Path, samples: list[str | None]) -> None:
    assert len(list(Film(written(tmp_path), [record("p", samples)], ["p"], SMALL))) == 13


@pytest.mark.parametrize(
    "changes",
    [{"agents": []}, {"road": {}}, {"labels": [], "description": HOSTILE}, {"keyframes": [], "sample_tokens": []}],
)
def test_what_a_sheet_lacks_is_left_out(tmp_path: Path, changes: dict[str, Any]) -> None:
    for layout in FilmLayout:
        settings = FilmSettings(layout=layout, width_px=320, end_s=0.5)
        assert len(list(Film(written(tmp_path, **changes), [], [], settings))) == 7


def test_without_cameras_the_scene_is_shown_from_above(tmp_path: Path) -> None:
    stored = written(tmp_path, pictures=False)
    assert Film(stored, [], [], SMALL).layout is FilmLayout.BIRDSEYE
    with pytest.raises(InputError, match="--layout birdseye"):
        Film(stored, [], [], FilmSettings(layout=FilmLayout.CAMERAS))


@pytest.mark.parametrize("name", [HOSTILE, "", "\u202e\n"])
def test_names_from_strangers_are_only_text(tmp_path: Path, name: str) -> None:
    stored = written(tmp_path, scene=HOSTILE)
    run = record(name, scene=HOSTILE)
    path = write_film(stored.directory, [run], [name], tmp_path / "films", FilmFormat.PNG, SMALL)
    assert path.parent == tmp_path / "films" and len(list(path.iterdir())) == 13


def test_a_film_decodes_to_its_frames_and_is_the_same_bytes_again(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    folder = written(tmp_path / "sheets").directory
    runs = [record("p", [HIT] * 5), record("q")]
    for form in FilmFormat:
        first, second = (write_film(folder, runs, ["q", "p"], tmp_path / to, form, SMALL) for to in "ab")
        if form is not FilmFormat.PNG:
            assert first.read_bytes() == second.read_bytes()
    with av.open(str(tmp_path / "a" / "scene-1.webm")) as container:
        shapes = [frame.to_ndarray(format="rgb24").shape for frame in container.decode(video=0)]
        assert container.streams.video[0].average_rate == 6
    assert shapes == [(180, 320, 3)] * 13
    with Image.open(tmp_path / "a" / "scene-1.webp") as picture:
        assert (picture.size, getattr(picture, "n_frames", 1)) == ((320, 180), 13)
    names = [f"{number:06d}.png" for number in range(13)]
    for name in names:
        assert (tmp_path / "a/scene-1" / name).read_bytes() == (tmp_path / "b/scene-1" / name).read_bytes()
    with Image.open(io.BytesIO((tmp_path / "a/scene-1" / names[5]).read_bytes())) as picture:
        assert picture.size == (320, 180)


def test_an_animated_webp_that_would_fill_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("leaderboard.extensions.films.filming.LONGEST_WEBP", 12)
    with pytest.raises(InputError, match="13; choose a part"):
        write_film(written(tmp_path).directory, [], [], tmp_path / "films", FilmFormat.WEBP, SMALL)


def test_without_pyav_the_sentence_says_what_to_do_and_frames_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = written(tmp_path).directory
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"challenger-bench\[video\].*--format png"):
        write_film(folder, [], [], tmp_path / "films", FilmFormat.WEBM, SMALL)
    assert write_film(folder, [], [], tmp_path / "films", FilmFormat.PNG, SMALL).is_dir()
    shorter = FilmSettings(width_px=320, fps=6, end_s=1.0)
    with pytest.raises(InputError, match="other frames"):
        write_film(folder, [], [], tmp_path / "films", FilmFormat.PNG, shorter)


@pytest.mark.parametrize(
    ("settings", "frames"),
    [({"begin_s": 0.5, "end_s": 1.0}, range(6, 13)), ({"fps": 2.0}, range(0, 25, 6)), ({"begin_s": 2.0}, [24])],
)
def test_a_part_of_the_scene_at_any_rate(tmp_path: Path, settings: dict[str, float], frames: Any) -> None:
    film = Film(written(tmp_path), [], [], FilmSettings(width_px=320, **settings))  # type: ignore[arg-type]
    assert film.frames == tuple(frames) and len(film) == len(film.frames)


@pytest.mark.parametrize(
    "settings",
    [
        *({"fps": fps} for fps in (0.0, -1.0, 1e9, float("nan"))),
        *({"width_px": width} for width in (0, 100, 330, 2560)),
        *({"extent_m": extent} for extent in (0.0, float("inf"))),
        *({"begin_s": begin} for begin in (-1.0, float("nan"))),
        {"begin_s": 3.0, "end_s": 2.0},
    ],
)
def test_settings_out_of_range_are_one_sentence(settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="must be"):
        FilmSettings(**settings)


def test_what_is_missing_is_named_with_the_command_that_makes_it(tmp_path: Path) -> None:
    stored = written(tmp_path)
    with pytest.raises(InputError, match="challenger-bench eval --split adv --model q"):
        Film(stored, [record("p")], ["q"], SMALL)
    with pytest.raises(InputError, match="other content"):
        Film(stored, [record("p", data="d", scene="scene-1", split="adv", samples=[CLEAN] * 6)], ["p"], SMALL)
    with pytest.raises(InputError, match="ran 2 times"):
        Film(stored, [record("p"), record("p")], ["p"], SMALL)
    with pytest.raises(InputError, match="8 planners"):
        Film(stored, [], [f"p{number}" for number in range(9)], SMALL)
    with pytest.raises(InputError, match="earlier --from"):
        Film(stored, [], [], FilmSettings(begin_s=9.0))
    with pytest.raises(InputError, match="challenger-bench sheets --data d --split adv"):
        find_scene_page_folders(tmp_path, "d", "adv", ["scene-2"])
    with pytest.raises(InputError, match="challenger-bench sheets --data other"):
        find_scene_page_folders(tmp_path, "other", "adv", None)
    assert find_scene_page_folders(tmp_path, "anywhere/d", "adv", None) == [stored.directory]


@pytest.mark.parametrize("data", [b"", b"not a readable picture", b"RIFF\x00\x00\x00\x00WEBP"])
def test_a_damaged_picture_is_one_sentence(tmp_path: Path, data: bytes) -> None:
    stored = written(tmp_path)
    broken_picture(stored, data)
    with pytest.raises(InputError, match="challenger-bench sheets again"):
        list(Film(stored, [], [], SMALL))


def test_the_gap_is_that_between_the_boxes() -> None:
    gap = compute_adversary_gap(sheet())
    assert gap == pytest.approx(5.0 - 1.0 - 1.85 / 2)
    assert np.isnan(compute_adversary_gap(sheet(agents=[]))).all()
