"""The core works with any extension taken away, and with all of them."""

import json
import os
import subprocess
import sys
from pathlib import Path

from benchmark.machine.extension import OFFERS, import_reference
from tests.test_layers import ALLOWED, ROOT, extension_of, modules
from tests.whole_product import needs_extensions

ABSENT = """
import os, sys

class Absent:
    def __init__(self, names):
        self.names = names

    def find_spec(self, name, path=None, target=None):
        parts = name.removeprefix("tests.").split(".")
        if len(parts) > 2 and parts[1] == "extensions" and ("all" in self.names or parts[2] in self.names):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
"""
EVERYWHERE = f"{ABSENT}\nsys.meta_path.insert(0, Absent(['all']))\n"
EACH = f"""{ABSENT}
import traceback
import typer
from benchmark.machine.extension import OFFERS, parse_extension_name

def helps(command, context):
    # Of the others, whose text is the same for every extension, the summaries in the help of their groups.
    if hasattr(command, "commands") or "Not installed" in (command.help or ""):
        yield context.command_path, command.get_help(context)
    for name, inner in getattr(command, "commands", {{}}).items():
        yield from helps(inner, type(context)(inner, info_name=name, parent=context))

def check(name):
    for module in list(sys.modules):
        if module.startswith("benchmark.cli") or ".extensions." in module:
            del sys.modules[module]
    sys.meta_path.insert(0, Absent([name]))
    from benchmark.cli.app import app
    command = typer.main.get_command(app)
    said = dict(helps(command, command.make_context("cb", ["doctor"])))
    gone = {{f"cb {{words}}" for words, of in OFFERS["command"].items() if parse_extension_name(of) == name}}
    assert {{words for words, text in said.items() if f"Not installed: extension {{name}}." in text}} >= gone, name

for name in sys.argv[1:]:
    # What the command line brings along is imported once; each child has it from the parent.
    import benchmark.cli.app
    if not (child := os.fork()):
        try:
            check(name)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        sys.exit(name)
"""
EXTENSIONS = sorted({of.split(".")[2] for name in modules() if (of := extension_of(name))})


def run_all_absent(arguments: list[str], where: Path, *, of: Path, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """Run Python without any extension, in processes that it starts too."""
    (of / "sitecustomize.py").write_text(EVERYWHERE)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (of, ROOT)))}
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=where, env=environment, input=stdin, capture_output=True, text=True, check=False)


@needs_extensions
def test_what_extensions_offer_is_there() -> None:
    for kind, offered in OFFERS.items():
        for name, reference in offered.items():
            found = import_reference(reference)
            # What golden sets offer is declared, and a method of it is run.
            assert callable(getattr(found, "verify", found)), (kind, name)


def test_with_one_extension_gone_every_help_answers_and_its_commands_say_so() -> None:
    command = [sys.executable, "-c", EACH, *EXTENSIONS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


COLLECTED = """
import importlib, sys
import pytest
import benchmark

for name in sys.argv[1].split(","):
    importlib.import_module(name)
try:
    benchmark.write_films
except AttributeError as absent:
    print(absent, flush=True)
sys.exit(pytest.main(sys.argv[2:]))
"""


def test_with_all_gone_every_core_module_imports_and_the_tests_of_the_core_collect(tmp_path: Path) -> None:
    core = sorted(name for name in modules() if "extensions" not in name.split(".") and not name.endswith("__main__"))
    own = [f"--ignore=tests/{package}/extensions" for package in ALLOWED]
    arguments = ["--collect-only", "--assert=plain", "-q", "-p", "no:cacheprovider", *own, "tests"]
    done = run_all_absent(["-c", COLLECTED, ",".join(core), *arguments], ROOT, of=tmp_path)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr
    told = "benchmark.write_films: this needs the extension films, which is not installed; install it\n"
    assert done.stdout.startswith(told)


COMMANDS = """
import contextlib, io, json, sys
from benchmark.cli.app import main

for line in sys.stdin.read().splitlines():
    sys.argv = ["challenger-bench", *line.split()]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    print(json.dumps([code, err.getvalue()]))
"""
PATH = """
data build --town-scenes 1 --frames keyframes --size 96x54 --root town --workers 1
generate --data town --split adv --candidates 32 --rounds 2 --vehicles 3 --frames keyframes --size 96x54 --workers 1
eval --data town --model constant-velocity --model constant-velocity-on-path --split val --workers 1
eval --data town --model constant-velocity --model constant-velocity-on-path --split adv --workers 1
drive --data town --split adv --model constant-velocity --limit 1 --workers 1
sheets --data town --split adv --limit 1 --workers 1
leaderboard
transfer
""".strip().splitlines()
REFUSED = ("eval --model http://localhost:1", "generate --renderer magicdrive", "verify pdm")


def test_with_all_gone_the_path_of_the_demo_runs_and_what_asks_for_one_is_told_so(tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    done = run_all_absent(["-c", COMMANDS], work, of=tmp_path, stdin="\n".join([*PATH, *REFUSED]))
    assert done.returncode == 0, done.stderr
    found = dict(zip([*PATH, *REFUSED], map(json.loads, done.stdout.splitlines()), strict=True))
    for line in PATH:
        assert found[line][0] in (None, 0), (line, found[line])
    assert (work / "challenger-out/leaderboard/site/index.html").is_file()
    for line in REFUSED:
        code, said = found[line]
        assert code == 2 and "needs the extension" in said.splitlines()[-1] and "Traceback" not in said, line
