"""Writes the video of one clip in each format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import repeat
from pathlib import Path

from reports.video.encode import write_mp4, write_webp
from reports.video.layouts import pictures
from reports.video.panels import DisplayClip, Panel, Rgb8, panels_of
from reports.video.style import VideoStyle, check_formats

__all__ = ["write"]


def write(
    clip: DisplayClip,
    folder: Path,
    formats: Sequence[str],
    style: VideoStyle,
    on_picture: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write FOLDER/CLIP-SPPspp-ROWS.mp4 and .webp, or those of `formats`, and return them.

    `on_picture` is called for each picture. Raises VideoError if the clip cannot be shown so.
    """
    check_formats(formats)
    frames, height, width, _ = clip.rows[0].frames.shape
    style.check(len(clip.rows), clip.reference is not None, height, width)
    panels, fps = panels_of(clip, style), style.fps * style.steps
    files = []
    for suffix in formats:
        files.append(folder / f"{_stem(clip, style)}.{suffix}")
        if suffix == "mp4":
            write_mp4(_play(panels, style, style.loops(frames), on_picture), files[-1], fps)
        else:
            write_webp(_play(panels, style, 1, on_picture), files[-1], fps, style.quality)
    return files


def _play(
    panels: Sequence[Panel], style: VideoStyle, loops: int, on_picture: Callable[[], None]
) -> Iterator[Rgb8]:
    for _ in repeat(None, loops):
        for picture in pictures(panels, style):
            yield picture
            on_picture()


def _stem(clip: DisplayClip, style: VideoStyle) -> str:
    names = [row.name for row in clip.rows] + ["reference"] * (clip.reference is not None)
    words = [clip.name, f"{clip.target_spp:g}spp", *names, *["wipe"] * (style.layout == "wipe")]
    return "-".join(words).replace("/", "-")
