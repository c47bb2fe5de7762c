"""The pages of one method and of one scene: facts, scores, images."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from reports.layout.tables import pipe_table
from rlbench.apps.view.site.markdown import escape, facts, front_matter, link, method_path, unbroken
from rlbench.apps.view.site.preset_scores import PresetScores
from rlbench.benchmark.results import mark_uncertainty

if TYPE_CHECKING:
    from rlbench.apps.render.scene_facts import SceneFacts, TakeFacts
    from rlbench.benchmark.listing import MethodFacts
    from rlbench.weights import ModelCard


MAX_SCENES = 8  # of a preset whose scenes have columns of their own
PAPERS = Path(__file__).parent / "papers.toml"
STANDS_IN_FOR = {  # the scenes of Scardigli et al. 2023
    "city": "Emerald Square: an outdoor square with foliage, sun and sky",
    "temple": "SunTemple: an interior lit through narrow openings",
    "hall": "ZeroDay: a dark interior with hundreds of small emitters",
    "ripples": "Ripple Dreams: glass, water and caustics",
}


def paper_links() -> dict[str, str]:
    """Where the paper of a family can be read, by family."""
    return tomllib.loads(PAPERS.read_text(encoding="utf-8"))


def method_page(
    method: MethodFacts,
    siblings: Sequence[MethodFacts],
    scores: Sequence[PresetScores],
    images: Mapping[str, str],
    links: Mapping[str, str],
) -> str:
    """The page in Markdown.

    `siblings` are all rows of the family, `images` captions of pictures that show the method, by
    path in the documents, `links` those of `paper_links`.
    """
    page = method_path(method.name)
    parts = [front_matter(method.name), f"# `{method.name}`\n", f"*{escape(method.title)}*\n"]
    parts += [f"> {escape(method.question)}\n", _method_facts(method, links, scores)]
    measured = [each for each in scores if method.name in each.methods]
    parts += ["## Scores\n"]
    parts += [_method_scores(method.name, each, page) for each in measured] or [_unmeasured(method)]
    if method.card:
        parts += ["## Weights\n", _card(method.card)]
    parts += ["## Images\n"] * bool(images)
    for path, text in images.items():
        picture = link("!" + link(escape(text), path, page), path, page)
        parts.append(f"{picture}\n\n{escape(text)}\n")
    commands = f"```bash\nrlbench run -m {method.name}\nrlbench check {method.name}\n```\n"
    parts += ["## Run it\n", commands, _siblings(method, siblings, page)]
    return "\n".join(parts)


def _method_facts(
    method: MethodFacts, links: Mapping[str, str], scores: Sequence[PresetScores]
) -> str:
    traits = method.traits
    paper = escape(method.paper)
    url = links.get(method.family)
    low, high = traits.spp_range
    sampling = "by a density of its own" if traits.adaptive else "equal in all pixels"
    rows = [
        ("Paper", f"[{paper}]({url})" if url else paper),
        ("Licence", escape(method.licence)),
        ("Networks", f"yes; weights {method.weights}" if method.learned else "none"),
        ("Samples", f"{sampling}{_passes(method)}"),
        ("Pool", f"`{traits.pool}`"),
        ("Memory", "from frame to frame" if traits.temporal else "none, each frame by itself"),
        ("G-buffer", ", ".join(sorted(traits.inputs)) or "not read"),
        ("Budgets", f"{low:g} to {high:g} samples per pixel"),
        ("Cost", _cost(method.name, scores)),
    ]
    return facts(rows)


def _passes(method: MethodFacts) -> str:
    traits = method.traits
    text = f", after {traits.pilot_spp:g} uniform ones per pixel" if traits.pilot_spp else ""
    if len(traits.passes) > 1:
        text += f", in {len(traits.passes)} passes"
    if traits.min_samples:
        text += f", at least {traits.min_samples} in each pixel"
    return text


def _cost(name: str, scores: Sequence[PresetScores]) -> str:
    """Inference at the budget nearest to 1 spp, from the first results that have it."""
    for each in scores:
        timed = [
            (abs(math.log2(spp or 1e-9)), spp, record)
            for spp in each.budgets
            if (record := each.record(name, spp)) and not math.isnan(record["inference_ms"])
        ]
        if timed:
            _, spp, record = min(timed, key=lambda item: item[0])
            mark = mark_uncertainty(record["inference_uncertainty"])
            sizes = ", ".join(sorted(set(each.scores.rows["size"]) - {""}))
            return (
                f"inference {record['inference_ms']:.3g}{mark} ms a frame at {spp:g} spp, {sizes}, "
                f"on {escape(each.scores.device)}"
            )
    return "times belong to a machine: `rlbench speed` measures them"


def _method_scores(name: str, scores: PresetScores, page: str) -> str:
    device = f", {escape(scores.scores.device)}" if scores.scores.device else ""
    scenes = scores.scenes if 1 < len(scores.scenes) <= MAX_SCENES else []
    header = ["spp", "rank", "PSNR dB", "to the best", *scenes]
    rows = []
    for spp in scores.budgets:
        if not (record := scores.record(name, spp)):
            continue
        place, count = scores.rank(name, spp)
        overall = (unbroken(f"{place} of {count}"), f"{record['mean']:.2f}", _gap(record))
        by_scene = [_score(name, scores, scene, spp) for scene in scenes]
        rows.append([f"{spp:g}", *overall, *by_scene])
    return (
        f"### {board_link(scores, page)}{device}\n\n{pipe_table(header, rows)}\n"
        "PSNR is the mean over scenes. Brackets: 95 % interval of the paired difference to the "
        f"best row at this budget. ±: standard error over the frames of a scene. {scores.source}\n"
    )


def _gap(record: Mapping[str, float | str | bool]) -> str:
    if record["best"]:
        return "best"
    difference, low, high = (float(record[key]) for key in ("difference", "low", "high"))
    ends = "" if math.isnan(low) else f" [{low:+.2f}, {high:+.2f}]"
    return unbroken(f"{difference:+.2f}{ends}")


def _unmeasured(method: MethodFacts) -> str:
    return f"None in the results of this site. `rlbench run -m {method.name}` measures them.\n"


def _card(card: ModelCard) -> str:
    before = f" after {card.frames_before}" if card.frames_before else ""
    crops = f"{card.frames_seen} crops{before}"
    trained = f"{crops}, {card.steps} steps, {card.seconds:.0f} s on {card.device}"
    scenes = f"{len(card.data)} clips, {card.data[0]} to {card.data[-1]}" if card.data else ""
    curve = "; ".join(f"{psnr:.2f} dB after {seen}" for seen, psnr in card.validation_history[-2:])
    rows = [
        ("Made for", f"`{card.name}`"),
        ("Parameters", f"{card.parameters:,} values, {card.dtype}"),
        ("Trained on", escape(scenes)),
        ("Training", escape(trained) if card.steps else ""),
        ("Validation", f"{curve} ({card.trend})" if card.trend else curve),
        ("Started from", escape(card.origin)),
        ("Seed", str(card.seed) if card.steps else ""),
        ("Command", f"`{card.command}`" if card.command else ""),
        ("Commit", f"`{card.commit}`" if card.commit else ""),
        ("Licence", escape(card.licence)),
        ("SHA-256", f"`{card.sha256[:16]}`"),
        ("Note", escape(card.note)),
    ]
    return facts(rows)


def _siblings(method: MethodFacts, siblings: Sequence[MethodFacts], page: str) -> str:
    others = [
        (link(escape(each.name), method_path(each.name), page), escape(each.question))
        for each in siblings
        if each.name != method.name
    ]
    if not others:
        return ""
    rows = pipe_table(("row", "question"), others, numbers=False)
    return f"## Other rows of the family\n\n{rows}"


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
    parts += [_scene_facts(scene), _takes(scene.takes)]
    for each in scores:
        if scene.name in each.scenes:
            parts.append(_scene_scores(scene.name, each, page, pages))
    return "\n".join(parts)


def _scene_facts(scene: SceneFacts) -> str:
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
            f"`{t.clip}`",
            "static" if t.static else "animated",
            *map(_frames, (t.cuts, t.light_changes)),
        )
        for t in takes
    ]
    head = ("clip", "camera and objects", "cut at frame", "lights switch at frame")
    return "## Clips\n\n" + pipe_table(head, rows, numbers=False)


def _frames(frames: Sequence[int]) -> str:
    return ", ".join(map(str, frames)) or "–"


def _scene_scores(scene: str, scores: PresetScores, page: str, pages: frozenset[str]) -> str:
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
    return (
        f"## Scores: {board_link(scores, page)}\n\nPSNR in dB ± standard error over the frames, "
        f"best at {first:g} spp first. {scores.source}\n\n"
        + pipe_table(["method", *(f"{spp:g} spp" for spp in scores.budgets)], rows)
    )


def leaderboard_path(preset: str) -> str:
    """The page of a preset; clips of no preset have a page too."""
    return f"leaderboard/{preset or 'clips'}.md"


def board_link(scores: PresetScores, page: str, unnamed: str = "own clips") -> str:
    """The link from a page to the leaderboard of a preset."""
    return link(scores.preset or unnamed, leaderboard_path(scores.preset), page)


def _score(method: str, scores: PresetScores, scene: str, spp: float) -> str:
    if not (record := scores.record(method, spp, scene)):
        return "–"
    error = scores.error(method, scene, spp)
    return unbroken(f"{record['mean']:.2f}" + ("" if math.isnan(error) else f" ±{error:.2f}"))
