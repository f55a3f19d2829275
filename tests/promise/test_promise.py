"""Public names, options, JSON and exit codes are those of the snapshots, and their changes are written down."""

import shutil
import sys
from pathlib import Path

import pytest

from benchmark.cli import app as command_line
from tests.promise import surface
from tests.promise.answers import Options, of_face, unanswered
from tests.promise.said import said, small_town
from tests.promise.snapshots import CHANGELOG, HOW, SNAPSHOTS, broken_unsaid, gone_unsaid, stored, unsaid, word_of
from tests.whole_product import needs_extensions

MADE_UP = """# Changelog

## 0.2.0 (unreleased)

- `eval --horizon` is gone; `evaluate` takes `seed`. `data card` is new. Affects scores: no.

## 0.1.0

- `--old`, `older`.
"""


@needs_extensions
@pytest.mark.parametrize("name", SNAPSHOTS)
def test_names_and_options_are_those_of_the_snapshot(name: str) -> None:
    before, now = set(stored(name)), set(SNAPSHOTS[name]())
    changed = [f"{'-' if line in before else '+'} {line}" for line in sorted(before ^ now)]
    assert not changed, f"{HOW}\n" + "\n".join(changed)


@pytest.mark.parametrize("name", SNAPSHOTS)
def test_whatever_is_gone_or_changed_since_the_promise_is_in_the_changelog(name: str) -> None:
    missing = broken_unsaid(stored(name, "then"), stored(name), CHANGELOG.read_text())
    assert not missing, f"the unreleased part of CHANGELOG.md does not mention {', '.join(missing)}"


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("small") / "town")


def test_no_command_takes_a_member_of_its_json_away(town: Path, tmp_path: Path) -> None:
    printed = said(town, tmp_path / "out")
    before, now = set(stored("json")), set(printed)
    changed = [f"{'-' if line in before else '+'} {line}" for line in sorted(before ^ now)]
    assert not changed, f"{HOW}\n" + "\n".join(changed)
    missing = gone_unsaid(stored("json", "then"), printed, CHANGELOG.read_text())
    assert not missing, f"the unreleased part of CHANGELOG.md does not mention {', '.join(missing)}"


@pytest.mark.parametrize(
    ("before", "now", "missing"),
    [
        ([], ["challenger-bench data card | command", "challenger-bench data card | --to | Path, required"], []),
        ([], ["challenger-bench data deck | command", "challenger-bench data deck | --to | Path, required"], ["deck"]),
        (["challenger-bench eval | --horizon | int, required"], [], []),
        (["challenger-bench eval | --old | int, required"], [], ["--old"]),
        (["challenger-bench eval | --old/--no-old | bool"], ["challenger-bench eval | --old | bool"], ["--old"]),
        (["evaluate(seed: 5 = 0)"], ["evaluate(seed: by name = 0)"], []),
        (["older(seed: 5 = 0)"], ["older(seed: by name = 0)"], ["older"]),
        ([], ["Older class", "Older.field field"], ["Older"]),
    ],
)
def test_a_change_without_a_line_in_the_unreleased_part_is_found(
    before: list[str], now: list[str], missing: list[str]
) -> None:
    assert unsaid(before, now, MADE_UP) == missing
    assert broken_unsaid(before, now, MADE_UP) == (missing if before else [])


def test_members_that_are_gone_are_found_and_new_ones_may_come() -> None:
    before = ["challenger-bench eval | [].older", "challenger-bench eval | [].seed[].evaluate[]"]
    assert gone_unsaid(before, ["challenger-bench eval | new"], MADE_UP) == ["older"]
    assert gone_unsaid(before, [*before, "challenger-bench eval | new"], MADE_UP) == []
    assert word_of("challenger-bench verify | what | physics") == "verify"


def test_paths_of_members_put_a_star_for_names() -> None:
    value = {"columns": {"a": {"1s": {"value": 1}}, "b": {"2s": {"value": 1}}}, "rows": [{"x": 1}, {"y": [[2]]}]}
    assert surface.members(value) == {
        *("columns", "columns.*", "columns.*.*", "columns.*.*.value"),
        *("rows", "rows[]", "rows[].x", "rows[].y", "rows[].y[]", "rows[].y[][]"),
    }


def exit_code(*arguments: str, monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(sys, "argv", ["challenger-bench", *arguments])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    return ended.value.code


def test_exit_codes_are_as_promised(town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def code(*arguments: str) -> object:
        return exit_code(*arguments, monkeypatch=monkeypatch)

    assert code("--version") == 0
    assert code("models", "--json") == 0
    assert code("eval", "--no-such-option") == code("no-such-command") == code("data", "info", str(tmp_path)) == 2

    broken = Path(shutil.copytree(town, tmp_path / "town"))
    next(broken.glob("*/sample.json")).write_text("[]")
    assert code("data", "check", str(broken)) == 1

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("adapters.planner_listing.known_planners", interrupted)
    assert code("models") == 130


ANSWERS = {"face": of_face, "options": Options(stored("options", "then")).of}


@needs_extensions
@pytest.mark.parametrize("name", SNAPSHOTS)
def test_whatever_was_promised_answers_or_says_its_new_name(name: str) -> None:
    broken = unanswered(stored(name, "then"), ANSWERS[name])
    assert not broken, "\n".join(broken)


GONE = {
    "evaluate2 function": "evaluate2",
    "Scene.ego2 field": "Scene.ego2",
    "evaluate(sed: by name = 0)": "evaluate(sed)",
    "challenger-bench eval | --horizon | int, default 1": "challenger-bench eval | --horizon",
    "challenger-bench data info | --horizon/--no-horizon | bool, default False": (
        "challenger-bench data info | --horizon/--no-horizon"
    ),
    "challenger-bench eval | --image-format | gif": "challenger-bench eval | --image-format | gif",
    "challenger-bench review | command": "challenger-bench review | command",
}


@pytest.mark.parametrize("line", GONE)
def test_what_is_gone_needs_an_entry_whose_new_name_is_said(line: str) -> None:
    answer = ANSWERS["options" if " | " in line else "face"]
    refused = answer(line)
    assert refused is not None
    assert "has no new name" in unanswered([line], answer, {})[0]
    assert "does not say" in unanswered([line], answer, {GONE[line]: "--after"})[0]
    assert not unanswered([line], lambda _: "error: it is --after now\n", {GONE[line]: "--after"})
    assert unanswered([line], lambda _: "Traceback\nit is --after now\n", {GONE[line]: "--after"})


def test_an_option_that_wants_more_than_before_is_found() -> None:
    before = Options(["challenger-bench data show | root | Path, required"])
    refused = before.of("challenger-bench data show | --limit | int, default None")
    assert refused is not None and "--to" in refused
    assert of_face("evaluate(data: 3, required)") is not None
