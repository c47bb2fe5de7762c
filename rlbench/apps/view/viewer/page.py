"""Writes the page: data, pictures, style and modules in one file of HTML."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import matplotlib as mpl
import numpy as np
import pandas as pd

from reports.analysis.differences import TIE_DB, VERDICT_NOTE
from reports.analysis.rows import check_comparable, methods_from_elsewhere, split_by_device
from reports.analysis.scores import Scores
from reports.layout.page import describe_clips
from reports.layout.style import line_styles
from rlbench.apps.view.viewer.data import (
    decision_data,
    frame_scores,
    provenance,
    student_factors,
    table_data,
)
from rlbench.apps.view.viewer.opening import Opening, choose_opening
from rlbench.apps.view.viewer.pictures import MAX_METHODS, pack_clips
from rlbench.benchmark.results import WIDE
from rlbench.system.store import write_text

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

ASSETS = files("rlbench.apps.view.viewer") / "assets"
# perceptually uniform and safe for colour-blind readers: Smith and van der Walt 2015 (matplotlib);
# vik: Crameri 2018; blue below zero, red above, as in RdBu of Harrower and Brewer 2003
COLOUR_MAPS = {"error": "magma", "counts": "viridis", "depth": "cividis", "signed": "RdBu_r"}
FEW_BYTES = 2000  # for what is not counted
TITLE_NAMES = 4  # of images, in the title of a page


def write(
    results: pd.DataFrame,
    file: Path,
    clips: Sequence[ShownClip] = (),
    traits: Mapping[str, Mapping[str, Any]] | None = None,
    remarks: Sequence[str] = (),
    max_bytes: int = 20_000_000,
    opening: Opening | None = None,
) -> list[str]:
    """Write the page `file`, at most `max_bytes` long, and return remarks on what it leaves out.

    `traits` describes methods, for filters, and `remarks` says why there are no images. `opening`
    is the first question, if it was chosen already. Equal
    arguments give equal bytes. Raises ReportError if rows cannot be compared, and PicturesError if
    the images do not fit.
    """
    devices = split_by_device(results)
    for rows in devices.values():
        check_comparable(rows)
    chosen, left_out = _select_methods(clips, results)
    opening = opening or choose_opening(results)
    data = {
        **_data_of_every_page(describe_clips(results), [*remarks, *left_out]),
        "devices": [
            {
                "place": Scores(rows, device=name).place,
                "decide": decision_data(rows, name),
                "table": table_data(rows, name),
            }
            for name, rows in devices.items()
        ],
        "question": {"sample": opening.sample_ms, "deadline": opening.deadline_ms}
        if opening
        else {},
        "student": student_factors(max(results["scene"].nunique(), results["clip"].nunique())),
        "tie_db": TIE_DB,
        "wide": WIDE,
        "claimed": methods_from_elsewhere(results),
        "verdict_note": VERDICT_NOTE,
        "frames": frame_scores(results, [clip.name for clip in chosen]),
        "provenance": provenance(results),
        "traits": traits or {},
        "looks": _looks(results),
    }
    _write_page(data, chosen, file, max_bytes)
    return left_out


def write_gallery(
    images: ShownClip, file: Path, remarks: Sequence[str] = (), max_bytes: int = 20_000_000
) -> None:
    """Write the page `file` with images alone, without results, references and budgets.

    Raises PicturesError if the images do not fit into `max_bytes`.
    """
    names = [each.method for each in images.images]
    more = f" and {len(names) - TITLE_NAMES} more" * (len(names) > TITLE_NAMES)
    data = _data_of_every_page(", ".join(names[:TITLE_NAMES]) + more, remarks)
    _write_page(data, [images], file, max_bytes)


def _data_of_every_page(title: str, remarks: Sequence[str]) -> dict[str, Any]:
    return {
        "title": title,
        "devices": [],  # a page without results
        "remarks": list(remarks),
        "maps": {name: _colours(name) for name in COLOUR_MAPS.values()},
        "map_of": COLOUR_MAPS,
    }


def _write_page(
    data: Mapping[str, Any], clips: Sequence[ShownClip], file: Path, max_bytes: int
) -> None:
    frame = _render(data, [], math.nan)
    texts, error = pack_clips(clips, max_bytes - len(frame.encode()) - FEW_BYTES)
    write_text(file, _render(data, texts, error))


def _select_methods(
    clips: Sequence[ShownClip], results: pd.DataFrame
) -> tuple[list[ShownClip], list[str]]:
    """The clips with their best MAX_METHODS methods at each budget, and who is left out."""
    scores = results[(results["metric"] == "psnr") & results["value"].notna()]
    means = scores.groupby(["target_spp", "method"])["value"].mean()
    kept, left_out = [], set()
    for clip in clips:
        images = []
        for spp in sorted({each.target_spp for each in clip.images}):
            at_budget = [each for each in clip.images if each.target_spp == spp]
            at_budget.sort(
                key=lambda each: (-means.get((spp, each.method), -math.inf), each.method)
            )
            images += at_budget[:MAX_METHODS]
            left_out |= {each.method for each in at_budget[MAX_METHODS:]}
        kept.append(replace(clip, images=tuple(images)))
    if not left_out:
        return kept, []
    return kept, [
        f"images of {', '.join(sorted(left_out))} are not in the page, which shows the best "
        f"{MAX_METHODS} of each budget; choose others with --methods"
    ]


def _render(data: Mapping[str, Any], clips: Sequence[str], error: float) -> str:
    sources = {path.name: path.read_text(encoding="utf-8") for path in ASSETS.iterdir()}
    modules = {
        f"viewer/{name}": "data:text/javascript;base64,"
        + base64.b64encode(f"{text}\n//# sourceURL=viewer/{name}\n".encode()).decode()
        for name, text in sorted(sources.items())
        if name.endswith(".js")
    }
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(
        sources["page.html"]
    )
    return template.render(
        title=data["title"],
        style=sources["style.css"],
        imports=to_json({"imports": modules}),
        data=to_json({**data, "relative_error": error}),
        clips=[_in_script(text) for text in clips],
    )


def to_json(document: Any) -> str:
    """JSON that may stand in a script element; numbers that are not finite are null."""
    return _in_script(json.dumps(_finite(document), separators=(",", ":"), allow_nan=False))


def _in_script(text: str) -> str:
    """JSON without `<`, which ends a script element, or begins a comment in it."""
    return text.replace("<", "\\u003c")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _looks(results: pd.DataFrame) -> dict[str, dict[str, str]]:
    """Colour and dashes of each method, as in the figures; dashes as SVG writes them."""
    styles = line_styles(results["method"])
    return {
        name: {
            "colour": each.color,
            "dash": "" if each.dash == "-" else " ".join(f"{3 * x:g}" for x in each.dash[1]),
        }
        for name, each in styles.items()
    }


def _colours(name: str) -> str:
    """256 colours of a map, RGB, as base64."""
    colours = mpl.colormaps[name](np.arange(256) / 255.0)[:, :3]
    return base64.b64encode(np.rint(255 * colours).astype(np.uint8).tobytes()).decode()
