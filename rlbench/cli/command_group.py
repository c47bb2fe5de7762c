"""The behaviour that all commands share: grouped help, names without -m, one-line errors."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from rlbench.cli import interruption
from rlbench.cli.completion import complete_methods
from rlbench.errors import RlbenchError
from rlbench.registry.near_names import suggest
from rlbench.registry.plugin_code import exits_as_errors
from rlbench.system.paths import FolderNotWritableError, WriteError, write_error, write_remedy

__all__ = ["Command", "CommandGroup"]

OTHER = "Options"  # title of the options that belong to no group
FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # errors that any file can meet
PROGRAM_OPTIONS = {"-v", "--verbose", "-q", "--quiet"}  # accepted behind the command too


class Command(TyperCommand):
    """A command whose help lists its options in groups, by their `rich_help_panel`.

    Where it has the option --methods and no argument, words that belong to no option are methods:
    `rlbench check ours` is `rlbench check -m ours`.
    """

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

    @property
    def takes_bare_methods(self) -> bool:
        """Are words without an option methods?"""
        has_argument = any(each.param_type_name == "argument" for each in self.params)
        return not has_argument and any(each.name == "methods" for each in self.params)

    def make_parser(self, ctx: Any) -> Any:
        """The parser of this command's words, which adds bare words to the methods."""
        parser: Any = super().make_parser(ctx)
        if self.takes_bare_methods:
            parse_options = parser.parse_args

            def parse(args: list[str]) -> tuple[dict[str, Any], list[str], list[Any]]:
                options, words, order = parse_options(args=args)
                if words:
                    options["methods"] = [*options.get("methods", []), *words]
                return options, [], order

            parser.parse_args = parse
        return parser

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words; a value that is none of the choices is answered with the nearest one."""
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            error.message = _name_nearest_choice(error.message)
            raise

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """What the shell completes: options, and methods where they may stand alone."""
        from typer._click.shell_completion import CompletionItem

        completed = super().shell_complete(ctx, incomplete)
        if self.takes_bare_methods and not incomplete.startswith("-"):
            completed += [CompletionItem(name) for name in complete_methods(incomplete)]
        return completed

    def invoke(self, ctx: Any) -> Any:
        """Run the command. After Ctrl-C, say what is kept; after a closed pipe, nothing.

        A full disk is a WriteError, also where a plugin or a library met it.
        """
        try:
            with exits_as_errors():
                return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo(f"\n{interruption.what_is_kept(str(self.name), ctx.params)}", err=True)
            raise typer.Exit(interruption.INTERRUPTED) from None
        except Exception as error:
            if isinstance(error, OSError) and error.errno in FULL_DISK:
                folder = ctx.params.get("out") or ctx.params.get("results") or Path.cwd()
                raise write_error(Path(error.filename or folder), error.strerror) from error
            if not interruption.is_broken_pipe(error):
                raise
            raise typer.Exit(interruption.PIPE_CLOSED) from None
        finally:
            if interruption.is_output_closed():
                interruption.silence_output()


class CommandGroup(TyperGroup):
    """Commands whose expected errors are one message and exit code 2, without a traceback.

    Neither a plugin nor a library ends a command without a message: commands signal their exit code
    by `typer.Exit`, so every other exit is an error.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the program's options, which may also stand behind the command."""
        end = args.index("--") if "--" in args else len(args)
        words, rest = args[:end], args[end:]
        first = [word for word in words if word in PROGRAM_OPTIONS]
        others = [word for word in words if word not in PROGRAM_OPTIONS]
        return super().parse_args(ctx, [*first, *others, *rest])

    def invoke(self, ctx: Any) -> Any:
        """Run the command. Errors that users cannot cause are defects and keep their traceback."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            if not isinstance(error, RlbenchError):
                raise
            remedy = ""
            if isinstance(error, WriteError) and not isinstance(error, FolderNotWritableError):
                remedy = f": {write_remedy(error)}"
            typer.secho(f"error: {error}{remedy}", fg="red", err=True)
            raise SystemExit(2) from error


def _name_nearest_choice(message: str) -> str:
    """A message of the parser without its inner words, and with the nearest choice if it has any.

    >>> _name_nearest_choice("Value error, 'live ' is not one of 'stored', 'live'.")
    "'live ' is not one of 'stored', 'live'. Did you mean 'live'?"
    """
    text = message.removeprefix("Value error, ")
    found = re.fullmatch(r"'(.*)' is not one of ('.*')\.", text)
    nearest = suggest(found[1], re.findall(r"'([^']*)'", found[2])) if found else ""
    return text.removesuffix(".") + nearest if nearest else text
