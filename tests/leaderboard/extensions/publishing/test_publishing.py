"""What should not leave the house is found wherever it is planted, and a clean leaderboard is clean."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.records.run import find_records
from benchmark.records.scene_pages import ScenePages, find_scene_pages
from leaderboard.build import write_leaderboard
from leaderboard.extensions.publishing.checking import MachineIdentity, check_publishable
from leaderboard.extensions.publishing.static_hosting import PublicationFinding
from leaderboard.frame.results import read_results
from leaderboard.site.packing import decode_script, encode_script
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.hand_made_records import HIT, hand_made
from tests.leaderboard.site.big_workspace import make_workspace

HOUSE = MachineIdentity(("home", "scratch"), ("gpu-box-7", "lab"), ("jdoe", "al"))
POLICY = "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src 'self' data:\">"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with a leaderboard and its site, whose pictures were drawn by us."""
    folder = tmp_path_factory.mktemp("made")
    make_workspace(folder, 3, 1, samples=4)
    sheets = find_scene_pages(folder / "sheets")
    drawn = {
        name: replace(stored, sheet=stored.sheet.model_copy(update={"drawn_by": "schematic"}))
        for name, stored in sheets.scenes.items()
    }
    pages = ScenePages(sheets.splits, drawn)
    write_leaderboard(read_results(find_records(folder / "runs"), sheets=pages), folder / "leaderboard")
    return folder


def found_in(folder: Path, **files: str | bytes) -> list[PublicationFinding]:
    """What is found in a folder with these files; ``__`` stands for a dot, ``___`` for a slash."""
    for name, content in files.items():
        path = folder / name.replace("___", "/").replace("__", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return check_publishable(folder, house=HOUSE)[1]


def test_a_leaderboard_of_drawn_scenes_is_clean_wherever_it_is_looked_at(made: Path) -> None:
    board = made / "leaderboard"
    for folder, expected in {made: board, board / "site": board / "site"}.items():
        root, found = check_publishable(folder, house=HOUSE)
        assert found == [] and root == expected, "\n".join(each.sentence() for each in found)


def test_pictures_of_recordings_wait_for_somebody_who_read_the_licence(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made / "leaderboard" / "site", tmp_path / "site"))
    index = folder / "data" / "index.js"
    whole = decode_script(index.read_text())
    assert {scene["drawnBy"] for scene in whole["scenes"] if scene["hasSheet"]} == {"schematic"}
    name = whole["scenes"][0]["data"]
    for drawn_by in (None, "magicdrive"):
        for scene in whole["scenes"]:
            scene["drawnBy"] = drawn_by
        index.write_bytes(encode_script("window.CHALLENGER", whole))
        _, found = check_publishable(folder, house=HOUSE)
        assert found and {each.kind for each in found} == {"picture"}
        assert all(f"--may-show {name}" in each.says and str(drawn_by or "by cameras") in each.says for each in found)
        assert check_publishable(folder, may_show=[name], house=HOUSE)[1] == []
    index.write_bytes(index.read_bytes().replace(b'"scenes":', b'"seen":'))
    _, found = check_publishable(folder, may_show=[name], house=HOUSE)
    assert [each.kind for each in found] == ["picture"] and "origin is not recorded" in found[0].says


@pytest.mark.parametrize(
    ("text", "kind", "word"),
    [
        ('{"checkpoint": "/home/anna/weights/x.pth"}', "path", "/home/anna/weights/x.pth"),
        ("<p>/scratch/team/run-3</p>", "path", "/scratch/team/run-3"),
        ("made in C:\\Users\\anna\\out", "path", "C:\\Users\\anna\\out"),
        ('{"root": "D:\\\\data\\\\nuscenes"}', "path", "D:\\\\data\\\\nuscenes"),
        ("see file:///srv/x", "path", "file:///srv"),
        ("kept in ~/projects/secret", "path", "~/projects"),
        ("ran on GPU-box-7 at night", "host", "GPU-box-7"),
        ("address 192.168.3.14", "host", "192.168.3.14"),
        ("http://localhost:8000/x", "host", "localhost:8000"),
        ("ray://head.cluster.internal", "host", "head.cluster.internal"),
        ("by jdoe", "user", "jdoe"),
        ("mail anna.b@lab-x.example.org", "user", "anna.b@lab-x.example.org"),
        ("token hf_" + "a1" * 17, "secret", "hf_" + "a1" * 17),
        ("-----BEGIN RSA PRIVATE KEY-----", "secret", "-----BEGIN RSA PRIVATE KEY-----"),
    ],
)
def test_what_tells_of_the_house_is_found_with_its_line(tmp_path: Path, text: str, kind: str, word: str) -> None:
    found = found_in(tmp_path, site___data___x__js=f"// first\n{text}\n")
    assert PublicationFinding("site/data/x.js", 2, kind, repr(word)) in found  # type: ignore[arg-type]


def test_what_looks_like_it_and_is_not_stays(tmp_path: Path) -> None:
    texts = (
        "https://example.org/home/x/y",
        "../home/x and a/home/x",
        "and/or, km/h, 12/24",
        "version 4.11.0.86 and 1.10.0.0",
        "a laboratory, jdoes, gpu-box-71",
        r"\frac{a}{b} A:\alpha\beta",
        "@media (width) { a@2x }",
        "~3 m/s, ~/2",
        "${home}/scratch/x",
    )
    assert found_in(tmp_path, **{f"tables___{place}__txt": text for place, text in enumerate(texts)}) == []


def test_pictures_carry_no_paths_either_and_a_word_that_stands_often_is_counted(tmp_path: Path) -> None:
    picture = cv2.imencode(".webp", np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8))[1].tobytes()
    assert found_in(tmp_path, a__webp=picture) == []
    told = found_in(tmp_path, a__webp=picture + b"EXIF\0/home/anna/x.png\0gpu-box-7\0al")
    assert [each.kind for each in told] == ["host", "path"]
    found = found_in(tmp_path / "often", a__txt="jdoe\n" * 1000)
    assert len(found) == 6 and found[0] == PublicationFinding("a.txt", 0, "user", "'jdoe', 1000 times")


@pytest.mark.parametrize(
    ("name", "text", "kind", "says"),
    [
        ("index__html", "<html></html>", "request", "no security policy"),
        ("index__html", f"{POLICY}<script src='https://cdn.example.org/x.js'></script>", "request", "asks https://cdn"),
        ("index__html", f"{POLICY}<img src='//example.org/x.png'>", "request", "asks //example.org"),
        ("index__html", POLICY.replace("data:", "https://example.org"), "request", "policy allows https://example.org"),
        ("index__html", f"{POLICY}<link rel=stylesheet href='/style.css'>", "link", "begins at the host's root"),
        ("index__html", f"{POLICY}<img srcset='a.png 1x, gone.png 2x' src='a.png'>", "link", "gone.png is not in"),
        ("index__html", f"{POLICY}<a href='../../secret.html'>x</a>", "link", "points outside the folder"),
        ("deep___style__css", "a { background: url(../b.png) }", "link", "../b.png is not in the folder"),
        ("style__css", "@import 'https://fonts.example.org/x';", "request", "asks https://fonts"),
        ("app__js", "fetch('https://example.org/count')", "request", "asks https://example.org/count"),
        ("app__js", 'x.open("GET", "http://example.org")', "request", "asks http://example.org"),
        ("app__js", "new WebSocket(`wss://example.org`)", "request", "asks wss://example.org"),
        ("README__md", "[site](site/index.html)", "link", "site/index.html is not in the folder"),
        ("_private___x__txt", "x", "name", "begins with _"),
        ("A__png", "x", "name", "in capitals"),
        ("what?__txt", "x", "name", "a character that URLs"),
    ],
)
def test_what_needs_a_server_or_others_is_found(tmp_path: Path, name: str, text: str, kind: str, says: str) -> None:
    found = found_in(tmp_path, a__png=b"\0", **{name: text})
    assert [(each.kind, says in each.says) for each in found] == [(kind, True)], found


def test_what_stays_inside_is_no_finding(tmp_path: Path) -> None:
    page = (
        f"{POLICY}<link rel=icon href='data:image/svg+xml,x'><script src='app.js?v=1'></script><img src='a%20b.png'>"
        "<a href='#/scenes'>x</a><a href='https://example.org'>a link is no request</a><a href='sub/'>x</a>"
    )
    files: dict[str, str | bytes] = {
        "index__html": page,
        "app__js": 'const SVG = "http://www.w3.org/2000/svg"; fetch("data/x.json");',
        "a b__png": b"\0",
        "sub___x__svg": "<svg xmlns='http://www.w3.org/2000/svg'><a href='x.svg'/></svg>",
        "README__md": "[page](index.html#top) and [web](https://example.org)",
    }
    assert found_in(tmp_path, **files) == []


def test_links_out_of_the_folder_are_not_followed_and_what_is_no_leaderboard_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    with pytest.raises(InputError, match="is empty"):
        check_publishable(tmp_path / "site")
    (tmp_path / "secret.txt").write_text("/home/anna/x")
    (tmp_path / "site" / "x.txt").symlink_to(tmp_path / "secret.txt")
    assert [each.kind for each in found_in(tmp_path / "site")] == ["link"]
    with pytest.raises(InputError, match="there is no folder"):
        check_publishable(tmp_path / "nowhere")
    for text in ("", "x = JSON.parse('{');", "x = 3;"):
        with pytest.raises(InputError, match="write the leaderboard again"):
            decode_script(text)


def test_this_machine_is_known_without_names_that_tell_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    house = MachineIdentity.of_this_machine()
    assert "home" in house.folders and not {"root", "user", "localhost"} & {*house.users, *house.hosts}
    assert all(len(name) >= 3 for name in (*house.hosts, *house.users))
    for folder, told in (("/home", False), ("/home/annabelle", True)):
        monkeypatch.setenv("HOME", folder)
        assert (Path(folder).name in MachineIdentity.of_this_machine().users) is told


@settings(max_examples=10, deadline=None)
@given(
    st.recursive(
        st.none() | st.integers() | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
    )
)
def test_scripts_of_data_read_back(value: object) -> None:
    try:
        written = encode_script("window.X", value)
    except UnicodeEncodeError:
        return
    assert decode_script(written.decode()) == value


@pytest.mark.path
def test_the_command_ends_with_1_where_something_is_found(tmp_path: Path) -> None:
    folder = tmp_path / "leaderboard"
    write_leaderboard(read_results([hand_made("p", {"a": [HIT]})]), folder)
    (folder / "notes.txt").write_text("weights in /home/anna/x.pth\n")
    done = run_here("leaderboard", "--publish-check", tmp_path)
    assert done.code == 1 and "path: notes.txt:1: '/home/anna/x.pth'" in done.out
    said = json.loads(run_here("leaderboard", "--publish-check", folder, "--json").out)
    assert {"file": "notes.txt", "line": 1, "kind": "path", "says": "'/home/anna/x.pth'"} in said["findings"]
    (folder / "notes.txt").unlink()
    clean = run_here("leaderboard", "--publish-check", folder)
    assert clean.code == 0 and "nothing reveals this machine" in clean.out
    assert run_here("leaderboard", "--may-show", "x").code == 2
    assert run_here("leaderboard", "--check", "--publish-check", folder).code == 2
