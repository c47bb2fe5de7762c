"""The options of a command in a TOML file: read with --config, and written by every run.

methods = ["ours", "ntas"]
spp = [0.5, 1, 2, 4]
keep-images = true
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from rlbench.cli.arguments import PixelSize, WeightsChoice
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name
from rlbench.system import documents

# of the file that a run writes: they belong to one call
LEFT_OUT = ("config", "allow_plugins", "out")


def use(context: Any, file: Path | None) -> Path | None:
    """Take the options of a file as defaults of the command.

    Raises OptionError for a file that is not TOML, and for keys that are not options.
    """
    if file is None or context.resilient_parsing:
        return file
    known = {each.opts[0].removeprefix("--"): each for each in context.command.params}
    try:
        values = documents.read_toml(file)
    except ValueError as error:
        raise OptionError(f"--config: {error}") from error
    if unknown := [key for key in values if key not in known]:
        problem = f"--config {file}: no option '{unknown[0]}'"
        raise OptionError(unknown_name(problem, unknown[0], sorted(known)))
    texts = {known[key].name: _as_words(value, known[key]) for key, value in values.items()}
    context.default_map = {**(context.default_map or {}), **texts}
    return file


def check_trusted(context: Any, file: Path | None, allow_plugins: bool) -> None:
    """Raise OptionError where the file runs code or writes elsewhere and the caller did not say so.

    The file may be part of results by a stranger. What stands on the command line is the caller's.
    """
    if file is None:
        return
    values = documents.read_toml(file)
    values = {name: values[name] for name in values if _source(context, name) == "DEFAULT_MAP"}
    own = [name for name in values if _runs_code(name, values)]
    if own and not allow_plugins:
        found = "; ".join(f"{name} = {values[name]!r}" for name in own)
        raise OptionError(
            f"--config {file}: {found} runs code, and the file may be from somebody else. If you "
            "trust it, add --allow-plugins"
        )
    if "out" in values:
        out = Path(str(values["out"]))
        if not out.resolve().is_relative_to(Path.cwd().resolve()):
            raise OptionError(
                f"--config {file}: out = '{out}' is not in this folder. Name it yourself: --out "
                f"{out}"
            )


def _runs_code(name: str, values: Mapping[str, Any]) -> bool:
    """True for an option by which others run code here: a plugin file, a cluster's address."""
    return name == "plugin" or (name == "engine" and "=" in str(values[name]))


def _as_words(value: Any, parameter: Any) -> Any:
    """A value as it would stand on the command line; a flag as it is."""
    if isinstance(value, bool):
        return value
    items = value if isinstance(value, list) else [value]
    return list(map(str, items)) if parameter.multiple else ",".join(map(str, items))


def write(context: Any, file: Path, left_out: Collection[str] = ()) -> None:
    """Write the options that this call was given, on its command line or in a file."""
    given = {
        each.opts[0].removeprefix("--"): _as_toml(context.params[each.name])
        for each in context.command.params
        if each.name not in (*LEFT_OUT, *left_out) and _source(context, each.name) != "DEFAULT"
    }
    documents.write_toml(file, given)


def is_typed(context: Any, name: str) -> bool:
    """True if an option stands on the command line, not in the file alone."""
    return _source(context, name) == "COMMANDLINE"


def refuse_typed(context: Any, names: Iterable[str], of_what: str) -> None:
    """Raise OptionError for an option on the command line that is for something else."""
    if given := [name for name in names if is_typed(context, name)]:
        option = given[0].removeprefix("as_").replace("_", "-")
        raise OptionError(f"--{option} is for {of_what}. Omit it")


def _as_toml(value: Any) -> Any:
    if isinstance(value, WeightsChoice):
        return f"{value.label}={value.file}" if value.label else value.file
    if isinstance(value, PixelSize):
        return str(value)
    if isinstance(value, list | tuple):
        return [_as_toml(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def _source(context: Any, name: str) -> str:
    """Where an option's value is from: COMMANDLINE, DEFAULT_MAP, which is the file, or DEFAULT."""
    source = context.get_parameter_source(name.replace("-", "_"))
    return source.name if source else "DEFAULT"
