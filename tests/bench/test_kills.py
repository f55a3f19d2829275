"""Commands that are killed: a small sample leaves no trace, and traces that are planted are found."""

import os
from pathlib import Path

import pytest

from bench.attacking import children
from bench.attacking.campaign import preload
from bench.killing.commands import COMMANDS
from bench.killing.series import KillBench, differences, listing
from bench.kills import table


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> KillBench:
    preload()
    return KillBench(tmp_path_factory.mktemp("kills"), seed=1)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "how"), [("generate", "kill"), ("drive over HTTP", "server")])
def test_a_command_that_is_disturbed_leaves_what_an_undisturbed_one_leaves(
    bench: KillBench, name: str, how: str
) -> None:
    found = bench.disturbed(COMMANDS[name], how, 1, 0)
    assert found.same and found.files > 10, found
    assert table([found]).splitlines()[2].endswith("| 1 |")
    assert (bench.case / "out" / "timings").is_dir()
    assert not any(path.startswith("out/timings") for path in listing(bench.case))


@pytest.mark.slow
def test_a_command_that_leaves_a_trace_of_a_kill_is_found(bench: KillBench, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = bench.disturbed(COMMANDS["drive"], "kill", 1, 1)

    def untidy() -> int:
        (bench.case / "out" / f".left.{os.getpid()}").write_bytes(b"")
        return 0

    monkeypatch.setattr(children, "_run", untidy)
    found = bench.disturbed(COMMANDS["drive"], "kill", 1, 1)
    assert honest.same and not found.same
    assert any("left over" in each for each in found.differences) and any(
        "missing" in each for each in found.differences
    )


def test_every_difference_is_seen(tmp_path: Path) -> None:
    for name in ("one", "other"):
        (tmp_path / name / "out" / "empty").mkdir(parents=True)
        (tmp_path / name / "out" / ".hidden").write_bytes(b"same")
    assert differences(listing(tmp_path / "one"), listing(tmp_path / "other")) == []
    (tmp_path / "other" / "out" / ".hidden").write_bytes(b"else")
    (tmp_path / "other" / "out" / "empty").rmdir()
    (tmp_path / "other" / "out" / "link").symlink_to("nowhere")
    assert differences(listing(tmp_path / "one"), listing(tmp_path / "other")) == [
        "out/.hidden: other bytes",
        "out/empty/: missing",
        "out/link: left over",
    ]
