"""The commands of docs/extensions/challenge.md, run as they stand there, on the small town."""

from pathlib import Path

from benchmark.datasets.roots import DataSet
from benchmark.extensions.challenge.rules import RULE_SETS, read_rules
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.challenge.forgeries import FORGERIES
from tests.benchmark.extensions.challenge.small_entries import Forged
from tests.test_pages import ROOT, command_lines

PAGE = (ROOT / "docs" / "extensions" / "challenge.md").read_text()


def test_every_command_of_the_page_runs(entry: Path, base: DataSet, tmp_path: Path) -> None:
    another = Forged.copy(entry, tmp_path / "another")
    # Other bytes and the same scenes.
    with another.rows("log") as rows:
        rows[0]["vehicle"] = "n009"
    (tmp_path / "rules.toml").write_text(run_here("challenge", "rules").out)
    stand_ins = {
        "ENTRY": str(entry),
        "ENTRY_A": str(entry),
        "ENTRY_B": str(another.root),
        "/data/nuscenes": str(base.root),
        "rules.toml": str(tmp_path / "rules.toml"),
        "uniad": "constant-velocity",
        "vad": "stop",
    }
    lines = [[stand_ins.get(word, word) for word in line] for line in command_lines(PAGE)]
    assert [" ".join(line[:2]) for line in lines] == [
        "challenge rules",
        "challenge check",
        "challenge score",
        "leaderboard",
    ]
    for line in lines:
        place = [] if line[1:2] == ["rules"] else ["--out", str(tmp_path / "out")]
        done = run_here(*line, *place)
        assert done.code == 0, (line, done.err)
    assert (tmp_path / "out" / "challenge" / "scores-challenge.json").is_file()


def test_the_rules_of_the_page_are_rules(tmp_path: Path) -> None:
    block = PAGE.partition("```toml\n")[2].partition("```")[0]
    (tmp_path / "rules.toml").write_text(block)
    assert read_rules(tmp_path / "rules.toml").scenes.required == ("scene-0061", "scene-0553")


def test_the_figures_of_the_page_are_those_of_the_rules() -> None:
    assert f"{len(FORGERIES)} of them" in PAGE
    for name, column in (("default", 1), ("strict", 2)):
        motion = RULE_SETS[name].motion
        said = next(line for line in PAGE.splitlines() if "lateral_m_s2" in line).split("|")[column + 1].strip()
        assert said == f"{motion.acceleration_m_s2:g}, {motion.braking_m_s2:g}, {motion.lateral_m_s2:g}"
