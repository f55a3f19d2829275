"""Help of commands and groups: options in panels, summaries in whole sentences, plain text at any width."""

from typing import Any

from typer.core import TyperCommand, TyperGroup

from benchmark.errors import InputError


class SettingsCommand(TyperCommand):
    """A command whose help lists its options in panels, in the order of the first option of each."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse; words that no argument takes are refused with the option that they are for."""
        takes_any, ctx.allow_extra_args = ctx.allow_extra_args, True
        stray = super().parse_args(ctx, args)
        ctx.allow_extra_args = takes_any
        if stray and not takes_any and not ctx.resilient_parsing:
            from benchmark.cli.stray_words import explain_stray_words

            raise InputError(explain_stray_words(stray, {name for each in self.params for name in each.opts}))
        return stray

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the panels."""
        _write_panels(self, ctx, formatter)


class FullSummaryGroup(TyperGroup):
    """A group whose list of commands shows the first sentence of each in full, not what fits on a line."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the panels, then the commands."""
        _write_panels(self, ctx, formatter)
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        for command in self.commands.values():
            command.short_help = command.short_help or first_paragraph(command.help or "")
        super().format_commands(ctx, formatter)


def first_paragraph(text: str) -> str:
    """The first paragraph of a command's help on one line."""
    return " ".join(text.strip().split("\n\n")[0].split())


def _write_panels(command: Any, ctx: Any, formatter: Any) -> None:
    panels: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is not None:
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            named = usual if usual == "Arguments" else getattr(parameter, "rich_help_panel", None) or usual
            panels.setdefault(named, []).append(record)
    last = panels.pop("Options", [])
    if last and panels:
        panels.setdefault("Advanced", []).extend(last)
    elif last:
        panels["Options"] = last
    for name, records in panels.items():
        with formatter.section(name):
            formatter.write_dl(records)
