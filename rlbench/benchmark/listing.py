"""What is installed, as plain data: for people as tables, for scripts as JSON, for pages as facts.

torch is imported only where weights have a card. No scene is built.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rlbench import registry
from rlbench.benchmark.cost_profile import MEASURED, list_profiles, read_profile
from rlbench.clips.presets import PRESETS
from rlbench.family import Traits, Variant
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    import pandas as pd

    from rlbench.weights import ModelCard

Row = dict[str, Any]
Listing = dict[str, list[Row]]  # one list of rows a kind


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
    kinds: dict[str, Callable[[], list[Row]]] = {
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


def _list_methods() -> list[Row]:
    rows = []
    for name, entry in registry.list_entries("methods").items():
        if error := registry.import_error("methods", name):
            rows.append({"name": name, "from": entry.origin, "broken": error})
            continue
        family = registry.load_family(name)
        shared = {name: getattr(family, name) for name in ("title", "paper", "licence")}
        shared["from"] = entry.origin
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
        "recordable": not traits.eager_reason,
        "eager_reason": traits.eager_reason,
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


def _list_plugins(group: str, attributes: tuple[str, ...]) -> list[Row]:
    """Name, origin and some attributes of each plugin; the error of one that is broken."""
    rows = []
    for name, entry in registry.list_entries(group).items():
        row: Row = {"name": name, "from": entry.origin}
        if error := registry.import_error(group, name):
            row["broken"] = error
        else:
            plugin = registry.load_plugin(group, name)
            row |= {attribute: getattr(plugin, attribute, "") for attribute in attributes}
        rows.append(row)
    return rows


def _find_plugins(group: str) -> list[Row]:
    """Name and origin of each plugin, without importing it; the error of one without a module."""
    rows = []
    for name, entry in registry.list_entries(group).items():
        row: Row = {"name": name, "from": entry.origin}
        try:
            registry.module_file(entry.target)
        except registry.PluginError as error:
            row["broken"] = str(error)
        rows.append(row)
    return rows


def _list_presets() -> list[Row]:

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


def _list_profiles() -> list[Row]:
    measured = {"name": MEASURED, "title": "this machine's path tracer"}
    profiles = [(name, read_profile(name)) for name in list_profiles()]
    return [measured, *({"name": n, "title": p.title, "source": p.source} for n, p in profiles)]


@dataclass(frozen=True)
class MethodFacts:
    """A row of the benchmark: its family, its traits and its weights."""

    name: str  # family or family/variant
    family: str
    title: str
    question: str
    paper: str
    licence: str
    learned: bool
    weights: str  # where they come from, in words; empty without networks
    card: ModelCard | None  # of the shipped weights
    traits: Traits
    broken: str = ""  # why the family cannot be imported

    @property
    def is_to_be_trained(self) -> bool:
        """True if the row has networks, and no weights ship."""
        return self.learned and self.card is None


def method_facts() -> list[MethodFacts]:
    """All installed rows, in the order of their families; those that cannot be imported last."""
    facts = map(_method_facts, list_installed("methods")["methods"])
    return sorted(facts, key=lambda each: bool(each.broken))


def frames_trained(rows: pd.DataFrame) -> dict[str, int]:
    """Frames that the weights of rows were trained on, over all starts, by the name of the row.

    Rows without a training of ours, and those whose weights are not among the shipped ones, are
    left out.
    """
    from rlbench.benchmark.content_hash import hash_file

    cards = {registry.shipped_weights(row.name): row.card for row in method_facts() if row.card}
    trained = {hash_file(file): card.frames_trained for file, card in cards.items()}
    pairs = zip(rows["method"], rows["weights_hash"].str.partition(",")[0], strict=True)
    return {name: trained[weights] for name, weights in set(pairs) if trained.get(weights)}


def _method_facts(row: Mapping[str, Any]) -> MethodFacts:
    name = str(row["name"])
    if "broken" in row:
        unknown = "", "", "", "", False, "", None
        return MethodFacts(name, name, *unknown, Traits(), row["broken"])
    variant = registry.get_variant(name)
    texts = {key: str(row[key]) for key in ("title", "question", "paper", "licence", "weights")}
    return MethodFacts(
        name=name,
        family=name.partition("/")[0],
        learned=variant.learned,
        card=_card(name) if variant.learned else None,
        traits=variant.traits,
        **texts,
    )


def _card(name: str) -> ModelCard | None:
    """The model card of the weights that a method ships with, its own or another's."""
    file = registry.shipped_weights(name)
    if not file.is_file():
        return None
    from rlbench.weights import read_card

    return read_card(file)
