"""Writes pictures as MP4 (H.264) or animated WebP."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image

from reports.layout.finished_file import finished_file
from reports.video.panels import Rgb8

__all__ = ["write_mp4", "write_webp"]

CRF = 18  # constant rate factor of x264: differences are hard to see
# BT.709 matrix, and the transfer curve of the pictures, in what players read
COLOURS = "colorspace=bt709:color_primaries=bt709:color_trc=iec61966-2-1:range=tv"
WEBP_METHOD = 5  # 6 takes nine times as long for files that are 1 % smaller
MAX_KEY_DISTANCE = 1000  # pictures; a WebP plays from its start


def write_mp4(pictures: Iterator[Rgb8], file: Path, fps: float) -> None:
    """Write a video that every browser plays: H.264, yuv420p, BT.709. Sizes must be even."""
    import imageio_ffmpeg

    first = next(pictures)
    matrix = "scale=out_color_matrix=bt709:out_range=tv"
    options = ["-vf", f"{matrix},setparams={COLOURS}", "-crf", str(CRF), "-preset", "slow"]
    with finished_file(file) as temporary:
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
    with finished_file(file) as temporary:
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
