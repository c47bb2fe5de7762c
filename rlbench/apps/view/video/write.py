"""Writes the video of one clip as MP4 (H.264) or animated WebP."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from rlbench.apps.view.video.pictures import Panel, Rgb8, panels_of, pictures
from rlbench.apps.view.video.style import VideoStyle, check_formats
from rlbench.system.paths import atomic_write

if TYPE_CHECKING:
    from rlbench.benchmark.shown_clips import ShownClip

CRF = 18  # constant rate factor of x264: differences are hard to see

# BT.709 matrix, and the transfer curve of the pictures, in what players read
COLOURS = "colorspace=bt709:color_primaries=bt709:color_trc=iec61966-2-1:range=tv"
WEBP_METHOD = 5  # 6 takes nine times as long for files that are 1 % smaller
MAX_KEY_DISTANCE = 1000  # pictures; a WebP plays from its start


def write(
    clip: ShownClip,
    folder: Path,
    formats: Sequence[str],
    style: VideoStyle,
    on_picture: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write FOLDER/CLIP-SPPspp-ROWS.mp4 and .webp, or those of `formats`, and return them.

    `clip` is that of `at_budget`; `on_picture` is called for each picture. Raises VideoError if the
    clip cannot be shown so.
    """
    check_formats(formats)
    frames, _, height, width = clip.images[0].frames.shape
    has_reference = len(clip.reference) > 0
    style.check(len(clip.images), has_reference, height, width)
    panels, fps = panels_of(clip, style), style.fps * style.steps
    names = [row.method for row in clip.images] + ["reference"] * has_reference
    spp = f"{clip.images[0].target_spp:g}spp"
    words = [clip.name, spp, *names, *["wipe"] * (style.layout == "wipe")]
    files = []
    for suffix in formats:
        files.append(folder / f"{'-'.join(words).replace('/', '-')}.{suffix}")
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


def write_mp4(pictures: Iterator[Rgb8], file: Path, fps: float) -> None:
    """Write a video that every browser plays: H.264, yuv420p, BT.709. Sizes must be even."""
    import imageio_ffmpeg

    first = next(pictures)
    matrix = "scale=out_color_matrix=bt709:out_range=tv"
    options = ["-vf", f"{matrix},setparams={COLOURS}", "-crf", str(CRF), "-preset", "slow"]
    with atomic_write(file) as temporary:
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            first.shape[1::-1],
            fps=fps,
            quality=None,
            codec="libx264",
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=[*options, "-movflags", "+faststart", "-bitexact"],
        )
        writer.send(None)
        for picture in chain([first], pictures):
            writer.send(np.ascontiguousarray(picture))
        writer.close()


def write_webp(pictures: Iterator[Rgb8], file: Path, fps: float, quality: int) -> None:
    """Write an animation that repeats for ever; equal pictures give equal bytes."""
    first, *others = map(Image.fromarray, pictures)
    with atomic_write(file) as temporary:
        first.save(
            temporary,
            save_all=True,
            append_images=others,
            duration=1000 / fps,  # the encoder rounds times, not durations
            loop=0,
            quality=quality,
            method=WEBP_METHOD,
            kmin=MAX_KEY_DISTANCE - 1,
            kmax=MAX_KEY_DISTANCE,
        )
