"""What is installed, as plain data: for people as a table, for scripts as JSON."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rlbench import registry
from rlbench.benchmark import cost
from rlbench.family import Variant

Listed = dict[str, list[dict[str, Any]]]


def list_installed(kind: str = "all") -> Listed:
    """Everything of a kind, or of all kinds, by kind. Raises PluginError for an unknown kind."""
    kinds: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "methods": _methods,
        "metrics": _metrics,
        "scenes": lambda: _plain("scenes"),
        "reports": lambda: _plain("reports"),
        "pools": _pools,
        "presets": _presets,
        "profiles": _profiles,
    }
    if kind != "all" and kind not in kinds:
        raise registry.PluginError(f"'{kind}' cannot be listed; there are: all, {', '.join(kinds)}")
    return {name: tell() for name, tell in kinds.items() if kind in ("all", name)}


def _methods() -> list[dict[str, Any]]:
    found = []
    for name, entry in registry.list_entries("methods").items():
        if why := registry.import_error("methods", name):
            found.append({"name": name, "from": entry.origin, "broken": why})
            continue
        family = registry.load_family(name)
        shared = {
            "title": family.title,
            "paper": family.paper,
            "licence": family.licence,
            "from": entry.origin,
        }
        pairs = zip(family.method_names(), family.variants.values(), strict=True)
        found += [{"name": full, **_variant(variant), **shared} for full, variant in pairs]
    return found


def _variant(variant: Variant) -> dict[str, Any]:
    traits = variant.traits
    return {
        "question": variant.question,
        "spp": list(traits.spp_range),
        "needs": sorted(traits.inputs),
        "pool": traits.pool,
        "adapts": traits.adaptive,
        "temporal": traits.temporal,
        "learned": variant.learned,
        "shipped": variant.pretrained,
        "weights": ("shipped" if variant.pretrained else "to be trained")
        if variant.learned
        else "",
    }


def _metrics() -> list[dict[str, Any]]:
    return [
        {**row, **_fields(row["name"], "metrics", ("unit", "direction", "convention"))}
        for row in _plain("metrics")
    ]


def _pools() -> list[dict[str, Any]]:
    return [{**row, **_fields(row["name"], "pools", ("title",))} for row in _plain("pools")]


def _plain(group: str) -> list[dict[str, Any]]:
    """Name, origin and, where it cannot be loaded, why."""
    found = []
    for name, entry in registry.list_entries(group).items():
        why = registry.import_error(group, name)
        found.append({"name": name, "from": entry.origin} | ({"broken": why} if why else {}))
    return found


def _fields(name: str, group: str, wanted: tuple[str, ...]) -> dict[str, Any]:
    if registry.import_error(group, name):
        return {}
    found = registry.load_plugin(group, name)
    return {field: getattr(found, field, "") for field in wanted}


def _presets() -> list[dict[str, Any]]:
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


def _profiles() -> list[dict[str, Any]]:
    measured = {"name": cost.MEASURED, "title": "this machine's path tracer"}
    found = [(name, cost.profile(name)) for name in cost.profiles()]
    return [measured, *({"name": n, "title": p.title, "source": p.source} for n, p in found)]
