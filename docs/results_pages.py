"""Build step of the site: pages of the results, which exist only while the site is built.

The numbers are those of the shipped baseline, or of the results folders in RLBENCH_SITE_RESULTS
(separated by colons): `make site SITE_RESULTS=results`. A folder with report.html, as `rlbench
view` writes it, gives the leaderboard a link to it.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

from rlbench.apps.view.site import PresetScores, build_pages, preset_scores
from rlbench.errors import RlbenchError

RESULTS = "RLBENCH_SITE_RESULTS"
CONTACT_SHEET = Path(__file__).parent / "results" / "scenes.png"
IMAGES = {  # pictures of the documentation, and the methods that they show, see Makefile: docs
    "results/images.png": ("ours", "oidn-intel", "imcd", "ntas", "svgf", "mean"),
}
REPORT = "leaderboard/report.html"
BASELINE_SOURCE = (
    "The numbers are those of the baseline that ships, which `make baseline` measures; it has PSNR "
    "alone, of 8 frames of 192x192 pixels."
)

_pages: dict[str, str | bytes] = {}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Make the pages, and add them to the navigation before the last part, the results."""
    from rlbench.apps.render.scene_facts import scene_facts
    from rlbench.benchmark.listing import method_facts

    folders = [Path(name) for name in os.environ.get(RESULTS, "").split(":") if name]
    try:
        scores = _scores(folders)
    except RlbenchError as error:
        raise PluginError(f"{RESULTS}: {error}") from error
    pictures = _pictures()
    report = next((f / "report.html" for f in folders if (f / "report.html").is_file()), None)
    pages, navigation = build_pages(
        scores,
        method_facts(),
        scene_facts(),
        {name: path for name, (path, _) in pictures.items()},
        IMAGES,
        REPORT if report else "",
    )
    _pages.clear()
    _pages.update(pages)
    _pages.update({path: content for path, content in pictures.values()})
    if report:
        _pages[REPORT] = report.read_bytes()
    nav: list[Any] = config.nav or []
    config.nav = [*nav[:-1], *navigation, *nav[-1:]]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages to the files of the site."""
    for path, content in _pages.items():
        files.append(File.generated(config, path, content=content))
    return files


def _scores(folders: list[Path]) -> list[PresetScores]:
    from rlbench.benchmark.regression.baseline import (
        find_baseline,
        load_baseline,
        shipped_baselines,
        to_table,
    )
    from rlbench.benchmark.results import read

    parts = []
    for folder in folders:
        parts += preset_scores(
            read(folder), "The numbers are those of a results folder, given to make site."
        )
    for name in shipped_baselines() if not folders else []:
        baseline = load_baseline(find_baseline(name))
        errors = {e.key: e.stderr_db for e in baseline.entries if e.stderr_db is not None}
        parts += preset_scores(to_table(baseline), BASELINE_SOURCE, errors)
    return sorted(parts, key=lambda each: (each.preset, each.scores.device))


def _pictures() -> dict[str, tuple[str, bytes]]:
    """Path and PNG of each test scene, cut from the contact sheet of `make contact`."""
    import numpy as np
    from PIL import Image

    from rlbench.apps.render.jobs.contact_sheet import cut_tile
    from rlbench.clips.presets import TEST_SCENES

    sheet = np.asarray(Image.open(CONTACT_SHEET).convert("RGB"))
    pictures = {}
    for index, name in enumerate(TEST_SCENES):
        stream = io.BytesIO()
        tile = cut_tile(sheet, index, len(TEST_SCENES))
        Image.fromarray(tile).save(stream, format="png", optimize=True)
        pictures[name] = f"scenes/{name}.png", stream.getvalue()
    return pictures
