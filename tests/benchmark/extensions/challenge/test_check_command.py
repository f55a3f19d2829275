import json
import re
import shutil
from pathlib import Path

from benchmark.datasets.roots import DataSet
from benchmark.extensions.challenge.page import format_page
from benchmark.extensions.challenge.rules import ChallengeRules, read_rules
from benchmark.records.challenge import (
    ChangedVehicle,
    ComparedData,
    EntryVerdict,
    RefusalReason,
    SceneVerdict,
    read_verdict,
)
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.challenge.small_entries import LEADER, Forged


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
    vehicle = ChangedVehicle(
        instance=nasty,
        recorded=nasty,
        category=nasty,
        from_s=0.0,
        farthest_m=1.0,
        least_gap_ego_m=None,
        least_gap_others_m=None,
    )
    scene = SceneVerdict(
        scene=nasty,
        recording=nasty,
        reasons=(RefusalReason(rule=nasty, sentence=nasty),),
        notes=(nasty,),
        changed=(vehicle,),
    )
    data = ComparedData(name=nasty, fingerprint="0" * 64)
    verdict = EntryVerdict(
        version="1",
        entry=data,
        base=data,
        challenge=nasty,
        rules="0" * 64,
        reasons=scene.reasons,
        scenes=(scene,),
    )
    text = format_page(verdict, ChallengeRules(name=nasty), {})
    assert "<script" not in text and text.count("&lt;script&gt;") > 10
    opened = re.findall(r"<(section|div|ul|li|table|tr|td|th|p|h\d|code|pre|span)\b", text)
    assert {tag: opened.count(tag) for tag in opened} == {tag: text.count(f"</{tag}>") for tag in opened}
