"""Help of commands and groups: options and commands in panels, whole sentences, plain text at any width."""

from typing import Any, Final, Literal, get_args

from typer.core import TyperCommand, TyperGroup

from benchmark.errors import InputError

CommandPanel = Literal["Run", "Data", "Results", "Advanced"]
"""Panels of the list of commands, in its order; a command that names none is in the last."""
WIDEST: Final = 100
"""Columns that help takes of a wider terminal."""
ARGUMENTS: Final = "benchmark.cli.help"
"""Key of a command's context: its words as they were given."""


class SettingsCommand(TyperCommand):
    """A command whose help lists its options in panels, in the order of the first option of each."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Note the words in the context and parse them; what no argument takes is refused with the option it is for."""
        ctx.meta[ARGUMENTS] = tuple(args)
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

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As of a command: some groups are commands too."""
        ctx.meta[ARGUMENTS] = tuple(args)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the panels, then the commands."""
        _write_panels(self, ctx, formatter)
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands, in panels where any command names one."""
        panels: dict[str, list[tuple[str, str]]] = {panel: [] for panel in get_args(CommandPanel)}
        for name, command in self.commands.items():
            panel = getattr(command, "rich_help_panel", None) or get_args(CommandPanel)[-1]
            panels.setdefault(panel, []).append((name, first_paragraph(command.help or "")))
        named = {panel: records for panel, records in panels.items() if records}
        if len(named) == 1:
            named = {"Commands": next(iter(named.values()))}
        for panel, records in named.items():
            with formatter.section(panel):
                formatter.write_dl(records)


def first_paragraph(text: str) -> str:
    """The first paragraph of a command's help on one line."""
    return " ".join(text.strip().split("\n\n")[0].split())


def _shorten(names: str, text: str) -> tuple[str, str]:
    """A row whose first cell fits: many choices stand in the text."""
    if len(names) < WIDEST - 4:
        return names, text
    name, _, choices = names.partition(" ")
    return name, f"{text}  [{choices.strip('<>').replace('|', ', ')}]"


def _write_panels(command: Any, ctx: Any, formatter: Any) -> None:
    panels: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is not None:
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            named = usual if usual == "Arguments" else getattr(parameter, "rich_help_panel", None) or usual
            panels.setdefault(named, []).append(_shorten(*record))
    last = panels.pop("Options", [])
    if last and panels:
        panels.setdefault("Advanced", []).extend(last)
    elif last:
        panels["Options"] = last
    for name, records in panels.items():
        with formatter.section(name):
            formatter.write_dl(records)
