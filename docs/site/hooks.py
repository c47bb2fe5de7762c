"""Build steps of the site: pages of the results, links to source files, the commands' reference.

Pages of the results exist only while the site is built. Their numbers are those of the shipped
baseline, or of the results folders in RLBENCH_SITE_RESULTS (separated by colons): `make site
SITE_RESULTS=results`. Leaderboards link to report.html of a folder, as `rlbench view` writes it.

Pages are also read in the repository, where a link to a source file is a relative path. On the site
such a link leads to the repository; a link to a file that does not exist fails the build.
"""

from __future__ import annotations

import io
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import typer.main
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from PIL import Image

sys.path.append(str(Path(__file__).parents[2]))  # mkdocs restores the path after this module

from docs.site.boards import Board, Key, make_boards
from docs.site.results_pages import make_pages
from docs.site.scene_facts import scene_facts
from rlbench.apps.render.jobs.contact_sheet import cut_tile
from rlbench.benchmark.listing import method_facts
from rlbench.benchmark.regression import baseline
from rlbench.benchmark.results import read
from rlbench.cli.app import app
from rlbench.clips.presets import TEST_SCENES
from rlbench.errors import RlbenchError

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"\]\((?!https?:|mailto:|#|/)([^)#\s]+)(#[^)\s]*)?\)")
CLI = "<!-- commands -->"
RESULTS = "RLBENCH_SITE_RESULTS"
CONTACT_SHEET = ROOT / "docs" / "results" / "scenes.png"
IMAGES = {  # pictures of the documentation, and the methods that they show, see Makefile: docs
    "results/images.png": ("ours", "oidn-intel", "imcd", "ntas", "svgf", "mean"),
}
REPORT = "leaderboard/report.html"
BASELINE_SOURCE = (
    "The numbers are those of the baseline that ships, which `make baseline` measures; it has PSNR "
    "alone, of 8 frames of 192x192 pixels."
)
FOLDER_SOURCE = "The numbers are those of a results folder, given to make site."


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the results, and name them before the last part of the navigation."""
    folders = [Path(name) for name in os.environ.get(RESULTS, "").split(":") if name]
    try:
        boards = _boards_of_folders(folders) if folders else _boards_of_baselines()
    except RlbenchError as error:
        raise PluginError(f"{RESULTS}: {error}") from error
    pictures = _cut_pictures()
    reports = [folder / "report.html" for folder in folders if (folder / "report.html").is_file()]
    pages, navigation = make_pages(
        boards, method_facts(), scene_facts(), list(pictures), IMAGES, REPORT if reports else ""
    )
    contents: dict[str, str | bytes] = {**pages, **pictures}
    if reports:
        contents[REPORT] = reports[0].read_bytes()
    for path, content in contents.items():
        files.append(File.generated(config, path, content=content))
    nav: list[Any] = config.nav or []
    config.nav = [*nav[:-1], *navigation, *nav[-1:]]
    return files


def _boards_of_folders(folders: list[Path]) -> list[Board]:
    return make_boards(pd.concat(map(read, folders), ignore_index=True), FOLDER_SOURCE)


def _boards_of_baselines() -> list[Board]:
    boards = []
    for name in baseline.shipped_baselines():
        shipped = baseline.load_baseline(baseline.find_baseline(name))
        errors: dict[Key, float] = {
            e.key: e.stderr_db for e in shipped.entries if e.stderr_db is not None
        }
        boards += make_boards(baseline.to_table(shipped), BASELINE_SOURCE, errors)
    return boards


def _cut_pictures() -> dict[str, bytes]:
    """The PNG of each test scene by path, cut from the contact sheet of `make contact`."""
    sheet = np.asarray(Image.open(CONTACT_SHEET).convert("RGB"))
    pictures = {}
    for index, name in enumerate(TEST_SCENES):
        stream = io.BytesIO()
        tile = cut_tile(sheet, index, len(TEST_SCENES))
        Image.fromarray(tile).save(stream, format="png", optimize=True)
        pictures[f"scenes/{name}.png"] = stream.getvalue()
    return pictures


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with links to source files made absolute, and with the commands filled in."""
    if CLI in markdown:
        markdown = markdown.replace(CLI, _commands())
    folder = (ROOT / "docs" / page.file.src_uri).parent

    def absolute(match: re.Match[str]) -> str:
        path = (folder / match[1]).resolve()
        if path.is_relative_to(ROOT / "docs"):
            return match[0]
        if not path.exists():
            raise PluginError(f"{page.file.src_uri} links to {match[1]}, which does not exist")
        return f"]({config.repo_url}/blob/main/{path.relative_to(ROOT)}{match[2] or ''})"

    return LINK.sub(absolute, markdown)


def _commands() -> str:
    """The help of every command, in the order of `rlbench --help`."""
    group: Any = typer.main.get_command(app)
    context = group.make_context("rlbench", [], resilient_parsing=True)
    context.max_content_width = 100
    pages = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        with command.make_context(name, [], parent=context, resilient_parsing=True) as inner:
            inner.max_content_width = 100
            pages.append(f"## rlbench {name}\n\n```text\n{command.full_help(inner)}\n```\n")
    return "\n".join(pages)
