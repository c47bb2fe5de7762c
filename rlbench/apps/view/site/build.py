"""All pages of the results, as files of the documentation that exist while it is built."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib.resources import files
from itertools import groupby
from typing import TYPE_CHECKING, Any

from reports.layout.tables import pipe_table
from rlbench.apps.view.site.markdown import escape, front_matter, link, method_path
from rlbench.apps.view.site.pages import (
    board_link,
    leaderboard_path,
    method_page,
    paper_links,
    scene_page,
    scene_path,
)
from rlbench.apps.view.site.preset_scores import PresetScores
from rlbench.apps.view.viewer.data import provenance
from rlbench.apps.view.viewer.page import to_json

if TYPE_CHECKING:
    from rlbench.apps.render.scene_facts import SceneFacts
    from rlbench.benchmark.listing import MethodFacts


HOME, METHODS, SCENES = "leaderboard/index.md", "methods/index.md", "scenes/index.md"
ASSETS = "leaderboard/assets"  # folder of modules and style, in the documents
VIEWER = ("dom.js", "state.js", "data.js", "copy.js", "table_rows.js", "table_view.js")
OWN = ("leaderboard.js", "leaderboard.css")


def build_pages(
    scores: Sequence[PresetScores],
    methods: Sequence[MethodFacts],
    scenes: Sequence[SceneFacts],
    pictures: Mapping[str, str] | None = None,
    images: Mapping[str, Sequence[str]] | None = None,
    report: str = "",
) -> tuple[dict[str, str], list[Any]]:
    """The content of each page by path, and the navigation of the pages as mkdocs reads it.

    `pictures` are paths of pictures by scene. `images` are the methods that a picture shows, by its
    path. `report` is the path of the viewer's page. Paths are those in the folder of documents.
    Rows that were never trained have no page.
    """
    working = [each for each in methods if not (each.broken or each.is_to_be_trained)]
    by_name = {method.name: method for method in working}
    families = {key: list(rows) for key, rows in groupby(working, lambda each: each.family)}
    links, known = paper_links(), frozenset(by_name)
    pages: dict[str, str] = dict(modules())
    boards = {}
    for preset, group in groupby(scores, lambda each: each.preset):
        own, path = list(group), leaderboard_path(preset)
        pages[path] = leaderboard_page(own, by_name, report)
        pages[path.removesuffix(".md") + ".json"] = leaderboard_data(own, by_name)
        boards[preset] = path
    for method in working:
        captions = {
            path: f"{', '.join(names)}: images, errors and samples"
            for path, names in (images or {}).items()
            if method.name in names
        }
        siblings = families[method.family]
        pages[method_path(method.name)] = method_page(method, siblings, scores, captions, links)
    for scene in scenes:
        picture = (pictures or {}).get(scene.name, "")
        pages[scene_path(scene.name)] = scene_page(scene, scores, picture, known)
    pages[METHODS] = _methods_home(families)
    pages[SCENES] = _scenes_home(scenes, pictures or {})
    pages[HOME] = _home(scores, len(working), len(scenes))
    return pages, _navigation(boards, families, scenes)


def _navigation(
    boards: Mapping[str, str],
    families: Mapping[str, Sequence[MethodFacts]],
    scenes: Sequence[SceneFacts],
) -> list[Any]:
    methods: list[Any] = [METHODS]
    for family, rows in families.items():
        methods.append({family: [method_path(row.name) for row in rows]})
    return [
        {"Leaderboard": [HOME, *({preset or "clips": path} for preset, path in boards.items())]},
        {"Methods": methods},
        {"Scenes": [SCENES, *(scene_path(scene.name) for scene in scenes)]},
    ]


def _home(scores: Sequence[PresetScores], methods: int, scenes: int) -> str:
    rows = []
    for each in scores:
        best = [
            f"{record['method']} ({record['mean']:.2f} dB at {spp:g} spp)"
            for spp in each.budgets
            for record in each.records
            if record["best"] and (record["scene"], record["target_spp"]) == (each.whole, spp)
        ]
        name = board_link(each, HOME, "clips")
        rows.append((name, str(len(each.methods)), str(len(each.scenes)), escape("; ".join(best))))
    return (
        front_matter("Leaderboard")
        + "# Leaderboard\n\nWhich row has the least error, on which clips, at which budget?\n\n"
        + pipe_table(("preset", "rows", "scenes", "best mean PSNR"), rows, numbers=False)
        + f"\nAll {methods} [methods](../{METHODS}) and {scenes} [scenes](../{SCENES}) have pages "
        "of their own. A mean over few scenes does not separate close rows: see the intervals, and "
        "[how results are compared](../concepts/statistics.md). "
        "[Publish results](../how-to/publish-results.md) says how numbers of others get here.\n"
    )


def _methods_home(families: Mapping[str, Sequence[MethodFacts]]) -> str:
    parts = [front_matter("Methods"), "# Methods\n"]
    for family, rows in families.items():
        lines = [
            (link(escape(r.name), method_path(r.name), METHODS), escape(r.question), _kind(r))
            for r in rows
        ]
        head = ("row", "question", "kind")
        parts += [f"## {family}\n", f"{escape(rows[0].paper)}\n", pipe_table(head, lines, False)]
    return "\n".join(parts)


def _kind(method: MethodFacts) -> str:
    words = ["learned" if method.learned else "by rule"]
    words += ["adaptive"] if method.traits.adaptive else []
    words += ["temporal"] if method.traits.temporal else []
    return ", ".join(words)


def _scenes_home(scenes: Sequence[SceneFacts], pictures: Mapping[str, str]) -> str:
    parts = [front_matter("Scenes"), "# Scenes\n"]
    for scene in scenes:
        parts.append(f"## {link(escape(scene.title), scene_path(scene.name), SCENES)}\n")
        if picture := pictures.get(scene.name):
            parts.append(f"!{link(escape(scene.title), picture, SCENES)}" + "{ width=320 }\n")
        parts += [f"{escape(text)}\n" for text in scene.about[:2]]
    return "\n".join(parts)


def modules() -> dict[str, str]:
    """The modules of the table, which are those of the viewer, and the style, by path."""
    viewer, own = (
        files("rlbench.apps.view.viewer") / "assets",
        files("rlbench.apps.view.site") / "assets",
    )
    sources = {name: viewer / name for name in VIEWER} | {name: own / name for name in OWN}
    return {f"{ASSETS}/{name}": path.read_text(encoding="utf-8") for name, path in sources.items()}


def leaderboard_data(scores: Sequence[PresetScores], methods: Mapping[str, MethodFacts]) -> str:
    """The data of a preset's table as JSON; `scores` are those of its devices."""
    names = sorted({name for each in scores for name in each.methods})
    data = {
        "devices": [{"name": each.scores.device, "table": each.table} for each in scores],
        "provenance": {n: p for each in scores for n, p in provenance(each.scores.rows).items()},
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
    return pipe_table(["method", *(f"{spp:g} spp" for spp in scores.budgets)], rows)
