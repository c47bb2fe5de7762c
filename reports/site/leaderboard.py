"""The leaderboard of a preset: its data, and the page that ranks, filters and sorts them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from reports.layout.tables import UNRELIABLE_MARK
from reports.site.markdown import escape, front_matter, link, method_path, table
from reports.site.preset_scores import PresetScores
from reports.viewer.page import to_json
from reports.viewer.table_data import provenance

if TYPE_CHECKING:
    from rlbench.benchmark.listing import MethodFacts

__all__ = ["ASSETS", "leaderboard_data", "leaderboard_page", "leaderboard_path", "modules"]

ASSETS = "leaderboard/assets"  # folder of modules and style, in the documents
VIEWER = ("dom.js", "state.js", "data.js", "copy.js", "table_rows.js", "table_view.js")
OWN = ("leaderboard.js", "leaderboard.css")


def leaderboard_path(preset: str) -> str:
    """The page of a preset; clips of no preset have a page too."""
    return f"leaderboard/{preset or 'clips'}.md"


def modules() -> dict[str, str]:
    """The modules of the table, which are those of the viewer, and the style, by path."""
    viewer, own = files("reports.viewer") / "assets", files("reports.site") / "assets"
    sources = {name: viewer / name for name in VIEWER} | {name: own / name for name in OWN}
    return {f"{ASSETS}/{name}": path.read_text(encoding="utf-8") for name, path in sources.items()}


def leaderboard_data(scores: Sequence[PresetScores], methods: Mapping[str, MethodFacts]) -> str:
    """The data of a preset's table as JSON; `scores` are those of its devices."""
    names = sorted({name for each in scores for name in each.methods})
    data = {
        "devices": [{"name": each.device, "table": each.table} for each in scores],
        "unreliable_mark": UNRELIABLE_MARK,
        "provenance": {n: p for each in scores for n, p in provenance(each.rows).items()},
        "traits": {name: _traits(methods[name]) for name in names if name in methods},
        "maps": {},
    }
    return to_json(data)


def leaderboard_page(
    scores: Sequence[PresetScores], methods: Mapping[str, MethodFacts], report: str = ""
) -> str:
    """The page in Markdown: a static table, which the module replaces where scripts run.

    `report` is the path of the viewer's page in the documents, empty without one.
    """
    first = scores[0]
    path = leaderboard_path(first.preset)
    base = os.path.relpath(ASSETS, path.removesuffix(".md"))  # pages are folders on the site
    name = first.preset or "clips"
    parts = [
        front_matter(f"Leaderboard: {name}", ("navigation", "toc")),
        f"# Leaderboard: {escape(name)}\n",
        f"{first.source} {link('Results', 'results/index.md', path)} have more presets, scores and "
        "times.\n",
        f"[Look at these results: the page of rlbench view]({os.path.basename(report)})\n"
        * bool(report),
        f'<link rel="stylesheet" href="{base}/leaderboard.css">',
        f'<script type="importmap">{_import_map(base)}</script>',
        f'<div class="leaderboard" data-source="../{name}.json" markdown>\n',
        _static_table(first, methods, path),
        "</div>",
        '<script type="module">import "site/leaderboard.js";</script>\n',
    ]
    return "\n".join(parts)


def _import_map(base: str) -> str:
    modules = {f"viewer/{name}": f"{base}/{name}" for name in VIEWER}
    return to_json({"imports": {**modules, "site/leaderboard.js": f"{base}/leaderboard.js"}})


def _traits(method: MethodFacts) -> dict[str, Any]:
    """What the table's filters read, and the address of the method's page."""
    page = method_path(method.name).removesuffix(".md").removesuffix("/index")
    return {
        "question": method.question,
        "paper": method.paper,
        "learned": method.learned,
        "adaptive": method.traits.adaptive,
        "temporal": method.traits.temporal,
        "pool": method.traits.pool,
        "inputs": sorted(method.traits.inputs),
        "page": f"../../{page}/",
    }


def _static_table(scores: PresetScores, methods: Mapping[str, MethodFacts], page: str) -> str:
    """Mean PSNR at all budgets, best first at the largest budget that a row has."""

    def best_first(method: str) -> list[float]:
        records = [scores.record(method, spp) for spp in reversed(scores.budgets)]
        return [-record["mean"] if record else 0.0 for record in records]

    rows = []
    for name in sorted(scores.methods, key=best_first):
        cell = link(escape(name), method_path(name), page) if name in methods else escape(name)
        records = [scores.record(name, spp) for spp in scores.budgets]
        rows.append([cell, *(f"{r['mean']:.2f}" if r else "–" for r in records)])
    return table(["method", *(f"{spp:g} spp" for spp in scores.budgets)], rows)
