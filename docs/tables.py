"""Fill the generated tables of README and documentation: python docs/tables.py

A table stands between `<!-- table: SOURCE -->` and `<!-- /table -->`. SOURCE is one of:

- `results/unseen.md#First frame`: the table under that heading of a page of results
- `families`: every family, its paper and its licence
- `rows PATTERN,...`: rows such as `ours/latent*`, their questions and weights
- `scores ROW,...`: PSNR of rows on `mini` and on `real`, at 192x192 and 640x360, and a frame's time
- `scenes PRESET`: the scenes by others of a preset, their authors, and what each has
- `denoise`: what `rlbench denoise` gives, from `results/denoise.csv` (`docs/measure_denoise.py`)
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

from rlbench import registry
from rlbench.apps.render.scenes.collection.catalog import load_catalog
from rlbench.benchmark.listing import MethodFacts, method_facts
from rlbench.weights import ModelCard

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))
BLOCK = re.compile(r"(<!-- table: (.+?) -->\n).*?(<!-- /table -->)", re.DOTALL)
BUDGETS = ("1 spp", "4 spp")
TIMES = "mini-640x360-times"  # page of results
SCORES = {  # title of columns: page of results
    "mini": "summary",
    "mini, 640x360": "mini-640x360",
    "real": "real",
    "real, 640x360": "real-640x360",
}


def fill_tables(page: str) -> str:
    """The text of a page with all its tables made anew."""
    return BLOCK.sub(lambda block: f"{block[1]}{_make_table(block[2])}\n{block[3]}", page)


def _make_table(source: str) -> str:
    kind, _, names = source.partition(" ")
    if source == "families":
        return _format(_list_families())
    if source == "denoise":
        return _format(_list_denoised())
    if kind == "rows":
        return _format(_list_rows(names.split(",")))
    if kind == "scenes":
        return _format(_list_scenes(names))
    if kind == "scores":
        return _format(_list_scores(names.split(",")))
    page, _, heading = source.partition("#")
    return _format(_read_table(page, heading))


def _format(rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def _read_table(page: str, heading: str) -> list[list[str]]:
    """The cells of the first table under a heading, with header and rule."""
    text = (DOCS / page).read_text()
    section = text[text.index(f"### {heading}\n") :]
    lines = re.search(r"(?:^\|.*\n)+", section, re.MULTILINE)
    if lines is None:
        raise ValueError(f"no table under '{heading}' in {page}")
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[0].splitlines()]


@cache
def _facts() -> list[MethodFacts]:
    return method_facts()


def _list_families() -> list[list[str]]:
    """A line for each family: its title, its paper and its licence."""
    rows = {
        facts.family: [f"`{facts.family}`", facts.title, facts.paper, facts.licence]
        for facts in _facts()
    }
    return [["family", "method", "paper", "licence"], ["---"] * 4, *rows.values()]


def _list_rows(patterns: Sequence[str]) -> list[list[str]]:
    """A line for each row: its question, whose weights it has, and how long they trained."""
    rows = [["row", "question", "weights", "frames trained"], ["---", "---", "---", "---:"]]
    for facts in _facts():
        if any(fnmatch(facts.name, pattern) for pattern in patterns):
            source = registry.get_variant(facts.name).weights_from
            weights = f"`{source}`" if source else facts.weights.removeprefix("shipped, ")
            rows.append([f"`{facts.name}`", facts.question, weights, _format_training(facts.card)])
    return rows


def _format_training(card: ModelCard | None) -> str:
    """How many frames weights were trained on, over all starts, and if validation still rose."""
    if card is None or not card.frames_trained:
        return ""
    return f"{card.frames_trained:,}" + f" ({card.trend})" * bool(card.trend)


def _list_scores(names: Sequence[str]) -> list[list[str]]:
    """PSNR of rows on `mini` and on `real` at two sizes without intervals, and the frame time."""
    pages = {
        title: _read_table(f"results/{page}.md", "PSNR [dB], mean over scenes")
        for title, page in SCORES.items()
    }
    times = _read_frame_times()
    head = ["row", *(f"{title}: {spp}" for title in pages for spp in BUDGETS)]
    head.append("640x360, 1 spp: ms a frame")
    rows = [head, ["---", *["---:"] * (len(head) - 1)]]
    for name in names:
        cells = [f"`{name}`"]
        for header, _, *lines in pages.values():
            line = next((line for line in lines if line[0].strip("*") == name), [])
            scores = dict(zip(header, line, strict=False))
            cells += [scores.get(spp, "-").split("[")[0].strip(" *") for spp in BUDGETS]
        rows.append([*(cell.removesuffix(" tie") for cell in cells), times.get(name, "-")])
    return rows


def _read_frame_times() -> dict[str, str]:
    """Whole milliseconds of a frame at 1 spp and 640x360, by row."""
    header, _, *lines = _read_table(f"results/{TIMES}.md", "frame time [ms], mean over scenes")
    times = (dict(zip(header, line, strict=True)) for line in lines)
    return {
        each["method"]: re.sub(r"\.\d+", "", each["frame"])
        for each in times
        if each["target spp"] == "1"
    }


def _list_scenes(preset: str) -> list[list[str]]:
    """A line for each scene by others of a preset."""
    rows = [["scene", "title, author, licence", "what it has"], ["---"] * 3]
    for scene in load_catalog().values():
        if preset in scene.presets:
            title = f"[{scene.title}]({scene.source}), {scene.author}, {scene.licence}"
            rows.append([f"`{scene.name}`", title, scene.shows])
    return rows


def _list_denoised() -> list[list[str]]:
    """PSNR, warped error and flicker of rows on files, by samples per pixel."""
    with (DOCS / "results" / "denoise.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    budgets = sorted({int(line["spp"]) for line in lines})
    metrics = {"psnr": "PSNR", "warped_error": "warped", "flicker": "flicker"}
    head = ["row", *(f"{spp} spp: {title}" for spp in budgets for title in metrics.values())]
    rows = [head, ["---", *["---:"] * (len(head) - 1)]]
    for name in dict.fromkeys(line["row"] for line in lines):
        found = {int(line["spp"]): line for line in lines if line["row"] == name}
        cells = [f"{float(found[spp][metric]):.2f}" for spp in budgets for metric in metrics]
        rows.append([f"`{name}`", *cells])
    return rows


def main() -> None:
    """Write every page whose tables changed."""
    for page in PAGES:
        text = page.read_text()
        if (filled := fill_tables(text)) != text:
            page.write_text(filled)


if __name__ == "__main__":
    main()
