"""How commands end: where things are and what to do next; on stderr, and not where a program reads."""

from pathlib import Path

import typer

from benchmark import api


def say_next(where: str, *steps: tuple[str, str], json_output: bool) -> None:
    """Say where things are and which commands come next.

    Args:
        where: What is where.
        steps: Commands without the program's name, and what each is for.
        json_output: Whether a program reads; then nothing is said.
    """
    if json_output:
        return
    typer.echo(where, err=True)
    for number, (command, purpose) in enumerate(steps):
        typer.echo(f"{'next:' if number == 0 else '     '} challenger-bench {command}   # {purpose}", err=True)


def same_place(data: str, out: Path, tables: str | None = None, categories: str | None = None) -> str:
    """Options that name the same data and output folder again, with a space before; nothing where they are default."""
    given = [] if data == "mini" else [f"--data {data}"]
    given += [] if tables is None else [f"--tables {tables}"]
    given += [] if categories is None else [f"--categories {categories}"]
    given += [] if out == api.OUT else [f"--out {out}"]
    return "".join(f" {each}" for each in given)
