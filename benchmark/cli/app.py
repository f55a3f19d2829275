"""The command line: our commands and those of extensions; errors of the user are one sentence and exit code 2.

On terminals whose encoding lacks some characters, the closest ASCII stands for them.
"""

import codecs
import errno
import io
import sys
import time
import traceback
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Final, NoReturn

import typer

from benchmark.cli import (
    ablate,
    data,
    demo,
    drive,
    evaluate,
    failures,
    generate,
    models,
    packages,
    rescoring,
    serve,
    show,
    verify,
    weights,
)
from benchmark.cli.help import WIDEST, FullSummaryGroup
from benchmark.cli.settings import add_command
from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.machine.extension import (
    OFFERS,
    AbsentExtensionError,
    find_absent_extension,
    find_owner,
    import_from_extension,
    list_offers,
    make_absent_error,
    parse_extension_name,
    warn,
)
from benchmark.machine.workers import collect_rarely, processor_seconds
from benchmark.untrusted.files import to_one_line

Groups = Mapping[str, typer.Typer]
"""Groups of commands by name: the top one is ``""``, then ``data``, its groups and ``leaderboard``."""


def add_command_of_extension(words: str, groups: Groups) -> None:
    """Add a command of one of our extensions, or one that reports that the extension is not installed.

    ``words`` are as the table of offers has them, ``data card``.
    """
    try:
        _add(words, import_from_extension("command", words), groups)
    except AbsentExtensionError:
        _add_absent(words, parse_extension_name(OFFERS["command"][words]), groups)


def add_commands_of_others(groups: Groups) -> None:
    """Add the commands of other packages; one that cannot be added is named on standard error."""
    for words in list_offers("command", tuple(_list_commands(groups))):
        if words in OFFERS["command"]:
            continue
        try:
            _add(words, import_from_extension("command", words), groups)
        except InputError as error:
            warn(str(error))
        except (LookupError, TypeError, ValueError, RuntimeError) as error:
            owner = find_owner("command", words)
            warn(f"the command {words} of the extension {owner} cannot be added: {to_one_line(error)}")


def _list_commands(groups: Groups) -> Iterator[str]:
    """Words of the commands and groups that there are."""
    for name, group in groups.items():
        names = [command.name for command in group.registered_commands]
        names += [inner.name for inner in group.registered_groups]
        yield from (f"{name} {last}".strip() for last in names)


def _add(words: str, command: typer.Typer | Callable[..., Any], groups: Groups) -> None:
    group, _, last = words.rpartition(" ")
    if isinstance(command, typer.Typer):
        groups[group].add_typer(command, name=last, rich_help_panel=command.rich_help_panel)
    else:
        add_command(groups[group], last, command)


def _add_absent(words: str, name: str, groups: Groups) -> None:
    group, _, last = words.rpartition(" ")
    sentence = f"{words} belongs to the extension {name}, which is not installed here; install it to use the command"

    def say() -> NoReturn:
        raise InputError(sentence)

    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    groups[group].command(last, help=f"Not installed: extension {name}.", context_settings=anything)(say)


_HANDLER: Final = "closest-ascii"
_CLOSEST: Final = {
    "×": "x",
    "−": "-",
    "–": "-",
    "—": "-",
    "±": "+-",
    "→": "->",
    "∞": "inf",
    "φ": "phi",
    "…": "...",
    "†": "+",
    "‡": "#",
    "§": "$",
    "¶": "*",
    "✓": "v",
    "█": "#",
    "░": ".",
}
"""Marks of tables stay different from each other."""


def replace_unencodable_characters() -> None:
    """Let stdout and stderr print any text; what their encoding lacks is replaced instead of ending the command."""
    codecs.register_error(_HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_HANDLER)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_CLOSEST.get(character) or _without_accents(character) for character in missing), error.end


def _without_accents(character: str) -> str:
    return unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode() or "?"


app = typer.Typer(
    name="challenger-bench",
    cls=FullSummaryGroup,
    help="Adversarial driving scenes from nuScenes-format data, and driving models measured on them.",
    no_args_is_help=True,
    add_completion=True,
    context_settings={"max_content_width": WIDEST},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_GROUPS: Final[Groups] = {
    "": app,
    "data": data.app,
    "data export": data.export_app,
    "data import": data.import_app,
    "leaderboard": show.leaderboard_app,
}
# In the order in which help lists them.
add_command_of_extension("data export mcap", _GROUPS)
add_command_of_extension("data export infos", _GROUPS)
add_command_of_extension("data export scenarionet", _GROUPS)
add_command_of_extension("data export openscenario", _GROUPS)
add_command_of_extension("data export nuscenes", _GROUPS)
add_command_of_extension("data import 123d", _GROUPS)
add_command_of_extension("leaderboard submit-check", _GROUPS)
add_command_of_extension("data review", _GROUPS)
add_command(data.app, "pack", packages.data_pack_command)
add_command(data.app, "unpack", packages.data_unpack_command)
add_command_of_extension("data card", _GROUPS)
add_command_of_extension("leaderboard card", _GROUPS)
add_command_of_extension("leaderboard export-alpasim", _GROUPS)
add_command_of_extension("leaderboard ability", _GROUPS)
add_command_of_extension("leaderboard next", _GROUPS)
_add("data", data.app, _GROUPS)
_add("leaderboard", show.leaderboard_app, _GROUPS)
add_command_of_extension("challenge", _GROUPS)
_add("weights", weights.app, _GROUPS)
add_command_of_extension("train", _GROUPS)
add_command(app, "demo", demo.demo_command)
add_command(app, "generate", generate.generate_command)
add_command(app, "eval", evaluate.eval_command)
add_command(app, "drive", drive.drive_command)
add_command(app, "models", models.models_command)
add_command_of_extension("quality", _GROUPS)
add_command(app, "transfer", rescoring.transfer_command)
add_command(app, "failures", failures.failures_command)
add_command(app, "sheets", show.sheets_command)
add_command_of_extension("film", _GROUPS)
add_command(app, "rescore", rescoring.rescore_command)
add_command(app, "ablate", ablate.ablate_command)
add_command_of_extension("reproduce", _GROUPS)
add_command(app, "serve", serve.serve_command)
add_command(app, "verify", verify.verify_command)
add_command(app, "doctor", verify.doctor_command)
add_commands_of_others(_GROUPS)

_INTERRUPTED: Final = 130
_LONGEST_SENTENCE: Final = 1000
_PATH_ERRNOS: Final = frozenset(
    (errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR)
)
"""Errors of the operating system that concern a path given by the user."""


def main() -> None:
    """Run the command line; errors of the user are one sentence and exit code 2, with a traceback if ``--debug``.

    With ``--timings`` it ends with a line on the time that it took.
    """
    started = time.monotonic()
    collect_rarely()
    replace_unencodable_characters()
    debug = "--debug" in sys.argv
    arguments = [argument for argument in sys.argv[1:] if argument not in ("--debug", "--timings")]
    command = typer.main.get_command(app)
    try:
        _require_text(arguments)
        code = command.main(arguments, prog_name="challenger-bench", standalone_mode=False)
    except InputError as error:
        code = _fail(str(error), debug=debug)
    except ModuleNotFoundError as error:
        name = find_absent_extension(error)
        if name is None:
            raise
        code = _fail(str(make_absent_error(name)), debug=debug)
    except OSError as error:
        if error.errno not in _PATH_ERRNOS or error.filename is None:
            raise
        code = _fail(f"cannot use {error.filename}: {error.strerror}; choose another path", debug=debug)
    except RuntimeError as error:
        # `Path.resolve` raises this before Python 3.13 where a link points to itself.
        if not str(error).startswith("Symlink loop"):
            raise
        where = str(error).partition(" from ")[2]
        code = _fail(f"cannot use {where}: its links form a loop; choose another path", debug=debug)
    except typer.TyperException as error:
        message = str(error.format_message() if hasattr(error, "format_message") else error)
        # Without a command Typer raises its help text, which has several lines and is not an error.
        code = _fail(message) if "\n" not in message else _help(message)
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    if code == _INTERRUPTED:
        # Typer makes it of an interrupt that it sees first.
        typer.echo("interrupted; finished work is kept, the same command resumes", err=True)
    if "--timings" in sys.argv:
        own_s, workers_s = processor_seconds()
        typer.echo(
            f"{time.monotonic() - started:.1f} s on the clock, {own_s + workers_s:.1f} s of CPU, {workers_s:.1f} s of "
            "them in workers and other processes",
            err=True,
        )
    sys.exit(code if isinstance(code, int) else 0)


def _require_text(arguments: list[str]) -> None:
    """Refuse bytes that are no text: they could stand neither in a record nor on a terminal."""
    for argument in arguments:
        if not argument.isascii() and argument != argument.encode(errors="replace").decode():
            raise InputError(f"{argument} is not UTF-8 text; use a UTF-8 name")


def _fail(sentence: str, *, debug: bool = False) -> int:
    if debug:
        traceback.print_exc()
    typer.echo(f"error: {_sanitise_sentence(sentence)}", err=True)
    return 2


def _sanitise_sentence(sentence: str) -> str:
    """Any text as a sentence in one line that a terminal can show and a person can read."""
    printable = "".join(character if character.isprintable() else ascii(character)[1:-1] for character in sentence)
    if len(printable) <= _LONGEST_SENTENCE:
        return printable
    half = _LONGEST_SENTENCE // 2
    return f"{printable[:half]} ... {printable[-half:]}"


def _help(text: str) -> int:
    typer.echo(text, err=True)
    return 2


@app.callback(invoke_without_command=True)
def _print_version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    timings: Annotated[
        bool, typer.Option("--timings", help="End any command with the seconds and CPU seconds that it took.")
    ] = False,
) -> None:
    # `main` takes --timings, which may stand anywhere.
    if version:
        typer.echo(VERSION)
        raise typer.Exit
