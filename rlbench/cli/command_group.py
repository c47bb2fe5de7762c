"""The behaviour that all commands share: grouped help, errors without traceback, old spellings."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from rlbench.cli.old_spellings import translate
from rlbench.errors import RlbenchError
from rlbench.registry.plugin_code import exits_as_errors

__all__ = ["CommandGroup", "CommandWithGroupedHelp"]

OTHER = "Options"  # title of the options that belong to no group


class CommandWithGroupedHelp(TyperCommand):
    """A command whose help lists its options in groups, by their `rich_help_panel`."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write one section for each group, in the order of the options; ungrouped ones last."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            is_argument = parameter.param_type_name == "argument"
            title = getattr(parameter, "rich_help_panel", None) or OTHER
            if record is not None:
                sections.setdefault("Arguments" if is_argument else title, []).append(record)
        for title in sorted(sections, key=lambda title: title == OTHER):
            with formatter.section(title):
                formatter.write_dl(sections[title])


class CommandGroup(TyperGroup):
    """Commands whose expected errors are one message and exit code 2, without a traceback.

    Neither a plugin nor a library ends a command without a message: commands signal their exit code
    by `typer.Exit`, so every other exit is an error.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command and its arguments; old spellings are translated, with a note."""
        translated, notes = translate(args)
        for note in notes:
            typer.echo(note, err=True)
        return super().resolve_command(ctx, translated)

    def invoke(self, ctx: Any) -> Any:
        """Run the command. Errors that users cannot cause are defects and keep their traceback."""
        try:
            with exits_as_errors():
                return super().invoke(ctx)
        except Exception as error:
            if not isinstance(error, RlbenchError):
                raise
            typer.secho(f"error: {error}", fg="red", err=True)
            raise SystemExit(2) from error
