"""``generate`` and ``ablate`` as a user meets them."""

from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import run_main


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("generate", "--split", "test"), "val-r"),
        (("generate", "--from", "mini-adv-0"), "mini-adv-1"),
        (("generate", "--from", "mini-adv-1", "--top", "3"), "--top"),
        (("generate", "--from", "mini-adv-1", "--set", "candidates=8"), "--set"),
        (("generate", "--from", "mini-adv-1", "--freeze", "again.json"), "--freeze"),
        (("generate", "--from", "mini-adv-1", "--split", "val-r"), "--split"),
        (("generate", "--freeze", "nowhere/again.json"), "nowhere"),
        (("generate", "--split", "val-r", "--freeze", "again.json"), "only adv"),
    ],
)
def test_a_mistyped_option_is_told_before_anything_is_built(
    tmp_path: Path, arguments: tuple[str, ...], word: str
) -> None:
    run = run_main(*arguments, "--out", tmp_path / "out", cache=tmp_path / "cache")
    assert (run.code, run.out) == (2, "")
    assert run.err.startswith("error: ") and run.err.count("\n") == 1
    assert word in run.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("command", "preset"), [("generate", "paper"), ("ablate", "reference")])
def test_a_dry_run_lists_where_a_preset_departs_from_its_name(tmp_path: Path, command: str, preset: str) -> None:
    arguments = (command, "--preset", preset, "--set", "tries=2", "--dry-run", "--out", tmp_path / "out")
    run = run_main(*arguments, cache=tmp_path / "cache")
    assert run.code == 0 and run.err in ("", "split adv, the default; --split chooses another\n")
    assert f"preset {preset} departs from the {'text' if preset == 'paper' else 'code'} in" in run.out
    assert "- tries is 1; here it is 2, because it was asked for" in run.out
    assert "--denoiser FILE takes them" in run.out
    assert list(tmp_path.iterdir()) == []


def test_the_default_preset_has_nothing_to_list(tmp_path: Path) -> None:
    run = run_main("generate", "--dry-run", "--out", tmp_path / "out", cache=tmp_path / "cache")
    assert run.code == 0 and "departs" not in run.out
