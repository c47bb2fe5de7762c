"""The base of all errors that a user can cause, and the errors that several layers raise."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection
from functools import partial, wraps
from typing import ParamSpec, TypeVar

__all__ = ["OptionError", "PluginError", "RlbenchError", "SourceError", "names_arguments"]

P = ParamSpec("P")
T = TypeVar("T")
# a command that a message proposes, up to the end of its clause
COMMAND = re.compile(r"(`[^`]*`|\brlbench [a-z](?:(?![.,;)](?:\s|$)).)*)")
OPTION = re.compile(
    r"^--(?P<first>[a-z-]+) (?P<text>(?:(?!\. )[^:])+)(?=: )"  # what is wrong, at the beginning
    r"|(?<![\w-])--(?P<name>[a-z-]+)(?: (?P<value>\S+?)(?=[.,;:)](?:\s|$)|$))?"  # ends a clause
)
PLAIN = re.compile(r"[A-Z]+|[\d.,:x-]+|['\[].*")  # a placeholder, numbers, or a value of Python


class RlbenchError(Exception):
    """An error that the user can fix. The command line prints its message without a traceback."""

    command_message = ""  # as the command line says it, where the message names arguments


class PluginError(RlbenchError, LookupError):
    """An unknown plugin, two plugins with the same name, or a plugin that violates its contract."""


class OptionError(RlbenchError, ValueError):
    """A command-line option or an argument with an unusable value."""


class SourceError(RlbenchError, ValueError):
    """Files of other programs that cannot be read, or that are not safe to read."""


def names_arguments(function: Callable[P, T]) -> Callable[P, T]:
    """A function for Python, whose errors name its arguments in place of options.

    Messages are written for the command line: of a function with the argument `out`, "choose
    another --out" becomes "choose another out=". Options that it does not have stay, as do
    commands that a message proposes.
    """
    names = inspect.signature(function).parameters.keys()

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except RlbenchError as error:
            error.command_message = error.command_message or str(error)
            error.args = tuple(
                in_arguments(part, names) if isinstance(part, str) else part for part in error.args
            )
            raise

    return call


def in_arguments(message: str, names: Collection[str]) -> str:
    """A message whose options are the arguments `names` of a function.

    >>> in_arguments("--spp 99: a clip stores 8; trace more with --pool live", ["spp", "pool"])
    'spp=99: a clip stores 8; trace more with pool="live"'
    """
    texts = COMMAND.split(message)  # every other one is a command
    texts[::2] = [OPTION.sub(partial(_as_argument, names), text) for text in texts[::2]]
    return "".join(texts)


def _as_argument(names: Collection[str], option: re.Match[str]) -> str:
    word = (option["first"] or option["name"]).replace("-", "_")
    name = next((each for each in (word, f"{word}s") if each in names), None)  # --seed is seeds
    if name is None:
        return option[0]
    value = option["text"] or option["value"] or ""
    quote = '"' * bool(value and not PLAIN.fullmatch(value))
    return f"{name}={quote}{value}{quote}"
