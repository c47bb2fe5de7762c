"""Plugins by name: methods, metrics, reports and scenes, imported when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rlbench.errors import PluginError
from rlbench.family import Family, Variant
from rlbench.registry.discovery import (
    GROUPS,
    VARIABLE,
    PluginEntry,
    clear_plugins,
    entries,
    module_file,
    plugin_file,
    resolve,
    use_plugin,
)
from rlbench.system import provenance

if TYPE_CHECKING:
    import torch

    from rlbench.method import Method

__all__ = [
    "GROUPS",
    "VARIABLE",
    "PluginEntry",
    "PluginError",
    "import_error",
    "entries",
    "expand",
    "current_name",
    "family",
    "clear_plugins",
    "is_trainable",
    "load",
    "plugin_file",
    "method",
    "metrics",
    "names",
    "module_file",
    "resolve",
    "training_task",
    "load_or_explain",
    "use_plugin",
    "variant",
]


def names(group: str) -> list[str]:
    """Names of a group's plugins, broken ones too; of methods the families."""
    return list(entries(group))


def load(group: str, name: str) -> Any:
    """The plugin itself. Whatever its import raises passes through."""
    known = entries(group)
    if name not in known:
        raise PluginError(_unknown(name, f"a {group.removesuffix('s')}", known))
    return known[name].load()


def load_or_explain(group: str, name: str) -> Any:
    """The plugin itself. Raises PluginError where it cannot be imported, too."""
    try:
        return load(group, name)
    except PluginError:
        raise
    except Exception as error:  # whatever a stranger's module may raise
        told = f"{group.removesuffix('s')} '{name}' of {entries(group)[name].origin}"
        raise PluginError(f"{told} is broken: {type(error).__name__}: {error}") from error


def import_error(group: str, name: str) -> str | None:
    """Why a known plugin cannot be loaded, or None if it can."""
    try:
        family(name) if group == "methods" else load(group, name)
    except Exception as error:  # whatever a stranger's module may raise is what is reported
        return f"{type(error).__name__}: {error}"
    return None


def family(name: str) -> Family:
    """The family that a method belongs to, by `family` or `family/variant`; no torch is needed."""
    key = name.partition("/")[0]
    known = entries("methods")
    if key not in known:
        raise PluginError(_unknown(key, "a method", known))
    found = known[key].load()
    if not isinstance(found, Family):
        raise PluginError(f"{known[key].target} is a {type(found).__name__}, not a Family")
    if found.name != key:
        raise PluginError(f"{known[key].target} calls itself '{found.name}', not '{key}'")
    return found


def current_name(name: str) -> str:
    """The name with a former variant name (`Family.aliases`) replaced by the current one."""
    key, _, former = name.partition("/")
    current = family(name).aliases.get(former)
    return name if current is None else f"{key}/{current}"


def variant(name: str) -> Variant:
    """What a method says of itself. Raises PluginError if its family has no such variant."""
    found, name = family(name), current_name(name)
    key = name.partition("/")[2]
    if key not in found.variants or name not in found.names():
        have = ", ".join(found.names())
        raise PluginError(f"'{found.name}' has no variant '{key}'; it has: {have}")
    return found.variants[key]


def method(name: str, device: torch.device | str = "cpu", weights: str | None = None) -> Method:
    """The method `family` or `family/variant` on a device, with shipped, given or random weights.

    Raises PluginError if a package that it needs is not installed, or if its traits are not those
    that its family declares.
    """
    import torch

    from rlbench.method import Method

    name = current_name(name)
    declared = variant(name)
    if absent := " ".join(provenance.missing(declared.requires)):
        raise PluginError(f"'{name}' needs {absent}, which is not here: pip install {absent}")
    build = resolve(family(name).build)
    built = build(name.partition("/")[2], torch.device(device), weights)
    if not isinstance(built, Method):
        raise PluginError(f"{family(name).build} returned a {type(built).__name__}, not a Method")
    if built.traits != declared.traits:
        raise PluginError(f"'{name}' declares {declared.traits}, but was built as {built.traits}")
    return built


def training_task(name: str, device: torch.device | str = "cpu", seed: int = 0) -> Any:
    """What is trained of a method: the `rlbench.training.task.Trainer` that its `train` makes.

    Raises PluginError where nothing is learned.
    """
    import torch

    name = current_name(name)
    if not is_trainable(name):
        raise PluginError(f"'{name}' has nothing to train")
    return resolve(family(name).train)(name.partition("/")[2], torch.device(device), seed)


def is_trainable(name: str) -> bool:
    """Is there anything to train?"""
    asked = variant(name)
    return asked.learned and asked.weights_from is None and bool(family(name).train)


def metrics() -> dict[str, Any]:
    """All metrics by name. Raises PluginError where one cannot be imported."""
    return {name: load_or_explain("metrics", name) for name in names("metrics")}


def expand(
    patterns: Iterable[str], trained: bool = True, tell: Callable[[str], None] | None = None
) -> list[str]:
    """Method names without repeats: `all` is every family, `family/*` all variants of one.

    `all/*` is every variant of every family. A variant without shipped weights has to be named,
    unless `trained` is not asked for. With someone to `tell`, `all` goes on without families that
    are broken. Raises PluginError for a name that is not there.
    """
    found: dict[str, None] = {}
    for pattern in patterns:
        key, _, rest = pattern.partition("/")
        for each in _families(tell) if key == "all" else [key]:
            full = f"{each}/{rest}" if rest else each
            for name in family(each).names() if rest == "*" else [current_name(full)]:
                if variant(name).pretrained or not trained or rest != "*":
                    found[name] = None
    return list(found)


def _families(tell: Callable[[str], None] | None) -> list[str]:
    """All families, or those that can be loaded, with a word on each of the others."""
    whole = []
    for name in names("methods"):
        if tell and (why := import_error("methods", name)):
            tell(f"all is without {name}, which is broken: {why}")
        else:
            whole.append(name)
    return whole


def _unknown(name: str, kind: str, known: Mapping[str, PluginEntry]) -> str:
    return f"'{name}' is not {kind}; there are: {', '.join(known) or 'none'}"
