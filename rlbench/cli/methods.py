"""The methods that a command is given: plugin files, names and patterns."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable
from pathlib import Path

import typer

from rlbench.cli.arguments import WeightsChoice, split_names
from rlbench.cli.verbosity import note
from rlbench.errors import OptionError

ROWS = "Its rows get this reason; all others are done"  # of a method that cannot be imported


def load_plugins(files: list[Path] | None, allow_broken: bool = False) -> None:
    """Register plugin files. Raises PluginError for one that cannot be used, unless allowed."""
    from rlbench import registry
    from rlbench.registry.discovery import plugin_file_error

    for file in files or []:
        registry.use_plugin(file)
        if not allow_broken and (reason := plugin_file_error(file)):
            raise registry.PluginError(f"--plugin {file}: {reason}")


def plugin_words(files: list[Path] | None) -> str:
    """The options that name these plugin files in a suggested command, each after a space."""
    return "".join(f" --plugin {shlex.quote(str(file))}" for file in files or ())


def load_rows(context: typer.Context, files: list[Path] | None, patterns: Iterable[str]) -> None:
    """Register plugin files for a command that does the rows of `patterns` one after another.

    Until the command ends, a method that cannot be imported has rows that fail, with its reason.
    Raises PluginError for a file that does not parse, and as `registry.with_broken`.
    """
    from rlbench import registry

    load_plugins(files, allow_broken=True)
    context.with_resource(registry.with_broken(patterns, lambda reason: note(f"{reason}. {ROWS}")))


def require_methods(patterns: Iterable[str] | None) -> list[str]:
    """Names and patterns of methods, as `split_names`. Raises a usage error where there are none.

    >>> require_methods(["ours,ntas"])
    ['ours', 'ntas']
    """
    if names := split_names(patterns):
        return names
    raise typer.BadParameter("name methods, for example -m ours,mean; 'rlbench list' has them all")


def expand_methods(
    patterns: Iterable[str] | None, pretrained_only: bool = True, default: str = ""
) -> tuple[str, ...]:
    """The methods that the names and patterns select, as in `registry.expand`.

    Without any, `default` is the pattern; a usage error where that is empty. Families that `all`
    skips because they cannot be imported are reported on the error stream.
    """
    from rlbench import registry

    names = split_names(patterns) or require_methods([default])
    return tuple(registry.expand(names, pretrained_only, note))


def trainable_methods(patterns: list[str]) -> list[str]:
    """The selected methods that can be trained; reports the others.

    Raises OptionError for a method with published weights that is selected by its name, and where
    no selected method can be trained.
    """
    from rlbench import registry

    names = expand_methods(patterns, pretrained_only=False)
    trainable = [name for name in names if registry.is_trainable(name)]
    by_name = split_names(patterns)
    for name in names:
        reason = registry.untrainable_reason(name)
        if name in by_name and registry.get_variant(name).trained_by:
            raise OptionError(f"{name} {reason}")
        if reason and trainable:
            note(f"{name} {reason}")
    if not trainable:
        reasons = ", ".join(f"{name} {registry.untrainable_reason(name)}" for name in names)
        raise OptionError(f"nothing to train: {reasons}")
    return trainable


def pool_kinds(names: Iterable[str]) -> set[str]:
    """The kinds of sample pool that methods draw from."""
    from rlbench import registry

    return {registry.get_variant(name).traits.pool for name in names}


def warn_without_networks(names: Collection[str], half: bool, weights: WeightsChoice) -> None:
    """Say that --half and --weights have no effect, if no method has networks."""
    from rlbench import registry

    has_networks = any(registry.get_variant(name).learned for name in names)
    if (half or weights.file) and not has_networks:
        text = f"--half and --weights have no effect, because {', '.join(names)} has no networks"
        note(text)
