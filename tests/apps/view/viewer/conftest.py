"""A real page of a real run on procedural clips, and a browser that opens it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rlbench.apps.view.commands.view import describe_traits
from rlbench.apps.view.viewer import write
from rlbench.benchmark.results import read
from rlbench.benchmark.shown_clips import ShownClip
from rlbench.cli.selection import find_images
from tests.apps.view.viewer.screen import Screen, find_chromium, launch_chromium
from tests.reports.formula_results import doubt
from tests.reports.kept_run import FRAMES, SIDE, run_with_images

__all__ = ["CUT", "FRAMES", "METHODS", "SIDE"]

CUT = 2
METHODS = ("svgf", "eaw", "mean")
CHROMIUM = find_chromium()


class Report(NamedTuple):
    """A page, and what it was made from."""

    file: Path
    rows: Any
    clips: list[ShownClip]


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory) -> Path:
    """A folder with `clips` and, with images, `results` of three methods on two clips."""
    folder = tmp_path_factory.mktemp("viewer")
    run_with_images(folder, METHODS, [1, 2], CUT)
    return folder


@pytest.fixture(scope="session")
def report(run_folder) -> Report:
    """The page of the run; the times of eaw are uncertain."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RLBENCH_CACHE", str(run_folder / "cache"))
        rows = read(run_folder / "results")
        rows.loc[rows["unit"] == "ms", "note"] = ""
        rows = rows[~rows["metric"].str.contains("_(?:low|high)_ms$")]
        rows = doubt(rows, "eaw", low=0.5, high=1.5)
        reads = (rows["metric"] == "gbuffer_ms") & (rows["method"] != "mean")
        rows.loc[reads, "value"] = 0.7
        clips = list(find_images(run_folder / "results", rows, [run_folder / "clips"])[0])
    file = run_folder / "report.html"
    write(rows, file, clips, {name: describe_traits(name) for name in METHODS})
    return Report(file, rows, clips)


@pytest.fixture(scope="session")
def playwright() -> Iterator[Any]:
    """What starts browsers."""
    if not CHROMIUM:
        reason = "no chromium is installed: apt-get install chromium"
        (pytest.fail if os.environ.get("RLBENCH_REQUIRE_BROWSER") else pytest.skip)(reason)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="session")
def browser(playwright) -> Iterator[Any]:
    """Headless Chromium with a WebGL2 that needs no graphics card."""
    with launch_chromium(playwright, CHROMIUM) as chromium:
        yield chromium


@pytest.fixture(scope="session")
def plain_browser(playwright) -> Iterator[Any]:
    """Headless Chromium without WebGL."""
    with launch_chromium(playwright, CHROMIUM, has_webgl=False) as chromium:
        yield chromium


@pytest.fixture
def open_page(browser, report) -> Iterator[Any]:
    """Opens the page at a hash. After the test: no error was logged, and nothing was fetched."""
    yield from _opener(browser, report.file)


@pytest.fixture(params=["browser", "plain_browser"])
def open_anywhere(request, report) -> Iterator[Any]:
    """As `open_page`, in a browser with WebGL2 and in one without."""
    yield from _opener(request.getfixturevalue(request.param), report.file)


def _opener(browser: Any, page: Path) -> Iterator[Any]:
    screens: list[Screen] = []

    def open_at(
        place: str = "", width: int = 1280, scheme: str = "light", file: Path = page
    ) -> Screen:
        screens.append(Screen.open(browser, file, place, width, scheme))
        return screens[-1]

    yield open_at
    for screen in screens:
        screen.page.context.close()
        assert screen.problems == []
        assert {url.partition(":")[0] for url in screen.requests} <= {"file", "data", "blob"}
