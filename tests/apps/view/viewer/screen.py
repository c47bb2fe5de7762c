"""A page in a browser: keys, gestures, and the pixels that it shows."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

SETTLED = """async () => {
  const frame = () => new Promise((done) => requestAnimationFrame(done));
  const stage = () => document.querySelector(".stage");
  for (let quiet = 0; quiet < 3; await frame()) {
    quiet = stage()?.getAttribute("aria-busy") === "true" ? 0 : quiet + 1;
  }
}"""
STATE = "async () => ({ ...(await import('viewer/state.js')).state })"
PLACES = """() => [...document.querySelectorAll(".pane")].map((pane) => {
  const { x, y, width, height } = pane.getBoundingClientRect();
  return { x, y, width, height, label: pane.dataset.pane };
})"""


def find_chromium() -> str:
    """The path of an installed Chromium; empty without one."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next(filter(None, map(shutil.which, names)), "")


@contextmanager
def launch_chromium(playwright: Any, path: str, has_webgl: bool = True) -> Iterator[Any]:
    """Headless Chromium, with a WebGL2 that needs no graphics card, or without WebGL."""
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options = options if has_webgl else ["--disable-3d-apis"]
    options += ["--force-color-profile=srgb"]
    options += ["--no-sandbox"] if os.geteuid() == 0 else []
    chromium = playwright.chromium.launch(executable_path=path, args=options)
    yield chromium
    chromium.close()


@dataclass
class Screen:
    """One page, what it logged as errors, and what it fetched."""

    page: Any
    problems: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, browser: Any, file: Path, place: str, width: int, scheme: str) -> Screen:
        """Open a file at a hash and wait until it shows what it will show."""
        height = 900 if width > 600 else 844
        context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme
        )
        context.grant_permissions(["clipboard-read", "clipboard-write"])
        context.set_default_timeout(30_000)
        screen = cls(context.new_page())
        screen.page.on(
            "console",
            lambda message: (
                message.type in ("error", "warning")
                and "GPU stall due to ReadPixels" not in message.text  # said of screenshots
                and screen.problems.append(message.text)
            ),
        )
        screen.page.on("pageerror", lambda error: screen.problems.append(str(error)))
        screen.page.on("request", lambda request: screen.requests.append(request.url))
        screen.page.goto(f"{file.as_uri()}#{place}")
        screen.page.wait_for_selector("html[data-ready]")
        screen.settle()
        return screen

    @property
    def state(self) -> dict[str, Any]:
        """The state of the page."""
        return dict(self.page.evaluate(STATE))

    def settle(self) -> None:
        """Wait until all images that are shown are decoded and drawn."""
        self.page.evaluate(SETTLED)

    def press(self, *keys: str) -> None:
        """Press keys one after the other."""
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def panes(self) -> list[dict[str, Any]]:
        """Label and box of each pane."""
        return list(self.page.evaluate(PLACES))

    def place_of(self, x: int, y: int, side: int, pane: int = 0) -> tuple[float, float]:
        """Where the middle of an image pixel is on the screen; `side` is that of the image."""
        state, box = self.state, self.panes()[pane]
        zoom = state["zoom"] or min(box["width"], box["height"]) / side
        centre = [side / 2 if state[name] < 0 else state[name] for name in "xy"]
        left = box["x"] + box["width"] / 2 + (x + 0.5 - centre[0]) * zoom
        return left, box["y"] + box["height"] / 2 + (y + 0.5 - centre[1]) * zoom

    def pixel(self, x: int, y: int, side: int, pane: int = 0) -> np.ndarray:
        """The colour, RGB in [0, 1], that shows an image pixel."""
        left, top = self.place_of(x, y, side, pane)
        clip = {"x": int(left), "y": int(top), "width": 1, "height": 1}
        image = Image.open(io.BytesIO(self.page.screenshot(clip=clip)))
        return np.asarray(image.convert("RGB"), np.float64)[0, 0] / 255

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse with its first button."""
        self.page.mouse.move(*start)
        self.page.mouse.down()
        self.page.mouse.move(*end, steps=3)
        self.page.mouse.up()
        self.settle()

    def text(self, selector: str) -> str:
        """The text of an element in one line."""
        return " ".join(self.page.inner_text(selector).split())
