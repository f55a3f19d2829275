"""Places are checked without a trace, and disks for the room that is needed."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.machine.path_checks import require_output_file, require_place, require_room
from tests.benchmark.cli.cli_runs import refusal

Have = Callable[[float], None]


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Have:
    """Lets every disk have so many bytes free."""

    def have(count: float) -> None:
        def usage(path: Any) -> SimpleNamespace:
            assert Path(path).exists()
            return SimpleNamespace(free=int(count))

        monkeypatch.setattr("shutil.disk_usage", usage)

    return have


def test_a_place_that_can_be_written_to_stays_as_it_was(tmp_path: Path) -> None:
    require_place(tmp_path / "a" / "b", "--out")
    require_output_file(tmp_path / "a" / "matrix.png", "--figure", (".png",))
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused(tmp_path: Path, free: Have) -> None:
    free(5e8)
    require_room(tmp_path / "a", 500_000_000, "it", "--out")
    with pytest.raises(InputError, match=r"it needs about 3\.5 GB in .*a and 0\.5 GB are free; .* with --out"):
        require_room(tmp_path / "a", 3_500_000_000, "it", "--out")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("eval --model idm", "the embedded data set needs about 0.19 GB"),
        ("generate --split val-r --size 896x512", "the embedded data set needs about 0.19 GB"),
        ("demo", "the demo needs about 0.05 GB"),
    ],
)
def test_nothing_is_begun_that_the_disk_has_no_room_for(
    tmp_path: Path, free: Have, monkeypatch: pytest.MonkeyPatch, arguments: str, says: str
) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    free(2e7)
    assert says in refusal(*arguments.split(), "--out", tmp_path / "out")
    free(5e8)
    if arguments.startswith("generate"):
        assert "split val-r needs about 4.4 GB" in refusal(*arguments.split(), "--out", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
