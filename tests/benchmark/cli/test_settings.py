"""Settings from flags, ``--set``, files and records: who wins, what is refused, and that records can be fed back."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import typer

from benchmark.cli.app import app
from benchmark.cli.drive import DriveOptions
from benchmark.cli.eval_options import EvalOptions
from benchmark.cli.generate_options import GenerateOptions
from benchmark.cli.settings import Option, add_command, command, is_given, list_rare_settings
from benchmark.errors import InputError
from benchmark.machine.extension import OFFERS, parse_extension_name
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.cli.small_path import done
from tests.benchmark.edited_roots import small_town

taken: list[tuple[Any, bool]] = []


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class PaintOptions:
    """Options of a command that exists here only."""

    RARE = ("gloss",)

    wall: Annotated[str, Option("What is painted.", "Input", names="")]
    count: Annotated[int, Option("How often.", "Search", min=1, max=9)] = 1
    kind: Annotated[Literal["oil", "chalk"], Option("With what.")] = "oil"
    colours: Annotated[tuple[str, ...], Option("Colours.", names="--colour")] = ()
    rooms: Annotated[str | None, Option("Rooms, separated by commas.", separated=True)] = None
    dry: Annotated[bool, Option("Whether it dries.", names="--dry/--no-dry")] = True
    gloss: Annotated[float, Option("How it shines.")] = 0.5


@command(PaintOptions)
def paint(options: PaintOptions) -> None:
    """Paint a wall."""
    taken.append((options, is_given("count")))


painting = typer.Typer()
add_command(painting, "paint", paint)
add_command(painting, "repaint", paint)


def painted(*arguments: str | Path) -> PaintOptions:
    taken.clear()
    words = ["paint", *map(str, arguments)]
    typer.main.get_command(painting).main(words, prog_name="x", standalone_mode=False)
    ((options, _),) = taken
    assert isinstance(options, PaintOptions)
    return options


def written(folder: Path, text: str, name: str = "run.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_flags_win_over_set_and_file_and_these_over_defaults(tmp_path: Path) -> None:
    assert painted("hall") == PaintOptions(wall="hall") and not taken[0][1]
    file = written(tmp_path, "wall: attic\ncount: 3\nkind: chalk\ncolour: [red, blue]\nrooms: [a, b]\ngloss: 1\n")
    assert painted("--config", file) == PaintOptions(
        wall="attic", count=3, kind="chalk", colours=("red", "blue"), rooms="a,b", gloss=1.0
    )
    assert taken[0][1]
    assert painted("hall", "--config", file, "--count", "4", "--colour", "green").count == 4
    assert painted("hall", "--config", file, "--colour", "green").colours == ("green",)
    for words in (("--config", file, "--set", "gloss=2"), ("--set", "gloss=2", "--config", file)):
        assert painted(*words).gloss == 2.0
    assert painted("hall", "--set", "colour=red,blue", "--set", "dry=false").colours == ("red", "blue")
    assert not taken[0][0].dry
    assert painted("hall", "--gloss", "0.1").gloss == 0.1, "what help does not list is taken all the same"
    as_json = written(tmp_path, json.dumps({"wall": "x", "no-such": None} | {"count": 2}), "run.json")
    with pytest.raises(InputError, match="no-such"):
        painted("--config", as_json)
    assert painted("--config", written(tmp_path, '{"wall": "x", "gloss": null}', "run.json")).wall == "x"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cuont: 3", "did you mean count"),
        ("count: 0", "greater than or equal to 1"),
        ("count: ten", "valid integer"),
        ("count: true", "must be a number"),
        ("dry: 1", "must be true or false"),
        ("kind: water", "is not one of 'oil', 'chalk'"),
        ("colours: [1]", "must be text"),
        ("wall: 3", "must be text"),
        ("- wall", "holds no settings"),
        ("", "holds no settings"),
        ("wall: [a", "is not valid YAML"),
        ("wall: &a x\nrooms: *a", "alias"),
        ("wall: !!python/name:os.system", "it has the tag"),
        ("wall: !!set {a}", "it has the tag"),
        ("count: 0x" + "f" * 5000, "a number of 5002 characters"),
        ("wall: {0: 0001-13-01}", "month must be in"),
        ("wall: " + "[" * 200 + "]" * 200, "deep"),
        ("schema: 6", "not a record"),
        ("x" * (1 << 20), "at most"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_in_one_sentence(text: str, words: str, tmp_path: Path) -> None:
    file = written(tmp_path, text)
    with pytest.raises(InputError) as refused:
        painted("hall", "--config", file)
    assert str(file) in str(refused.value) and words in str(refused.value) and "\n" not in str(refused.value)


def test_a_change_by_name_is_refused_like_a_file() -> None:
    for change, words in (
        ("gloss", "NAME=VALUE"),
        ("glos=1", "did you mean gloss"),
        ("gloss=x", "valid number"),
        ("count=10", "less than"),
    ):
        with pytest.raises(InputError, match=words):
            painted("hall", "--set", change)
    with pytest.raises(InputError, match="one"):
        painted("hall", "--set", "gloss=1", "--gloss", "2")
    assert "no such file" in refusal("eval", "--config", "nowhere.yaml").lower()
    assert "did you mean rounds" in refusal("generate", "--set", "roundz=1"), "names of the search stay its own"


def helped(*words: str) -> str:
    return run_here(*words, "--help").out


@pytest.mark.parametrize(
    ("name", "options"), [("eval", EvalOptions), ("drive", DriveOptions), ("generate", GenerateOptions)]
)
def test_help_has_panels_and_few_options_and_names_where_the_others_are(name: str, options: type) -> None:
    said = helped(name)
    shown = [line for line in said.splitlines() if line.startswith("  --")]
    assert len(shown) <= 29 and shown[0].split()[0] in ("--model", "--split")
    panels = [line for line in said.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert {"Input:", "Output:", "Search:", "Execution:", "Advanced:"} - {*panels} <= {"Search:"}
    assert len(panels) == len({*panels})
    rare = list_rare_settings(options)
    assert not [each for each in rare if f"  --{each.replace('_', '-')} " in said]
    assert {*rare} <= {each.name for each in dataclasses.fields(options)}
    assert f"{len(rare)} rare settings" in said and "docs/settings.md" in said
    assert "\x1b" not in said and said.isascii() and max(map(len, said.splitlines())) <= 80


def test_commands_of_extensions_declare_their_settings() -> None:
    for words, reference in OFFERS["command"].items():
        if not reference.endswith(":app") and parse_extension_name(reference):
            found: Any = typer.main.get_command(app)
            for word in words.split():
                found = found.commands[word]
            assert any(each.name == "config_file" for each in found.params) or "Not installed" in found.help


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("desk")
    small_town(folder / "town", 2)
    return folder


def facts(file: Path) -> Any:
    said = json.loads(file.read_text())
    said.pop("environment", None)
    return said


def again(desk: Path, monkeypatch: pytest.MonkeyPatch, name: str, *arguments: str | Path) -> Done:
    """A command run beside the town, where records name it."""
    monkeypatch.chdir(desk)
    return done(run_here(name, *arguments, "--workers", "1"))


def test_a_run_record_can_be_fed_back(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ("--data", "town", "--model", "idm", "--scenes", "scene-8001", "--seed", "3", "--protocol", "stp3")
    again(desk, monkeypatch, "eval", *asked, "--out", "first")
    (record,) = Path("first/runs").rglob("run.json")
    again(desk, monkeypatch, "eval", "--config", record, "--out", "second")
    (second,) = Path("second/runs").rglob("run.json")
    assert facts(second) == facts(record)
    assert facts(record)["config"]["protocols"][-1] == "stp3" and facts(record)["scenes"] == ["scene-8001"]


def test_a_record_of_drives_can_be_fed_back(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ("--data", "town", "--split", "val", "--model", "stop", "--no-baselines", "--limit", "1", "--agents", "idm")
    how = ("--latency", "300", "--until", "fault", "--timeout", "33", "--seed", "2")
    again(desk, monkeypatch, "drive", *asked, *how, "--out", "first")
    (record,) = Path("first/drives").rglob("drive.json")
    again(desk, monkeypatch, "drive", "--config", record, "--out", "second")
    (second,) = Path("second/drives").rglob("drive.json")
    assert facts(second) == facts(record)
    assert facts(record)["measured"]["until"] == "fault@1" and facts(record)["config"]["timeout_s"] == 33.0
    assert "not a record that eval" in refusal("eval", "--config", record)


def test_the_search_of_a_split_can_be_fed_back(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ("--data", "town", "--limit", "1", "--renderer", "none")
    search = ("--preset", "near", "--candidates", "16", "--rounds", "2", "--vehicles", "2", "--calls", "2")
    rest = ("--seed", "5", "--set", "clearance_m=0.2", "--keep-unsolvable")
    again(desk, monkeypatch, "generate", *asked, *search, *rest, "--out", "first")
    record = Path("first/data/town/adv/search.json")
    again(desk, monkeypatch, "generate", *asked, "--config", record, "--out", "second")
    other = Path("second/data/town/adv/search.json")
    assert other.read_bytes() == record.read_bytes()
    tables = {path.name: path.read_bytes() for path in Path("first/data/town/adv").glob("v1.0-*/*.json")}
    assert tables and tables == {
        path.name: path.read_bytes() for path in Path("second/data/town/adv").glob("v1.0-*/*.json")
    }


def test_a_damaged_record_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path, json.dumps({"schema": 6, "planner": {"name": "idm"}, "protocols": {}}), "run.json")
    assert f"{file} is a damaged record" in refusal("eval", "--config", file)
