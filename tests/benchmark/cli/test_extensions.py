"""Extensions that are not there, and those of other packages that are broken."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer

from benchmark.cli import settings
from benchmark.cli.app import add_commands_of_others
from benchmark.cli.eval_options import EvalOptions
from benchmark.cli.settings import Option, list_fields
from benchmark.closed_loop.engines import list_engines, make_backend
from benchmark.errors import InputError
from benchmark.machine import extension
from benchmark.machine.extension import OFFERS, call_extension, list_offers
from benchmark.protocols import PROTOCOLS, find_protocol

ROOT = Path(__file__).resolve().parents[3]
WITHOUT = """
import sys

package = sys.argv.pop(1)

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name == package or name.startswith(package + "."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
from benchmark.cli.app import main
main()
"""


def run_without(package: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, package, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_command_of_an_extension_that_is_not_there_says_so_whatever_its_arguments() -> None:
    asked = run_without("benchmark.extensions.cards", "data", "card", "--some", "thing")
    assert asked.returncode == 2, asked.stderr
    (line,) = asked.stderr.splitlines()
    assert line.startswith("error: data card belongs to the extension cards, which is not installed here; ")


def test_a_command_of_the_core_that_asks_for_an_extension_says_which(tmp_path: Path) -> None:
    for package, name, arguments in (
        ("benchmark.extensions.golden_sets", "golden_sets", ("verify", "protocols")),
        ("leaderboard.extensions.publishing", "publishing", ("leaderboard", "--publish-check", str(tmp_path))),
    ):
        done = run_without(package, *arguments)
        assert done.returncode == 2, done.stderr
        assert done.stderr.splitlines()[-1] == (
            f"error: this needs the extension {name}, which is not installed; install it"
        )


@dataclass
class Entry:
    """An entry point of another package."""

    name: str
    table: dict[str, dict[str, str]] | None

    def load(self) -> dict[str, dict[str, str]]:
        if self.table is None:
            raise ImportError("no such\nmodule")
        return self.table


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Let other packages seem installed; what was read of them is forgotten before and after."""
    kept = (extension._read_other_packages, extension.warn, settings._list_fields)

    def put(*entries: Entry) -> None:
        monkeypatch.setattr(extension, "entry_points", lambda group: [*entries] if group == extension.GROUP else [])
        for function in kept:
            function.cache_clear()

    yield put
    monkeypatch.undo()
    for function in kept:
        function.cache_clear()


def told(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().err.splitlines()


def test_a_broken_extension_of_another_package_costs_its_own_commands_alone(
    install: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    words = {"theirs": f"{__name__}:command_of_theirs", "data more": f"{__name__}:GROUP_OF_THEIRS"}
    install(
        Entry("broken", None),
        Entry("absent", {"command": {"gone": "no_such_module:x"}}),
        Entry("sound", {"command": words}),
    )
    app, data = typer.Typer(), typer.Typer()
    add_commands_of_others({"": app, "data": data})
    assert [command.name for command in app.registered_commands] == ["theirs"]
    assert [group.name for group in data.registered_groups] == ["more"]
    assert told(capsys) == [
        "warning: the extension broken is left out, its table cannot be read (ImportError: no such module); reinstall "
        "it",
        "warning: the command gone of the extension absent cannot be imported (ModuleNotFoundError: No module named "
        "'no_such_module'); reinstall or remove it",
    ]


def test_names_that_are_taken_and_kinds_that_there_are_not_are_left_out(
    install: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    mine = {"command": {"film": "a:b", "eval": "a:b", "in no group": "a:b"}, "colour": {"red": "a:b"}}
    install(
        Entry("first", {**mine, "engine": {"default": "a:b", "rails": "a:b"}}),
        Entry("second", {"engine": {"rails": "c:d"}}),
    )
    groups = {"": typer.Typer(), "data": typer.Typer()}
    groups[""].command("eval")(command_of_theirs)
    add_commands_of_others(groups)
    assert [command.name for command in groups[""].registered_commands] == ["eval"]
    assert list_engines() == ("default", *OFFERS["engine"], "rails")
    assert list_offers("engine")["rails"] == "a:b"
    said = told(capsys)
    for sentence in (
        "the extension first offers the command film, which films offers already",
        "the extension first offers the kind colour, which is none of command, engine, ",
        "the extension second offers the engine rails, which first offers already",
        "the command eval of the extension first is left out: the core has that name",
        "the engine default of the extension first is left out: the core has that name",
        "the command in no group of the extension first cannot be ",
    ):
        assert [line.startswith(f"warning: {sentence}") for line in said].count(True) == 1, said


def test_what_fails_in_another_package_is_one_sentence(install: Callable[..., None]) -> None:
    install(
        Entry(
            "theirs",
            {"engine": {"rails": "a:b"}, "table": {"odd": f"{__name__}:fail"}, "judge": {"odd": f"{__name__}:Odd"}},
        )
    )
    with pytest.raises(
        InputError, match=r"^the engine rails of the extension theirs cannot be imported \(Module.*\); "
    ):
        make_backend("rails")
    with pytest.raises(
        InputError, match=r"^the table odd of the extension theirs failed \(ZeroDivisionError: .*\); see "
    ):
        call_extension("table", "odd")
    assert "odd" in PROTOCOLS and [*PROTOCOLS][-1] == "odd"
    with pytest.raises(InputError, match=r"^the judge odd calls itself 'even'; "):
        find_protocol("odd")


def test_options_that_clash_with_those_of_the_command_are_left_out(
    install: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    install(Entry("theirs", {"options": {"planner odd": f"{__name__}:Taken", "planner even": f"{__name__}:fail"}}))
    assert {field.of for field in list_fields(EvalOptions) if field.of} <= {"planner grpc"}
    clash, other = told(capsys)
    assert clash == "warning: the options of planner odd, of the extension theirs, are left out: --seed is taken"
    assert other.startswith("warning: the options of planner even, of the extension theirs, are left out: ")


def command_of_theirs() -> None:
    """Do nothing."""


GROUP_OF_THEIRS = typer.Typer()


def fail() -> float:
    return 1 / 0


class Odd:
    name = "even"


@dataclass(frozen=True)
class Taken:
    seed: Annotated[int, Option("A seed.")] = 0
