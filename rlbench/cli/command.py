"""The behaviour that all commands share: help, names without -m, one-line errors, interruptions."""

from __future__ import annotations

import errno
import os
import re
import select
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from rlbench import registry
from rlbench.cli.commands import GROUPS, list_commands
from rlbench.cli.options import EXECUTION, OTHER, complete_methods
from rlbench.cli.options import GROUPS as OPTION_GROUPS
from rlbench.errors import RlbenchError
from rlbench.registry.apps import CommandEntry
from rlbench.registry.near_names import suggest
from rlbench.registry.plugin_code import exits_as_errors
from rlbench.system.paths import FolderNotWritableError, WriteError, write_error, write_remedy

SHORT_HELP = 8  # options that -h shows
NEARLY_ALL = 11  # as many options are all shown
HELP_ALL = "--help-all"
PROGRAM_OPTIONS = {"-v", "--verbose", "-q", "--quiet"}  # accepted behind the command too
FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # errors that any file can meet
INTERRUPTED, PIPE_CLOSED = 130, 141  # exit codes of shells: 128 + SIGINT, 128 + SIGPIPE
LISTED = ("methods", "metrics", "presets", "reports")  # by rlbench list, so no commands


def load_command(entry: CommandEntry) -> Command:
    """The command of an entry."""
    program = typer.Typer(add_completion=False, rich_markup_mode=None)
    program.command(cls=Command)(registry.resolve(entry.target))
    command: Any = typer.main.get_command(program)
    return command  # type: ignore[no-any-return]


class Command(TyperCommand):
    """A command whose help lists its first options, and all with --help-all.

    Where it has the option --methods and no argument, words that belong to no option are methods:
    `rlbench check ours` is `rlbench check -m ours`. Where it has --results, a folder among them is
    its value.
    """

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the first options, or with --help-all all options in groups."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": []}
        options = [each for each in self.params if each.param_type_name == "option"]
        is_short = len(options) > NEARLY_ALL and not ctx.meta.get(HELP_ALL)
        hidden = options[SHORT_HELP:] if is_short else []
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None or parameter in hidden:
                continue
            title = OTHER if is_short else getattr(parameter, "rich_help_panel", None) or OTHER
            if parameter.param_type_name == "argument":
                title = "Arguments"
            sections.setdefault(title, []).append(record)
        if is_short:
            sections[OTHER].append((HELP_ALL, f"Show all {len(options)} options."))
        for title in sorted(filter(sections.get, sections), key=_rank):
            with formatter.section(title):
                formatter.write_dl(sections[title])

    def full_help(self, ctx: Any) -> str:
        """The help with all options."""
        ctx.meta[HELP_ALL] = True
        return self.get_help(ctx)

    @property
    def takes_bare_methods(self) -> bool:
        """True if words without an option are methods."""
        has_argument = any(each.param_type_name == "argument" for each in self.params)
        return not has_argument and any(each.name == "methods" for each in self.params)

    @property
    def takes_results(self) -> bool:
        """True if the command has --results, so that a folder among the words is its value."""
        return any(
            each.name == "results" and each.param_type_name == "option" for each in self.params
        )

    def make_parser(self, ctx: Any) -> Any:
        """The parser of this command's words: a folder is the results, others are methods."""
        parser: Any = super().make_parser(ctx)
        if self.takes_bare_methods or self.takes_results:
            parse_options = parser.parse_args

            def parse(args: list[str]) -> tuple[dict[str, Any], list[str], list[Any]]:
                options, words, order = parse_options(args=args)
                folders = [word for word in words if self.takes_results and Path(word).is_dir()]
                if len(folders) == 1 and "results" not in options:
                    options["results"] = folders[0]
                    words = [word for word in words if word not in folders]
                if words and self.takes_bare_methods:
                    options["methods"] = [*options.get("methods", []), *words]
                    words = []
                return options, words, order

            parser.parse_args = parse
        return parser

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words; a value that is none of the choices is answered with the nearest one.

        Where the results are an argument, --results may stand before it, as in other commands.
        """
        _show_all(ctx, args)
        if not self.takes_results and any(each.name == "results" for each in self.params):
            args = [word.removeprefix("--results=") for word in args if word != "--results"]
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
            typer.echo(f"\n{what_is_kept(str(self.name), ctx.params)}", err=True)
            raise typer.Exit(INTERRUPTED) from None
        except Exception as error:
            if isinstance(error, OSError) and error.errno in FULL_DISK:
                folder = ctx.params.get("out") or ctx.params.get("results") or Path.cwd()
                raise write_error(Path(error.filename or folder), error.strerror) from error
            if not _is_broken_pipe(error):
                raise
            raise typer.Exit(PIPE_CLOSED) from None
        finally:
            if _is_output_closed():
                _silence_output()


class CommandGroup(TyperGroup):
    """Commands in groups, each imported when it is used; expected errors are one message, exit 2.

    Those of the last group are shown with --help-all alone. Neither a plugin nor a library ends a
    command without a message: commands signal their exit code by `typer.Exit`, so every other exit
    is an error.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of all commands, in the order of the help."""
        return list(list_commands())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by name, or None."""
        if cmd_name not in self.commands and cmd_name in (entries := list_commands()):
            self.commands[cmd_name] = load_command(entries[cmd_name])
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in their groups, with one line each."""
        entries = list_commands()
        width = max(map(len, entries))
        shows_all = ctx.meta.get(HELP_ALL, False)
        *first, last = GROUPS
        for title in GROUPS if shows_all else first:
            names = [name for name, entry in entries.items() if entry.group == title]
            helps = {name: self.get_command(ctx, name) for name in names}
            rows = [(f"{n:{width}}", each.get_short_help_str(100)) for n, each in helps.items()]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
        if not shows_all:
            with formatter.section(f"{last}: rlbench {HELP_ALL}"):
                names = [name for name, entry in entries.items() if entry.group == last]
                formatter.write_text(", ".join(names))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the words name. An unknown one is answered with the nearest."""
        names = self.list_commands(ctx)
        if args[0] not in names and not ctx.resilient_parsing and not args[0].startswith("-"):
            kind = f". See rlbench list {args[0]}" if args[0] in LISTED else "."
            ctx.fail(f"No such command '{args[0]}'{suggest(args[0], names) or kind}")
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the program's options, which may also stand behind the command."""
        end = args.index("--") if "--" in args else len(args)
        words, rest = args[:end], args[end:]
        _show_all(ctx, words[:1])
        if words[:1] == ["help"]:  # `rlbench help run` is `rlbench run --help`
            words = [*words[1:2], "--help"]
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
            message = error.command_message or error
            typer.secho(f"error: {message}{remedy}", fg="red", err=True)
            raise SystemExit(2) from error


def _rank(title: str) -> int:
    """The place of a group in the help: arguments first, and groups of one command in the middle.

    >>> sorted(["Options", "Output", "Picture", "Arguments"], key=_rank)
    ['Arguments', 'Picture', 'Output', 'Options']
    """
    if title == "Arguments":
        return -1
    return OPTION_GROUPS.index(title if title in OPTION_GROUPS else EXECUTION)


def _show_all(ctx: Any, args: list[str]) -> None:
    """Print the whole help and end, if --help-all is among the words."""
    if HELP_ALL in args and not ctx.resilient_parsing:
        ctx.meta[HELP_ALL] = True
        typer.echo(ctx.get_help())
        raise typer.Exit


def what_is_kept(command: str, parameters: Mapping[str, Any]) -> str:
    """What an interrupted command leaves, and how to continue it.

    >>> what_is_kept("run", {"out": "results"}).partition(" The same")[0]
    'interrupted: finished cells are kept in results.'
    """
    entry = list_commands().get(command)
    if entry is None or not entry.kept:
        return "interrupted: nothing was kept"
    out = parameters.get("out") or Path(str(parameters.get("results"))) / "evaluated"
    again = shlex.join(["rlbench", *sys.argv[1:]])
    goes_on = "continues" if entry.resumes else "begins again"
    return f"interrupted: {entry.kept.format(out=out)}. The same command {goes_on}: {again}"


def _is_broken_pipe(error: BaseException) -> bool:
    """True if an error says that the reader of standard output went away: `rlbench list | head`.

    `rich` exits on a broken pipe, and has redirected the output by then.
    """
    chain: list[BaseException] = [error]
    while (cause := chain[-1].__cause__ or chain[-1].__context__) and cause not in chain:
        chain.append(cause)
    is_exit_of_rich = any(isinstance(each, SystemExit) for each in chain)
    has_broken = any(isinstance(each, BrokenPipeError) for each in chain)
    return has_broken and (is_exit_of_rich or _is_output_closed())


def _is_output_closed() -> bool:
    """True if the reader of standard output went away."""
    poll = select.poll()
    try:
        poll.register(sys.__stdout__.fileno() if sys.__stdout__ else 1, select.POLLOUT)
        return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except (OSError, ValueError):  # no such file: closed by the caller
        return False


def _silence_output() -> None:
    """Write nothing more to standard output, not even when Python ends."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)


def _name_nearest_choice(message: str) -> str:
    """A message of the parser without its inner words, and with the nearest choice if it has any.

    >>> _name_nearest_choice("Value error, 'live ' is not one of 'stored', 'live'.")
    "'live ' is not one of 'stored', 'live'. Did you mean 'live'?"
    """
    text = message.removeprefix("Value error, ")
    found = re.fullmatch(r"'(.*)' is not one of ('.*')\.", text)
    nearest = suggest(found[1], re.findall(r"'([^']*)'", found[2])) if found else ""
    return text.removesuffix(".") + nearest if nearest else text
