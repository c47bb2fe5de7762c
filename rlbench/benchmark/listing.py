"""What is installed, as plain data: for people as tables, for scripts as JSON."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rlbench import registry
from rlbench.benchmark import cost
from rlbench.family import Variant
from rlbench.registry.near_names import unknown_name

__all__ = ["Listing", "list_installed"]

Listing = dict[str, list[dict[str, Any]]]  # one list of rows a kind


def list_installed(kind: str = "all") -> Listing:
    """What is installed of one kind, or of all: one list of rows a kind.

    Kinds are methods, metrics, scenes, reports, pools, presets and profiles. A method, metric or
    pool that cannot be imported has the key `broken` with its error, as has a scene or report whose
    module is missing. Scenes and reports are not imported, since they import numpy, pandas and
    matplotlib, which takes seconds.

    >>> [row["name"] for row in list_installed("pools")["pools"]]
    ['path', 'restir']

    Raises PluginError for an unknown kind.
    """
    kinds: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "methods": _list_methods,
        "metrics": lambda: _list_plugins("metrics", ("unit", "direction", "convention")),
        "scenes": lambda: _find_plugins("scenes"),
        "reports": lambda: _find_plugins("reports") + _find_plugins("image_reports"),
        "pools": lambda: _list_plugins("pools", ("title",)),
        "presets": _list_presets,
        "profiles": _list_profiles,
    }
    if kind != "all" and kind not in kinds:
        problem = f"no kind '{kind}' to list"
        raise registry.PluginError(unknown_name(problem, kind, ["all", *kinds]))
    return {name: rows() for name, rows in kinds.items() if kind in ("all", name)}


def _list_methods() -> list[dict[str, Any]]:
    rows = []
    for name, entry in registry.list_entries("methods").items():
        if error := registry.import_error("methods", name):
            rows.append({"name": name, "from": entry.origin, "broken": error})
            continue
        family = registry.load_family(name)
        shared = {
            "title": family.title,
            "paper": family.paper,
            "licence": family.licence,
            "from": entry.origin,
        }
        pairs = zip(family.method_names(), family.variants.values(), strict=True)
        rows += [{"name": method, **_describe(variant), **shared} for method, variant in pairs]
    return rows


def _describe(variant: Variant) -> dict[str, Any]:
    traits = variant.traits
    return {
        "question": variant.question,
        "spp": list(traits.spp_range),
        "inputs": sorted(traits.inputs),
        "pool": traits.pool,
        "adaptive": traits.adaptive,
        "temporal": traits.temporal,
        "learned": variant.learned,
        "pretrained": variant.pretrained,
        "weights": _describe_weights(variant),
    }


def _describe_weights(variant: Variant) -> str:
    if not variant.learned:
        return ""
    if not variant.pretrained:
        return "to be trained"
    return f"shipped, by {variant.trained_by}" if variant.trained_by else "shipped"


def _list_plugins(group: str, attributes: tuple[str, ...]) -> list[dict[str, Any]]:
    """Name, origin and some attributes of each plugin; the error of one that is broken."""
    rows = []
    for name, entry in registry.list_entries(group).items():
        row: dict[str, Any] = {"name": name, "from": entry.origin}
        if error := registry.import_error(group, name):
            row["broken"] = error
        else:
            plugin = registry.load_plugin(group, name)
            row |= {attribute: getattr(plugin, attribute, "") for attribute in attributes}
        rows.append(row)
    return rows


def _find_plugins(group: str) -> list[dict[str, Any]]:
    """Name and origin of each plugin, without importing it; the error of one without a module."""
    rows = []
    for name, entry in registry.list_entries(group).items():
        row: dict[str, Any] = {"name": name, "from": entry.origin}
        try:
            registry.module_file(entry.target)
        except registry.PluginError as error:
            row["broken"] = str(error)
        rows.append(row)
    return rows


def _list_presets() -> list[dict[str, Any]]:
    from rlbench.render.presets import PRESETS

    return [
        {
            "name": preset.name,
            "purpose": preset.purpose,
            "height": preset.size[0],
            "width": preset.size[1],
            "frames": preset.frames,
            "reference_spp": 2 * preset.reference_spp * preset.max_reference_rounds,  # at most
            "scenes": list(preset.scenes),
            "takes": preset.takes,
            "generated": len(preset.seeds),
        }
        for preset in PRESETS.values()
    ]


def _list_profiles() -> list[dict[str, Any]]:
    measured = {"name": cost.MEASURED, "title": "this machine's path tracer"}
    profiles = [(name, cost.profile(name)) for name in cost.profiles()]
    return [measured, *({"name": n, "title": p.title, "source": p.source} for n, p in profiles)]
