"""Pages of the reference of commands, made from the commands themselves."""

from collections.abc import Iterator
from typing import Any

import typer

from benchmark.cli.app import app

PROGRAM = "challenger-bench"
EXIT_CODES = "Exit codes: 0 done, 1 a failed or partial run, 2 wrong use or bad input, 130 interrupted."


def command_pages() -> dict[str, str]:
    """Markdown of one page for each command of the first level, and of one that lists them all, by address."""
    root: Any = typer.main.get_command(app)
    pages = {f"commands/{name}.md": _page(name, command) for name, command in sorted(root.commands.items())}
    return {"commands/index.md": _overview(root)} | pages


def _overview(root: Any) -> str:
    """The list of all commands, subcommands included, with what each does."""
    rows = [
        f"| [`{name}`]({name.split(' ')[0]}.md#{_anchor(name)}) | {_cell(_first_paragraph(command.help))} |"
        for name, command in _walk(root, "")
        if name
    ]
    return "\n".join(
        [
            "# Commands",
            "",
            f"`{PROGRAM} COMMAND --help` prints the same; `--debug` shows tracebacks.",
            EXIT_CODES,
            "",
            "| command | what it does |",
            "|---|---|",
            *rows,
            "",
        ]
    )


def _page(name: str, command: Any) -> str:
    """A command with its options, and its subcommands below it."""
    return "\n".join(line for path, each in _walk(command, name) for line in _section(path, each))


def _walk(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    """A command and all below it, with the words that lead there."""
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from _walk(inner, f"{path} {name}".strip())


def _section(path: str, command: Any) -> list[str]:
    """Heading, what it does, how it is called, and a table of what it takes."""
    context = command.make_context(path, [], resilient_parsing=True)
    rare = [each for each in command.params if each.hidden]
    for each in rare:
        # What help leaves out as rare stands here too.
        each.hidden = False
    pieces = " ".join(command.collect_usage_pieces(context))
    taken = [each.get_help_record(context) for each in command.get_params(context)]
    for each in rare:
        each.hidden = True
    rows = [f"| {_code(names)} | {_cell(text)} |" for names, text in filter(None, taken)]
    level = "#" if " " not in path else "##"
    return [
        f"{level} {path} {{ #{_anchor(path)} }}",
        "",
        _cell(command.help or ""),
        "",
        "```",
        f"{PROGRAM} {path} {pieces}",
        "```",
        "",
        "| takes | what it means |",
        "|---|---|",
        *rows,
        "",
    ]


def _anchor(path: str) -> str:
    return path.replace(" ", "-")


def _first_paragraph(text: str | None) -> str:
    return (text or "").strip().split("\n\n")[0]


def _code(names: str) -> str:
    """Names of an option as code, a bar in them kept from ending a table's cell."""
    return f"`{' '.join(names.split())}`"


def _cell(text: str) -> str:
    """Text on one line, with nothing in it that Markdown or a table would take for its own."""
    plain = " ".join(text.split())
    for sign in "\\`*_[]<>|":
        plain = plain.replace(sign, f"&#{ord(sign)};")
    return plain
