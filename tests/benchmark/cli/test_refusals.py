"""What is cheap to check is checked before anything is built: each wrong argument of every command, an empty cache."""

from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import run_main
from tests.benchmark.cli.refusals import DRY, MISTAKES, WRONG, Refusal, all_refusals, make_places

BOTH = "splits val and adv, the default; --split chooses others"


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Refusal]:
    return all_refusals(tmp_path_factory.mktemp("refusals"))


@pytest.mark.parametrize(("arguments", "says"), WRONG)
def test_a_wrong_argument_is_refused_at_once(refusals: dict[str, Refusal], arguments: str, says: str) -> None:
    refused = refusals[arguments]
    assert refused.refused and says in refused.sentence and "\n" not in refused.sentence
    assert refused.left == [] and refused.imported == []


def test_the_mistakes_of_the_first_hour_end_with_exit_code_2_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = make_places(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert len(MISTAKES) == 25
    for arguments, says in MISTAKES:
        run = run_main(*arguments.format(**places).split(), cache=tmp_path / "cache")
        assert (run.code, run.out) == (2, ""), arguments
        *default, refusal = run.err.splitlines()
        assert default in ([], [BOTH]) and refusal.startswith("error: ") and says in refusal, run.err


@pytest.mark.parametrize(("arguments", "says"), DRY)
def test_a_dry_run_builds_nothing_and_says_what_would_be(
    refusals: dict[str, Refusal], arguments: str, says: str
) -> None:
    dry = refusals[arguments]
    assert not dry.refused and f"would then {says}" in dry.sentence
    needed = "0.062 GB" if "mini@1" in arguments else "0.19 GB"
    assert "would first build the embedded data set in" in dry.sentence and f"about a minute, {needed}" in dry.sentence
    assert ("the frozen split" in dry.sentence) == (says.endswith("of adv"))
    assert dry.left == [] and dry.imported == []
