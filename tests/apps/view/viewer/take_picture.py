"""A picture of a page of `rlbench view`, for the documentation.

Command: python -m tests.apps.view.viewer.take_picture REPORT.html PICTURE.png [HASH OF ITS ADDRESS]
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.apps.view.viewer.screen import Screen, find_chromium, launch_chromium

WIDTH = 1280  # pixels


def take_picture(report: Path, picture: Path, place: str = "") -> None:
    """Write a PNG of what the page shows at the hash `place` of its address."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started, launch_chromium(started, find_chromium()) as chromium:
        screen = Screen.open(chromium, report.resolve(), place, WIDTH, "light")
        screen.page.screenshot(path=str(picture))


if __name__ == "__main__":
    take_picture(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
