"""How a video looks, and whether clips can be shown so."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection
from dataclasses import dataclass

from rlbench.benchmark.results import TableError

LAYOUTS = ("side-by-side", "wipe")
FORMATS = ("mp4", "webp")
MAX_PANELS = 6
MIN_SECONDS = 4.0  # that an MP4 lasts by default, and that a divider needs to go and come back
DIVIDER_STEPS = 3  # positions of the divider while one frame is shown


class VideoError(TableError):
    """A video that cannot be made: unknown format or layout, too many panels, crop outside."""


@dataclass(frozen=True)
class VideoStyle:
    """How a video looks. Positions and sizes are in pixels of the clip.

    >>> VideoStyle(ping_pong=True).frame_order(4)
    [0, 1, 2, 3, 2, 1]
    """

    layout: str = "side-by-side"
    zoom: int = 1  # whole factor; each pixel becomes a square
    fps: float = 8.0  # frames of the clip in a second
    ping_pong: bool = False  # forwards, then backwards
    repeat: int | None = None  # times an MP4 shows the loop; None: until MIN_SECONDS have passed
    crop: tuple[int, int, int, int] | None = None  # x, y, width, height; None: the whole frame
    line: int | None = None  # y of the slice through time below each image; None: no slice
    samples: bool = False  # with a panel for the samples of each row that is adaptive
    labels: bool = True
    titles: tuple[str, ...] = ()  # instead of the names of the rows, in their order
    columns: int | None = None  # panels in a line; None: all
    quality: int = 90  # of WebP, 0 to 100

    def check(self, rows: int, has_reference: bool, height: int, width: int) -> None:
        """Raises VideoError where `rows` rows of images of this size cannot be shown so."""
        if self.layout not in LAYOUTS:
            raise VideoError(f"--layout {self.layout}: no such layout; use {' or '.join(LAYOUTS)}")
        if self.titles and len(self.titles) != rows:
            raise VideoError(f"--titles has {len(self.titles)} titles for {rows} rows")
        panels = rows + has_reference
        if self.layout == "wipe" and (panels != 2 or self.samples):
            raise VideoError(
                f"a wipe shows two images, and {panels} are selected"
                f"{' with samples' * self.samples}: give two rows, or one and --reference, "
                "and no --samples"
            )
        if panels > MAX_PANELS:
            raise VideoError(
                f"{panels} images are selected, and a video shows at most {MAX_PANELS}; choose "
                "rows with --methods"
            )
        self._check_part(height, width)

    def _check_part(self, height: int, width: int) -> None:
        x, y, w, h = self.crop or (0, 0, width, height)
        if w < 1 or h < 1 or x + w > width or y + h > height:
            raise VideoError(
                f"--crop {x},{y},{w},{h} is not a part of frames of {width} x {height} pixels"
            )
        if self.line is not None and not y <= self.line < y + h:
            raise VideoError(f"--slice {self.line}: lines {y} to {y + h - 1} are shown")

    def frame_order(self, frames: int) -> list[int]:
        """The frames of a clip in the order of one pass, which a loop repeats."""
        forwards = list(range(frames))
        return forwards + forwards[-2:0:-1] if self.ping_pong else forwards

    def passes(self, frames: int) -> int:
        """Passes through the clip in one loop: a divider needs some time to go and come back."""
        seconds = len(self.frame_order(frames)) / self.fps
        return max(1, round(MIN_SECONDS / seconds)) if self.layout == "wipe" else 1

    def pictures(self, frames: int) -> int:
        """Pictures of one loop."""
        return self.passes(frames) * len(self.frame_order(frames)) * self.steps

    @property
    def steps(self) -> int:
        """Pictures for each frame of the clip."""
        return DIVIDER_STEPS if self.layout == "wipe" else 1

    def pictures_written(self, frames: int, formats: Collection[str]) -> int:
        """Pictures in the files of these formats together."""
        return sum(
            self.pictures(frames) * (self.loops(frames) if name == "mp4" else 1) for name in formats
        )

    def loops(self, frames: int) -> int:
        """Times that an MP4 shows the loop; an animated WebP repeats it by itself."""
        seconds = self.pictures(frames) / self.steps / self.fps
        return self.repeat or max(1, -int(-MIN_SECONDS // seconds))


def check_formats(formats: Collection[str]) -> None:
    """Raises VideoError for a format that is unknown, or that a missing package writes."""
    if unknown := [name for name in formats if name not in FORMATS]:
        raise VideoError(f"--format {','.join(unknown)}: no such format; use {', '.join(FORMATS)}")
    if "mp4" in formats and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise VideoError(
            "MP4 needs imageio-ffmpeg, which brings ffmpeg: pip install 'rlbench[video]', or use "
            "--format webp"
        )
