"""Help of groups of commands: every summary a whole sentence, on as many lines as it takes."""

from typing import Any

from typer.core import TyperGroup


class WholeSummaries(TyperGroup):
    """A group whose list of commands shows the first sentence of each in full, not what fits on a line."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        for command in self.commands.values():
            command.short_help = command.short_help or summary(command.help or "")
        super().format_commands(ctx, formatter)


def summary(text: str) -> str:
    """The first paragraph of a command's help on one line."""
    return " ".join(text.strip().split("\n\n")[0].split())
