"""Loads plugins by name: families, metrics, reports, pools and scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlbench.errors import PluginError
from rlbench.family import Family, Traits, Variant
from rlbench.registry.discovery import list_entries, module_file
from rlbench.registry.failure import describe_failure
from rlbench.registry.near_names import unknown_name
from rlbench.registry.plugin_code import exits_as_errors
from rlbench.registry.plugin_files import PluginEntry
from rlbench.registry.stand_ins import find_stand_in

if TYPE_CHECKING:
    from metrics.metric import Metric


def list_plugins(group: str) -> list[str]:
    """Names of the plugins of a group, also of those that cannot be imported.

    The names of the group `methods` are those of the families.
    """
    return list(list_entries(group))


def load_plugin(group: str, name: str) -> Any:
    """Import a plugin. An error of its import passes through.

    Raises PluginError for an unknown name.
    """
    known = list_entries(group)
    if name not in known:
        raise PluginError(_unknown(name, f"a {_kind(group)}", known))
    return known[name].load()


def load_or_explain(group: str, name: str) -> Any:
    """Import a plugin. Raises PluginError for an unknown name and for a failed import."""
    try:
        return load_plugin(group, name)
    except PluginError:
        raise
    except Exception as error:  # third-party code may raise anything
        plugin = f"{_kind(group)} '{name}' from {list_entries(group)[name].origin}"
        raise PluginError(
            f"{plugin} cannot be imported: {type(error).__name__}: {error}"
        ) from error


def import_error(group: str, name: str) -> str | None:
    """The error with which the import of a known plugin fails, or None."""
    try:
        load_family(name) if group == "methods" else load_plugin(group, name)
    except Exception as error:  # third-party code may raise anything
        return describe_failure(error, *_code_folders(list_entries(group)[name].target))
    return None


def failure_reason(method: str, error: BaseException, *folders: Path) -> str:
    """The error of a method, and the last line of the method's code that it passed through.

    If it passed through none, the last line of code in `folders`. It never raises, also for a
    method that cannot be imported.

    >>> failure_reason("mean", ValueError("no luck"))
    'ValueError: no luck'
    """
    try:
        target = load_family(method).build
    except Exception:  # its plugin cannot be imported; a file has the name of its module
        target = method.partition("/")[0]
    return describe_failure(error, *_code_folders(target), *folders)


def load_family(name: str) -> Family:
    """The family of a method, given as `family` or `family/variant`; does not import torch.

    >>> load_family("svgf").name
    'svgf'

    Raises PluginError for an unknown name, and for a plugin that is not a family of this name.
    """
    key = name.partition("/")[0]
    if family := find_stand_in(key):
        return family
    known = list_entries("methods")
    if key not in known:
        raise PluginError(_unknown(key, "a method", known))
    plugin = known[key].load()
    target = known[key].target
    if not isinstance(plugin, Family):
        raise PluginError(f"{target} is an object of type {type(plugin).__name__}, not a Family")
    if plugin.name != key:
        raise PluginError(f"{target} has the name '{plugin.name}', but is registered as '{key}'")
    _check_variants(plugin)
    return plugin


def find_method(name: str) -> tuple[Family, Variant]:
    """The family and the variant of a method, given as `family` or `family/variant`.

    Raises PluginError if its family has no such variant.
    """
    family = load_family(name)
    key = name.partition("/")[2]
    if key not in family.variants or name not in family.method_names():
        problem = f"'{family.name}' has no variant '{key}'"
        raise PluginError(unknown_name(problem, name, family.method_names(), "; it has"))
    return family, family.variants[key]


def get_variant(name: str) -> Variant:
    """The declared properties of a method. Raises PluginError as `find_method`."""
    return find_method(name)[1]


def load_run_metrics() -> dict[str, Metric]:
    """The metrics that `rlbench run` scores, by name. Raises PluginError as `load_metrics` does."""
    return {name: metric for name, metric in load_metrics().items() if metric.scored_by_run}


def load_memory_metrics() -> dict[str, Metric]:
    """The metrics that a run takes from the PSNR of a clip's frames, for methods with a memory."""
    return {name: metric for name, metric in load_metrics().items() if metric.from_psnr}


def load_metrics() -> dict[str, Metric]:
    """All metrics by name. Raises PluginError for a metric that cannot be imported."""
    return {name: load_or_explain("metrics", name) for name in list_plugins("metrics")}


def _check_variants(family: Family) -> None:
    """Raise PluginError for variants that are declared by other types."""
    variants = family.variants
    if not isinstance(variants, Mapping):
        raise PluginError(
            f"'{family.name}' has variants of type {type(variants).__name__}; a dictionary is "
            'expected, such as {"": Variant("its question", TRAITS)}'
        )
    for name, variant in variants.items():
        found = type(variant).__name__
        if not isinstance(variant, Variant):
            raise PluginError(
                f"variant '{name}' of '{family.name}' is of type {found}; a Variant is expected"
            )
        if not isinstance(variant.traits, Traits):
            raise PluginError(
                f"variant '{name}' of '{family.name}' has traits of type "
                f"{type(variant.traits).__name__}; Traits(...) is expected, such as "
                'Traits(inputs=frozenset({"albedo"}), adaptive=True)'
            )


def _code_folders(target: str) -> list[Path]:
    """The folder of the module in `module:attribute` or `file.py:attribute`, if it is found."""
    file = Path(target.rpartition(":")[0] or target)
    if file.is_file():
        return [file.parent]
    try:
        with exits_as_errors():  # a parent package is imported
            return [module_file(target).parent]
    except Exception:  # third-party code may raise anything
        return []


def _kind(group: str) -> str:
    return "stress section" if group == "stress" else group.removesuffix("s")


def _unknown(name: str, kind: str, known: Mapping[str, PluginEntry]) -> str:
    return unknown_name(f"'{name}' is not {kind}", name, known, "; there are")
