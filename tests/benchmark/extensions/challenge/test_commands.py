"""Checking, the page and the rules, as a user runs them; rules in files, alone and packed with a split."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.extensions.challenge.page import format_page
from benchmark.extensions.challenge.rules import RULE_SETS, ChallengeRules, format_rules, read_rules
from benchmark.records.challenge import EntryVerdict, read_verdict
from benchmark.untrusted.compressed import read_package
from generation.splits.building import build_frozen
from generation.splits.packing import PackageContents, WrittenPackage, pack_split
from generation.splits.unpacking import read_split_package, write_package_files
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.challenge.forgeries import FORGERIES
from tests.benchmark.extensions.challenge.small_entries import LEADER, Forged
from tests.documentation.lines_of_code import ROOT, typed_lines
from tests.generation.splits.frozen_files import drifting_split, recordings
from tests.generation.splits.test_packing import HERE, PLAIN, changed, replaced


@pytest.mark.path
def test_an_honest_entry_leaves_a_verdict_and_a_page(entry: Path, base: DataSet, tmp_path: Path) -> None:
    done = run_here(
        *("challenge", "check", entry, "--base", base.root, "--out", tmp_path, "--workers", "1"),
        *("--scenes", "scene-9901-a"),
    )
    assert (done.code, done.out) == (0, "accepted: scene-9901-a\n1 of 1 scene of honest accepted\n")
    folder = tmp_path / "challenge" / "honest"
    verdict = read_verdict(folder / "verdict.json")
    assert verdict.accepted and verdict.base.fingerprint == base.fingerprint()
    page = (folder / "index.html").read_text()
    assert page.count('src="data:image/png;base64,') == 1 and "<script" not in page


@pytest.mark.path
def test_a_forged_entry_ends_with_1_and_json_is_what_is_written(entry: Path, base: DataSet, tmp_path: Path) -> None:
    forged = Forged.copy(entry, tmp_path / "forged")
    forged.annotations(lambda _, row: row["translation"].__setitem__(0, row["translation"][0] + 0.05), LEADER)
    (tmp_path / "rules.toml").write_text('name = "of 5 cm"\n[images]\nrequired = false\n')
    done = run_here(
        *("challenge", "check", forged.root, "--base", base.root, "--to", tmp_path / "to", "--workers", "1"),
        *("--rules", tmp_path / "rules.toml", "--no-page", "--json"),
    )
    assert done.code == 1
    assert json.loads(done.out) == json.loads((tmp_path / "to" / "verdict.json").read_text())
    verdict = read_verdict(tmp_path / "to" / "verdict.json")
    assert [scene.accepted for scene in verdict.scenes] == [False, True]
    assert verdict.challenge == "of 5 cm" and not (tmp_path / "to" / "index.html").exists()


def test_an_entry_without_pictures_is_accepted_where_rules_ask_for_none(
    entry: Path, base: DataSet, tmp_path: Path
) -> None:
    bare = Forged.copy(entry, tmp_path / "bare")
    for folder in bare.root.glob("samples/CAM_*"):
        shutil.rmtree(folder)
    with bare.rows("sample_data") as rows:
        rows[:] = [row for row in rows if "CAM_" not in row["filename"]]
    (tmp_path / "rules.toml").write_text("[images]\nrequired = false\n")
    given = ("challenge", "check", bare.root, "--base", base.root, "--to", tmp_path / "to", "--no-page")
    whole = (*given, "--workers", "1", "--json")
    verdicts = [json.loads(run_here(*whole, *more).out) for more in ((), ("--rules", tmp_path / "rules.toml"))]
    reasons = [{reason["rule"] for scene in each["scenes"] for reason in scene["reasons"]} for each in verdicts]
    assert reasons == [{"images.required"}, set()]


def test_bad_input_is_one_sentence_and_2(entry: Path, base: DataSet, tmp_path: Path) -> None:
    (tmp_path / "rules.toml").write_text("[changed]\nmots = 1")
    for arguments, says in (
        ((tmp_path / "none", "--base", base.root), "does not exist"),
        ((entry, "--base", tmp_path / "none"), "no folder"),
        ((entry, "--base", base.root, "--rules", tmp_path / "rules.toml"), "changed.mots"),
        ((entry, "--base", base.root, "--rules", tmp_path / "none.toml"), "does not exist"),
        ((entry, "--base", base.root, "--scenes", "scene-1"), "no scene 'scene-1'"),
        ((base.root, "--base", entry), "which"),
        ((entry, "--base", base.root, "--workers", "-1"), "--workers"),
    ):
        done = run_here("challenge", "check", *arguments, "--out", tmp_path)
        assert done.code == 2 and says in done.err and done.err.count("\n") == 1, done


def test_rules_are_printed_whole_and_read_again(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[gaps]\nothers_m = 0.5")
    done = run_here("challenge", "rules", tmp_path / "mine.toml")
    (tmp_path / "whole.toml").write_text(done.out)
    assert read_rules(tmp_path / "whole.toml") == read_rules(tmp_path / "mine.toml") != ChallengeRules()
    strict = json.loads(run_here("challenge", "rules", "--set", "strict", "--json").out)
    assert strict["rules"]["motion"]["braking_m_s2"] == 5.0


def test_a_page_shows_what_strangers_wrote_as_text() -> None:
    nasty = '<script>alert("x")</script>'
    measured = {"from_s": 0.0, "farthest_m": 1.0, "least_gap_ego_m": None, "least_gap_others_m": None}
    vehicle = {"instance": nasty, "recorded": nasty, "category": nasty, **measured}
    reasons, data = ({"rule": nasty, "sentence": nasty},), {"name": nasty, "fingerprint": "0" * 64}
    scene = {"scene": nasty, "recording": nasty, "reasons": reasons, "notes": (nasty,), "changed": (vehicle,)}
    said = {"version": "1", "entry": data, "base": data, "challenge": nasty, "rules": "0" * 64, "reasons": reasons}
    verdict = EntryVerdict.model_validate({**said, "scenes": (scene,)})
    text = format_page(verdict, ChallengeRules(name=nasty), {})
    assert "<script" not in text and text.count("&lt;script&gt;") > 10
    opened = re.findall(r"<(section|div|ul|li|table|tr|td|th|p|h\d|code|pre|span)\b", text)
    assert {tag: opened.count(tag) for tag in opened} == {tag: text.count(f"</{tag}>") for tag in opened}


PAGE = ROOT / "docs" / "extensions" / "challenge.md"


def test_every_command_of_the_page_runs(entry: Path, base: DataSet, tmp_path: Path) -> None:
    another = Forged.copy(entry, tmp_path / "another")
    # Other bytes and the same scenes.
    with another.rows("log") as rows:
        rows[0]["vehicle"] = "n009"
    (tmp_path / "rules.toml").write_text(run_here("challenge", "rules").out)
    stand_ins = dict.fromkeys(("ENTRY", "ENTRY_A"), str(entry)) | {"uniad": "constant-velocity", "vad": "stop"}
    places = {"ENTRY_B": another.root, "/data/nuscenes": base.root, "rules.toml": tmp_path / "rules.toml"}
    stand_ins |= {word: str(path) for word, path in places.items()}
    typed = [line.text.split()[1:] for line in typed_lines(PAGE) if line.text.startswith("challenger-bench ")]
    lines = [[stand_ins.get(word, word) for word in line] for line in typed]
    assert [line[1] if line[0] == "challenge" else line[0] for line in lines] == [
        "rules",
        "check",
        "score",
        "leaderboard",
    ]
    here = ("--out", tmp_path / "out")
    for line, more in zip(lines, ((), (*here, "--workers", "1"), (*here, "--workers", "1"), here)):
        done = run_here(*line, *more)
        assert done.code == 0, (line, done.err)
    assert (tmp_path / "out" / "challenge" / "scores-challenge.json").is_file()
    assert "challenge challenge" in (tmp_path / "out" / "leaderboard" / "README.md").read_text()
    assert run_here("leaderboard", "--check", "--out", tmp_path / "out").code == 0


def test_rules_and_figures_of_the_page_are_those_of_the_program(tmp_path: Path) -> None:
    text = PAGE.read_text()
    (tmp_path / "rules.toml").write_text(text.partition("```toml\n")[2].partition("```")[0])
    assert read_rules(tmp_path / "rules.toml").scenes.required == ("scene-0061", "scene-0553")
    assert f"{len({forgery.name for forgery in FORGERIES})} of them" in text
    for name, column in (("default", 1), ("strict", 2)):
        motion = RULE_SETS[name].motion
        said = next(line for line in text.splitlines() if "lateral_m_s2" in line).split("|")[column + 1].strip()
        assert said == f"{motion.acceleration_m_s2:g}, {motion.braking_m_s2:g}, {motion.lateral_m_s2:g}"


def read(folder: Path, text: str) -> ChallengeRules:
    path = folder / "rules.toml"
    path.write_text(text)
    return read_rules(path)


def test_what_is_written_is_read_and_nothing_is_the_defaults(tmp_path: Path) -> None:
    assert read_rules(None) == ChallengeRules() == read(tmp_path, "")
    for rules in RULE_SETS.values():
        assert read(tmp_path, format_rules(rules)) == rules
    assert all("  # " in line for line in format_rules(ChallengeRules()).splitlines()[1:] if line)
    # The name decides nothing.
    assert read(tmp_path, 'name = "another"').fingerprint == ChallengeRules().fingerprint
    assert read(tmp_path, "[changed]\nmost = 2").fingerprint != ChallengeRules().fingerprint


@settings(max_examples=25, deadline=None)
@given(
    name=some.text(some.characters(codec="utf-8", exclude_characters="\n")),
    most=some.integers(1, 9),
    position_m=some.floats(0, 1e6),
    categories=some.lists(some.text(some.characters(codec="utf-8")), max_size=3),
)
def test_any_rules_survive_their_file(
    tmp_path_factory: pytest.TempPathFactory, name: str, most: int, position_m: float, categories: list[str]
) -> None:
    said = {"most": most, "categories": categories}
    rules = ChallengeRules.model_validate({"name": name, "changed": said, "unchanged": {"position_m": position_m}})
    assert read(tmp_path_factory.mktemp("rules"), format_rules(rules)) == rules


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[changed]\nmost = -1", "changed.most"),
        ("[changed]\nleast = 3", "at least 3 and at most 1"),
        ("[changed]\nmots = 2", "changed.mots"),
        ("[motion]\nbraking_m_s2 = nan", "motion.braking_m_s2"),
        ("[motion]\nbraking_m_s2 = 'hard'", "motion.braking_m_s2"),
        ("schema = 2", "schema"),
        ("[changed", "not valid TOML"),
        ("a = " + "[" * 5000, "not valid TOML"),
    ],
)
def test_rules_that_cannot_be_are_refused_in_a_sentence(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        read(tmp_path, text)
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        read_rules(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid TOML"):
        read_rules(tmp_path / "binary.toml")


RULES = b"[changed]\nmost = 2\n"


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> PackageContents:
    folder = tmp_path_factory.mktemp("packed")
    source = recordings(folder / "recorded")
    split = drifting_split(source, folder / "road-adv-1.json")
    build_frozen(source, split, replace(PLAIN, out=folder / "built"))
    (folder / "rules.toml").write_bytes(RULES)
    return PackageContents((split,), open_data(folder / "built"), (), folder / "rules.toml")


@pytest.fixture(scope="module")
def packed(contents: PackageContents, tmp_path_factory: pytest.TempPathFactory) -> WrittenPackage:
    return pack_split(tmp_path_factory.mktemp("package") / "road.zip", contents, HERE)


def test_rules_are_in_the_package_byte_for_byte(
    packed: WrittenPackage, contents: PackageContents, tmp_path: Path
) -> None:
    assert pack_split(tmp_path / "again.zip", contents, HERE).sha256 == packed.sha256
    assert sorted(file.kind for file in packed.manifest.files.values()) == ["rules", "split", "statistics"]
    assert read_package(packed.path)["rules/rules.toml"] == RULES
    write_package_files(read_split_package(packed.path), tmp_path / "files")
    assert (tmp_path / "files" / "rules" / "rules.toml").read_bytes() == RULES


def test_the_commands_of_the_page(packed: WrittenPackage, contents: PackageContents, tmp_path: Path) -> None:
    assert contents.rules is not None
    folder = contents.rules.parent
    done = run_here(
        "data", "pack", folder / "road-adv-1.json", "--root", folder / "built", "--rules", folder / "rules.toml",
        "--to", tmp_path / "road.zip", "--workers", "1",
    )  # fmt: skip
    assert done.code == 0 and packed.sha256 in done.out, done.err
    done = run_here("data", "unpack", tmp_path / "road.zip", "--to", tmp_path / "files")
    assert done.code == 0 and "is intact: 3 files" in done.out, done.err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda members: members.pop("rules/rules.toml"), "lacks rules/rules.toml"),
        (replaced("rules", b"[changed]\nmost = 9\n"), "does not match the manifest"),
    ],
)  # fmt: skip
def test_what_was_tampered_with_is_refused(packed: WrittenPackage, tmp_path: Path, change: Any, message: str) -> None:
    done = run_here("data", "unpack", changed(packed, tmp_path, change), "--to", tmp_path / "files")
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1
    assert not (tmp_path / "files").exists()


def test_what_are_no_rules_is_not_packed(contents: PackageContents, tmp_path: Path) -> None:
    wheels = "changed.wheels: .*; see docs/extensions/challenge.md"
    for text, message in (("most = = 1", "is not valid TOML"), ("[changed]\nwheels = 3", wheels)):
        (tmp_path / "rules.toml").write_text(text)
        with pytest.raises(InputError, match=message):
            pack_split(tmp_path / "wrong.zip", replace(contents, rules=tmp_path / "rules.toml"), HERE)
    assert not (tmp_path / "wrong.zip").exists()


def test_rules_that_are_there_are_never_replaced(packed: WrittenPackage, tmp_path: Path) -> None:
    (tmp_path / "rules").mkdir()
    (tmp_path / "rules" / "rules.toml").write_text("mine = 1")
    with pytest.raises(InputError, match="exists with other content"):
        write_package_files(read_split_package(packed.path), tmp_path)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["rules.toml"]
