"""The page of one scene: what it shows and tests, its lights and clips, scores of all rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from reports.site.markdown import escape, facts, front_matter, link, method_path, table, unbroken
from reports.site.preset_scores import PresetScores

if TYPE_CHECKING:
    from rlbench.benchmark.listing import SceneFacts, TakeFacts

__all__ = ["scene_page", "scene_path"]

STANDS_IN_FOR = {  # the scenes of Scardigli et al. 2023
    "city": "Emerald Square: an outdoor square with foliage, sun and sky",
    "temple": "SunTemple: an interior lit through narrow openings",
    "hall": "ZeroDay: a dark interior with hundreds of small emitters",
    "ripples": "Ripple Dreams: glass, water and caustics",
}


def scene_path(name: str) -> str:
    """The page of a scene."""
    return f"scenes/{name}.md"


def scene_page(
    scene: SceneFacts, scores: Sequence[PresetScores], picture: str, pages: frozenset[str]
) -> str:
    """The page in Markdown; `picture` is a path in the documents, empty without one.

    `pages` are the methods that have a page.
    """
    page = scene_path(scene.name)
    parts = [front_matter(scene.name), f"# {escape(scene.title)}\n"]
    if picture:
        parts += [f"!{link(escape(scene.title), picture, page)}" + "{ width=512 }\n"]
    parts += [f"{escape(text)}\n" for text in scene.about]
    parts += [_facts(scene), _takes(scene.takes)]
    for each in scores:
        if scene.name in each.scenes:
            parts.append(_scores(scene.name, each, page, pages))
    return "\n".join(parts)


def _facts(scene: SceneFacts) -> str:
    rows = [
        ("Stands in for", escape(STANDS_IN_FOR.get(scene.name, ""))),
        ("Lights", escape("; ".join(scene.lights))),
        ("Geometry", f"{scene.triangles:,} triangles" if scene.triangles else ""),
        ("Presets", ", ".join(f"`{name}`" for name in scene.presets)),
        ("Licence of images", escape(scene.licence)),
    ]
    return facts(rows)


def _takes(takes: Sequence[TakeFacts]) -> str:
    if not takes:
        return ""
    rows = [
        (
            f"`{take.clip}`",
            "static" if take.static else "animated",
            _frames(take.cuts),
            _frames(take.light_changes),
        )
        for take in takes
    ]
    head = ("clip", "camera and objects", "cut at frame", "lights switch at frame")
    return "## Clips\n\n" + table(head, rows, numbers=False)


def _frames(frames: Sequence[int]) -> str:
    return ", ".join(map(str, frames)) or "–"


def _scores(scene: str, scores: PresetScores, page: str, pages: frozenset[str]) -> str:
    """PSNR of all rows at all budgets, best first at the budget with most rows."""
    counts = {
        spp: sum(scores.record(m, spp, scene) is not None for m in scores.methods)
        for spp in scores.budgets
    }
    first = max(scores.budgets, key=lambda spp: (counts[spp], -abs(math.log2(spp or 1e-9))))

    def rank(method: str) -> tuple[float, str]:
        record = scores.record(method, first, scene)
        return (-record["mean"] if record else math.inf, method)

    rows = []
    for method in sorted(scores.methods, key=rank):
        name = escape(method)
        cell = link(name, method_path(method), page) if method in pages else name
        rows.append([cell, *(_score(method, scores, scene, spp) for spp in scores.budgets)])
    title = link(scores.preset or "own clips", f"leaderboard/{scores.preset or 'clips'}.md", page)
    return (
        f"## Scores: {title}\n\nPSNR in dB ± standard error over the frames, best at {first:g} spp "
        f"first. {scores.source}\n\n"
        + table(["method", *(f"{spp:g} spp" for spp in scores.budgets)], rows)
    )


def _score(method: str, scores: PresetScores, scene: str, spp: float) -> str:
    if not (record := scores.record(method, spp, scene)):
        return "–"
    error = scores.error(method, scene, spp)
    return unbroken(f"{record['mean']:.2f}" + ("" if math.isnan(error) else f" ±{error:.2f}"))
