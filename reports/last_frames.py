"""Last frames: scores of whole clips beside those of their last quarter, and the order of a paper.

A row that learns on the frames themselves begins badly, and one with a memory begins without it:
the last quarter of each clip shows where they arrive. If relL2 was scored (`rlbench evaluate
--metrics psnr,rel_l2`), the order of Table 1 of Choi et al. 2024 gets a verdict, pair by pair. The
score of a pair is the ratio of both means over the frames of a clip. Its geometric mean over scenes
and the interval are those of its logarithm, because relL2 differs by orders of magnitude between
scenes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from itertools import combinations
from pathlib import Path

import msgspec
import pandas as pd

from reports.analysis.differences import (
    ALL_SCENES,
    correct_by_holm,
    difference_notes,
    rank_methods,
)
from reports.analysis.intervals import INTERVAL_NOTE, Interval, mean_with_interval
from reports.analysis.scores import Scores, keep_last_frames
from reports.layout.page import Section, write_report
from reports.layout.tables import Table, format_number, pivot, rank_rows, score_name, score_table

METRICS = ("psnr", "rel_l2")
MOST_SCENES = 16  # that a table has columns for
ALL, LAST = "all frames", "last quarter of each clip"
REPRODUCED, CONTRADICTED, NOT_SHOWN = "reproduced", "contradicted", "not shown"


@dataclass(frozen=True)
class PublishedRow:
    """A row of the paper's table and the row that corresponds to it here."""

    name: str  # as the paper writes it
    row: str
    rel_l2: Mapping[str, float]  # by scene of the paper
    note: str = ""  # how ours differs from it


@dataclass(frozen=True)
class PublishedOrder:
    """The table, from `published.toml` beside the method."""

    paper: str
    source: str
    spp: float  # budget of all scores
    rows: tuple[PublishedRow, ...]


@cache
def published_order() -> PublishedOrder:
    """The numbers of the paper. Raises msgspec.ValidationError if a field is missing."""
    file = files("baselines") / "cross" / "published.toml"
    return msgspec.toml.decode(file.read_bytes(), type=PublishedOrder)


def write(results: pd.DataFrame, folder: Path, name: str = "last-frames") -> list[Path]:
    """Write the page of PSNR and relL2 over all frames and the last ones, see `write_report`."""
    missing = "the results have no psnr; rlbench run scores it"
    return write_report(results, folder, name, "Last frames", _section, missing)


def _section(psnr: Scores) -> Section | None:
    if psnr.measured.empty:
        return None
    everything = {
        f"{score_name(metric)}, {part}": replace(psnr, metric=metric, rows=rows)
        for metric in METRICS
        for part, rows in ((ALL, psnr.rows), (LAST, keep_last_frames(psnr.rows)))
    }
    tabled = {title: scores for title, scores in everything.items() if len(scores.measured)}
    ranks = pd.concat([rank_methods(each).assign(table=title) for title, each in tabled.items()])
    records = correct_by_holm(ranks[ranks["scene"] == ALL_SCENES])
    tables = [
        score_table(scores, records[records["table"] == title], f"{scores.convention}. ", title)
        for title, scores in tabled.items()
    ]
    errors = {title: scores for title, scores in tabled.items() if scores.metric == "rel_l2"}
    pairs = pd.DataFrame([pair for item in errors.items() for pair in compare_order(*item)])
    if len(pairs):
        if psnr.measured["scene"].nunique() <= MOST_SCENES:
            tables += [_scene_table(scores, title) for title, scores in errors.items()]
        tables.append(_order_table(pairs))
    lists = {
        "Differences": difference_notes(records),
        "Differences from the paper's rows": [
            f"{each.row}: {each.note}" for each in published_order().rows if each.note
        ]
        * bool(len(pairs)),
        "Not run": psnr.skip_reasons,
        "Left out of the means": psnr.incomplete_groups,
        "Remarks": psnr.remarks,
    }
    return Section(psnr.device, tables, pd.concat([records, pairs]), lists)


def _scene_table(scores: Scores, title: str) -> Table:
    """Scores of each scene at the paper's budget."""
    paper = published_order()
    means = scores.scene_means[scores.scene_means["target_spp"] == paper.spp]
    names = sorted(set(means["scene"]))
    numbered = means.assign(scene=means["scene"].map(names.index))
    header, rows = pivot(
        numbered,
        lambda row: format_number(row["value"], ".3g"),
        rank_rows(means, "value", scores.direction),
        column="scene",
        heading=lambda index: names[int(index)],
    )
    return Table(f"{title}, by scene, {paper.spp:g} spp", "", header, rows)


def compare_order(title: str, scores: Scores) -> Iterator[dict[str, object]]:
    """A record for each pair of rows that the paper has and `scores` too, at the paper's budget.

    `published` are the ratios in the paper's scenes, `ratio`, `low` and `high` the ratio here, and
    `verdict` says if the paper's order of the pair is that here; it is empty where the paper's
    scenes disagree.
    """
    paper = published_order()
    means = scores.clip_means[scores.clip_means["target_spp"] == paper.spp]
    for better, worse in combinations(paper.rows, 2):
        one, other = (
            means[means["method"] == each.row].set_index(["scene", "clip"])["value"]
            for each in (better, worse)
        )
        logs = (one / other).dropna().map(math.log).reset_index()
        if logs.empty:
            continue
        ratios = [better.rel_l2[scene] / worse.rel_l2[scene] for scene in better.rel_l2]
        gap = mean_with_interval(logs)
        yield {
            "table": title,
            "pair": f"{better.row} / {worse.row}",
            "published": ", ".join(f"{ratio:.2f}" for ratio in ratios),
            "ratio": math.exp(gap.mean),
            "low": math.exp(gap.low),
            "high": math.exp(gap.high),
            "verdict": judge_order(ratios, gap),
        }


def judge_order(ratios: list[float], gap: Interval) -> str:
    """The verdict on an order, from the paper's ratios and the logarithm of ours.

    >>> judge_order([0.5, 0.6], Interval(-0.3, -0.5, -0.1, 4))
    'reproduced'
    >>> judge_order([0.5, 1.3], Interval(-0.3, -0.5, -0.1, 4))
    ''
    """
    if min(ratios) < 1 < max(ratios):
        return ""
    if not gap.excludes_zero:
        return NOT_SHOWN
    return REPRODUCED if (gap.mean < 0) == (max(ratios) < 1) else CONTRADICTED


def _order_table(pairs: pd.DataFrame) -> Table:
    paper = published_order()
    parts = dict(list(pairs.groupby("table", sort=False)))
    lines = {title: part.set_index("pair") for title, part in parts.items()}
    order = list(dict.fromkeys(pairs["pair"]))
    published = pairs.drop_duplicates("pair").set_index("pair")["published"]
    rows = tuple(
        (pair, published[pair], *(_ratio(part.loc[pair]) for part in lines.values()))
        for pair in order
    )
    scenes = " and ".join(paper.rows[0].rel_l2)
    caption = (
        f"Ratios of relL2 at {paper.spp:g} spp; below 1 the first row is ahead. Paper: "
        f"{paper.paper}, {paper.source}, {scenes}. Here: geometric mean over scenes. "
        f"Brackets: {INTERVAL_NOTE}. Reproduced: the interval excludes 1 on the paper's side; "
        "contradicted: on the other; not shown: it includes 1. No verdict where the paper's scenes "
        "disagree. No correction for several pairs."
    )
    return Table("Order of the paper", caption, ("pair", "paper", *map(str, lines)), rows)


def _ratio(row: pd.Series) -> str:
    text = f"{row['ratio']:.2f}"
    if not math.isnan(row["low"]):
        text += f" [{row['low']:.2f}, {row['high']:.2f}]"
    return f"{text} {row['verdict']}".strip()
