"""Films of drives: the driven world, the recorded path, the contact; the command finds sheets, records, drives."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.planners.stop import Stop
from benchmark import api
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.errors import InputError
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord, write_record
from benchmark.report.episode_page import EpisodePage
from benchmark.report.palette import ADVERSARY, BEST, CONTACT, EGO, PATH
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.runs.episode_pages import write_episode_page
from leaderboard.extensions.films.cli import resolve_planner_names
from leaderboard.extensions.films.drive_film import DRIVE_FPS, HELD_S, DriveFilm
from leaderboard.extensions.films.film import HEIGHT_PX, TITLE_PX, WIDTH_PX, FilmLayout, FilmSettings
from leaderboard.extensions.films.filming import FilmFormat, write_drive_film
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.closed_loop.staged import Watching
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Failing, Straight
from tests.benchmark.records.hand_made_records import CLEAN, HIT
from tests.benchmark.records.test_drives import written as written_drives
from tests.benchmark.report import one_scene
from tests.benchmark.runs.test_driving import town
from tests.benchmark.runs.test_encounters import cut_in
from tests.benchmark.runs.test_encounters import data as adversarial_data
from tests.benchmark.runs.test_episode_pages import Clock, driven
from tests.generation.extensions.reactive_adversary.loops import SETTINGS as ADVERSARY_SETTINGS
from tests.generation.extensions.reactive_adversary.loops import rides
from tests.hand_made import Car, scene_on_straight_road
from tests.leaderboard.extensions.films.test_film import pixels_of

SETTINGS = FilmSettings(fps=DRIVE_FPS)
Made = tuple[DriveRecord, EpisodePage]


@pytest.fixture(scope="module")
def hit(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A drive with cameras that ends in a contact."""
    folder = tmp_path_factory.mktemp("hit")
    record = driven(folder / "out", Straight())
    return record, write_episode_page(folder, town(), record, record.rows[1], DefaultBackend(), Clock())


def film_of(made: Made, **changes: object) -> DriveFilm:
    return DriveFilm(made[1], made[0], "straight", FilmSettings(**{"fps": DRIVE_FPS, **changes}))  # type: ignore[arg-type]


def test_a_contact_is_announced_marked_and_held(hit: Made) -> None:
    film, contact = film_of(hit), hit[1].contact
    assert contact is not None and film.layout is FilmLayout.BOTH
    # NeuroNCAP's engine finds a contact after the states that follow it.
    assert film.frames[-1] == hit[1].last and 0.0 <= hit[1].seconds[film.frames[-1]] - contact.seconds < 0.101
    held = round(HELD_S * DRIVE_FPS)
    assert film.frames[-held - 1 :] == film.frames[-1:] * (held + 1)
    frames = list(film)
    assert {frame.shape for frame in frames} == {(HEIGHT_PX, WIDTH_PX, 3)} and len(frames) == len(film)
    assert np.array_equal(frames[-1], frames[-held]) and len(hit[1].seconds) > 10
    star = [pixels_of(frame[TITLE_PX:, WIDTH_PX - 500 :], CONTACT) for frame in frames]
    said = [pixels_of(frame[TITLE_PX:, : WIDTH_PX - 500], CONTACT) for frame in frames]
    early = int((contact.seconds - 3.3) * DRIVE_FPS)
    assert max(star[: max(early, 0) + 1]) == 0 and star[-1] > 100
    assert max(said[: len(frames) - held - 3]) == 0 and said[-1] > 100
    above = list(film_of(hit, layout=FilmLayout.BIRDSEYE, begin_s=1.9, end_s=2.0))[-1][TITLE_PX:, WIDTH_PX - 820 :]
    assert pixels_of(above, EGO) > 300 and pixels_of(above, PATH) > 50


def test_what_came_after_the_contact_is_not_shown_and_a_part_of_a_drive_holds_nothing(hit: Made) -> None:
    record, sheet = hit
    assert sheet.contact is not None
    earlier = record, replace(sheet, contact=replace(sheet.contact, seconds=sheet.contact.seconds - 0.5))
    assert film_of(earlier).frames[-1] == earlier[1].last < sheet.last
    with pytest.raises(InputError, match="ends after"):
        film_of(earlier, begin_s=earlier[1].seconds[-1])
    assert len(film_of(hit, begin_s=1.0, end_s=2.0)) == 11
    with pytest.raises(InputError, match="choose an earlier --from"):
        film_of(hit, begin_s=99.0)
    assert next(iter(film_of(hit, width_px=320, end_s=0.1))).shape == (180, 320, 3)


def test_a_failure_is_said_at_the_end_and_without_pictures_all_is_seen_from_above(tmp_path: Path) -> None:
    record = driven(tmp_path / "out", Failing())
    place = next(place for place, row in enumerate(record.rows) if row.status == "failed")
    blind = record, write_episode_page(tmp_path, town(), record, record.rows[place], DefaultBackend(), None)
    assert film_of(blind).layout is FilmLayout.BIRDSEYE
    with pytest.raises(InputError, match="--layout birdseye"):
        film_of(blind, layout=FilmLayout.CAMERAS)
    red = [pixels_of(frame, CONTACT) for frame in film_of(blind)]
    assert red[-1] > 100 and red[0] == 0


def test_whoever_touched_the_ego_without_its_fault_is_named_and_gone(tmp_path: Path) -> None:
    scene = scene_on_straight_road((Car(20.0, 198.25, 12.0),), ego_speed=8.0, seconds=12.0)
    data, maker = FakeData({scene.name: scene}), DefaultBackend(until="fault@1")
    how = DriveSettings("default", maker)
    record = drive_split(data, "val", Watching(speed=6.0), tmp_path / "out", how)
    shown = write_episode_page(tmp_path, data, record, record.rows[0], maker, None)
    (touch,) = record.rows[0].passed
    moment = float(shown.seconds[shown.begins]) + touch.seconds
    film = film_of((record, shown), layout=FilmLayout.BIRDSEYE, begin_s=moment - 0.5, end_s=moment + 1.0)
    red = {frame: pixels_of(image, CONTACT) for frame, image in zip(film.frames, film)}
    said = [frame for frame, pixels in red.items() if pixels > 50]
    seconds = shown.seconds - shown.seconds[shown.begins]
    assert seconds[said[0]] == pytest.approx(touch.seconds, abs=0.15) and said[-1] == film.frames[-1]
    (agent,) = shown.stored.sheet.agents
    assert seconds[agent.first + len([x for x in agent.x_m if x is not None]) - 1] < touch.seconds + 0.5
    path = write_drive_film(shown, record, "watching", tmp_path, FilmFormat.PNG, FilmSettings(fps=DRIVE_FPS, end_s=0.2))
    assert path.name == "scene-9901-watching-default-replay-none-until-fault-1"


@pytest.mark.path
def test_a_film_has_the_name_of_what_was_measured(hit: Made, tmp_path: Path) -> None:
    record, sheet = hit
    settings = FilmSettings(fps=DRIVE_FPS, width_px=320, end_s=0.3)
    path = write_drive_film(sheet, record, "straight", tmp_path, FilmFormat.PNG, settings)
    assert path == tmp_path / "scene-9902-straight-default-replay-none" and len(list(path.iterdir())) == 4
    film, again = (write_drive_film(sheet, record, "straight", tmp_path / to, FilmFormat.WEBP, settings) for to in "ab")
    assert film.suffix == ".webp" and film.read_bytes() == again.read_bytes()


LARGEST_BYTES = 1_000_000
"""Of a film of 20 s with cameras, as it is made without options."""


def test_a_film_of_twenty_seconds_is_less_than_a_megabyte(hit: Made, tmp_path: Path) -> None:
    pytest.importorskip("av")
    film = write_drive_film(hit[1], hit[0], "straight", tmp_path, FilmFormat.WEBM, FilmSettings(fps=DRIVE_FPS))
    assert film.suffix == ".webm" and film.stat().st_size * 20 * DRIVE_FPS / len(film_of(hit)) < LARGEST_BYTES


def test_what_an_adversary_considered_is_drawn_where_it_was_kept_and_asked_for(tmp_path: Path) -> None:
    maker = rides(replace(ADVERSARY_SETTINGS, keep_considered=True))
    settings = DriveSettings("default", maker, agents="adversary", ladder=("cc",), limit=1, keep_considered=True)
    record = drive_split(town(), "val", Stop(), tmp_path / "out", settings)
    kept = write_episode_page(tmp_path, town(), record, record.rows[0], maker, None)
    # A vehicle of a recording is the adversary of the drive.
    assert record.rows[0].adversary is not None
    assert [each.id for each in kept.stored.sheet.agents if each.adversary] == [record.rows[0].adversary.uuid]
    first = next(each for each in kept.considered if each.did == "searched")
    assert first.chosen is not None
    frame = int(np.searchsorted(kept.stored.sheet.timestamps_us, first.time_us))
    shown = kept.candidates_at(frame)
    assert shown is not None and shown.chosen is not None and len(shown.paths) == len(first.candidates)
    np.testing.assert_allclose(shown.chosen + kept.stored.sheet.origin_m, first.candidates[first.chosen], atol=1e-6)
    assert kept.candidates_at(0) is None
    moment = float(kept.seconds[frame])
    whole, without, unkept = (
        next(iter(film_of((record, sheet), begin_s=moment, extent_m=70.0, layout=FilmLayout.BIRDSEYE, **changes)))
        for sheet, changes in ((kept, {}), (kept, {"candidates": False}), (replace(kept, considered=()), {}))
    )
    assert np.array_equal(without, unkept)
    above, panel = slice(WIDTH_PX - 820, None), slice(0, WIDTH_PX - 820)
    assert pixels_of(whole[:, above], BEST) > pixels_of(without[:, above], BEST) + 40
    assert pixels_of(whole[:, panel], ADVERSARY) > pixels_of(without[:, panel], ADVERSARY) + 20


def test_what_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    asked = ("film", "--drives", "--data", "mini", "--out", tmp_path, "--to", tmp_path / "films", "--format", "png")
    assert "challenger-bench drive --data mini --split adv" in refusal(*asked)
    written_drives(tmp_path / "drives" / "a", data={"name": "mini", "version": "v1", "fingerprint": "f" * 64})
    assert "there are no drives of vad; choose one of made" in refusal(*asked, "--model", "vad")
    assert "scene scene-9 was not driven" in refusal(*asked, "--scenes", "scene-9")
    assert "there are no records of drives on mini val" in refusal(*asked, "--split", "val")


def record(runs: Path, planner: str, data: str = "mini", split: str = "adv") -> Path:
    folder = runs / data / split
    (folder / planner).mkdir(parents=True)
    ran = {"data": {"name": data}, "split": split, "planner": {"name": planner}}
    (folder / planner / "run.json").write_text(json.dumps(ran))
    return folder


def test_a_full_model_is_shown_as_the_miniature_that_ran(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmark.api.opening._notified", set())
    folder, *_ = [record(tmp_path, name) for name in ("uniad-mini", "vad-mini", "idm")]
    assert resolve_planner_names(["uniad", "vad", "idm"], [folder], tmp_path) == ["uniad-mini", "vad-mini", "idm"]
    assert resolve_planner_names(["uniad"], [folder], tmp_path) == ["uniad-mini"]
    said = capsys.readouterr().err
    assert said.count("uniad-mini, which ran in its place") == 1 and said.count("\n") == 2
    record(tmp_path, "vad-base")
    assert resolve_planner_names(["vad", "vad-base (seed 1)"], [folder], tmp_path) == ["vad-base", "vad-base (seed 1)"]


def test_records_of_other_data_are_named_and_what_the_demo_made_has_a_name(tmp_path: Path) -> None:
    record(tmp_path, "idm", data="demo")
    with pytest.raises(InputError, match=r"no run records at .*; found records of demo \(adv: idm\)"):
        resolve_planner_names(["idm"], [tmp_path / "mini" / "adv"], tmp_path)
    with pytest.raises(InputError, match="did you mean idm"):
        resolve_planner_names(["idn"], [tmp_path / "demo" / "adv"], tmp_path)
    with pytest.raises(InputError, match="run: challenger-bench demo --out"):
        api.open_data("demo", out=tmp_path)


def stored(run: RunRecord, root: Path) -> None:
    """Write a record where `eval` would."""
    left_out = {"status", "protocols", "seed", "files", "schema_version", "rescored"}
    facts = {name: value for name, value in run.run.model_dump().items() if name not in left_out}
    write_record(root / "d" / "adv" / run.planner, facts, list(run.rows), run.run.protocols, seed=0)


@pytest.mark.path
def test_a_film_from_sheets_and_records(tmp_path: Path) -> None:
    one_scene.written(tmp_path / "sheets")
    stored(one_scene.record("p", [HIT, CLEAN, CLEAN, CLEAN, CLEAN]), tmp_path / "runs")
    command = ("film", "--data", "d", "--out", tmp_path, "--to", tmp_path / "films", "--until", "0.3", "--width", "320")
    made = run_here(*command, "--format", "png", "--model", "p", "--json")
    folder = tmp_path / "films" / "scene-1"
    assert made.code == 0 and json.loads(made.out) == {"films": [str(folder)]}, made.err
    assert sorted(path.name for path in folder.iterdir()) == [f"{number:06d}.png" for number in range(4)]
    missing = run_here(*command, "--scenes", "scene-9")
    default, refusal = missing.err.splitlines()
    assert missing.code == 2 and "challenger-bench sheets" in refusal and default.startswith("split adv, the default")


def test_a_film_of_a_window_begins_there_and_marks_the_adversary_when_it_departs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, data = cut_in(), adversarial_data()
    settings = DriveSettings("default", DefaultBackend("idm"), "idm", window="encounter")
    record = drive_split(data, "adv", Straight(), tmp_path / "out", settings)
    driven = write_episode_page(tmp_path, data, record, record.rows[0], DefaultBackend("idm"), None)
    film = film_of((record, driven))
    assert driven.seconds[film.frames[0]] == pytest.approx(3.0, abs=0.05) == driven.seconds[driven.begins]
    assert driven.seconds[film_of((record, driven), begin_s=0.5).frames[0]] == pytest.approx(0.5, abs=0.1)
    pictures = dict(zip(film.frames, film))
    orange = {frame: pixels_of(picture[TITLE_PX:, WIDTH_PX - 500 :], ADVERSARY) for frame, picture in pictures.items()}
    departs = min(frame for frame in orange if driven.seconds[frame] >= scene.seconds[72] + 0.05)
    assert max(count for frame, count in orange.items() if frame < departs - 1) < 50 < orange[departs] / 2
    strip = {frame: pixels_of(picture[-60:, :300], CONTACT) for frame, picture in pictures.items()}
    assert record.rows[0].contact is not None and strip[film.frames[0]] == 0 < strip[film.frames[-1]]
    said: list[str] = []
    monkeypatch.setattr("leaderboard.extensions.films.drive_film.write_text", lambda *args, **_: said.append(args[1]))
    long = driven.stored.sheet.model_copy(update={"scene": "scene-9901-cut-in-from-the-left-lane"})
    next(iter(film_of((record, replace(driven, stored=replace(driven.stored, sheet=long))))))
    assert said[0] == long.scene and " ".join(said[1:3]).startswith(
        "closed loop: default, agents idm (adversary on its track), window encounter, sensor none; fake adv"
    )
