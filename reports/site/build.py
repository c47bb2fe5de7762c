"""All pages of the results, as files of the documentation that exist while it is built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from reports.site.leaderboard import (
    leaderboard_data,
    leaderboard_page,
    leaderboard_path,
    modules,
)
from reports.site.markdown import escape, front_matter, link, method_path, table
from reports.site.method_page import method_page, paper_links
from reports.site.preset_scores import PresetScores
from reports.site.scene_page import scene_page, scene_path

if TYPE_CHECKING:
    from rlbench.benchmark.listing import MethodFacts, SceneFacts

__all__ = ["build_pages"]

HOME, METHODS, SCENES = "leaderboard/index.md", "methods/index.md", "scenes/index.md"


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
    """
    working = [method for method in methods if not method.broken]
    by_name = {method.name: method for method in working}
    families = {key: list(rows) for key, rows in groupby(working, lambda each: each.family)}
    links, known = paper_links(), frozenset(by_name)
    pages: dict[str, str] = dict(modules())
    boards = _leaderboards(scores, by_name, report, pages)
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


def _leaderboards(
    scores: Sequence[PresetScores],
    methods: Mapping[str, MethodFacts],
    report: str,
    pages: dict[str, str],
) -> dict[str, str]:
    """Add the page and the data of each preset; returns the paths of the pages by preset."""
    boards = {}
    for preset, group in groupby(scores, lambda each: each.preset):
        own = list(group)
        path = leaderboard_path(preset)
        pages[path] = leaderboard_page(own, methods, report)
        pages[path.removesuffix(".md") + ".json"] = leaderboard_data(own, methods)
        boards[preset] = path
    return boards


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
        name = link(each.preset or "clips", leaderboard_path(each.preset), HOME)
        rows.append((name, str(len(each.methods)), str(len(each.scenes)), escape("; ".join(best))))
    return (
        front_matter("Leaderboard")
        + "# Leaderboard\n\nWhich row has the least error, on which clips, at which budget?\n\n"
        + table(("preset", "rows", "scenes", "best mean PSNR"), rows, numbers=False)
        + f"\nAll {methods} [methods](../{METHODS}) and {scenes} [scenes](../{SCENES}) have pages "
        "of their own. A mean over few scenes does not separate close rows: see the intervals, and "
        "[how results are compared](../concepts/statistics.md). "
        "[Publish results](../how-to/publish-results.md) says how numbers of others get here.\n"
    )


def _methods_home(families: Mapping[str, Sequence[MethodFacts]]) -> str:
    parts = [front_matter("Methods"), "# Methods\n"]
    for family, rows in families.items():
        lines = [
            (
                link(escape(row.name), method_path(row.name), METHODS),
                escape(row.question),
                _kind(row),
            )
            for row in rows
        ]
        head = ("row", "question", "kind")
        parts += [f"## {family}\n", f"{escape(rows[0].paper)}\n", table(head, lines, False)]
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
