"""Contact sheet: one frame of each test scene, or of each scene of a preset, side by side.

    python -m rlbench.apps.render.jobs.contact_sheet docs/results/scenes.png --spp 1000 --size 512
    python -m rlbench.apps.render.jobs.contact_sheet docs/results/real-scenes.png \
        --preset real-640x360 --shrink 2

Traced frames are cached, so an interrupted sheet resumes with the next scene. Those of a preset are
the references of its clips.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.jobs.render_clips import render_preset_clips, scene_of_clip
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.scene import Scene
from rlbench.clips.presets import TEST_SCENES
from rlbench.clips.stored import open_clip
from rlbench.ops.color import REC709_LUMINANCE, encode_srgb, luminance
from rlbench.system import paths
from rlbench.system.progress import LoggedProgress

TIME = 4.0  # the frame shown
STREAM = "referenceA"
WHITE = 4.0  # luminance, in display whites, that the tone curve maps to 1
MIDDLE_GREY_GAIN = 1 / (1 - 0.18)  # keeps middle grey, 0.18, where it is
GAP = 4  # pixels between images


def trace_images(
    names: Sequence[str],
    size: int,
    spp: int,
    on_samples: Callable[[str, int], None] = lambda name, spp: None,
) -> list[UInt8[Array, "h w 3"]]:
    """One frame of each scene, `size` x `size` pixels.

    `on_samples` receives the scene's name and the samples per pixel of each launch. Raises
    LookupError for an unknown scene.
    """
    scenes = [scene_of_clip(name) for name in names]
    return [
        tone_map(_cached_frame(scene, size, spp, on_samples), scene.exposure) for scene in scenes
    ]


def read_references(folders: Iterable[Path], shrink: int = 1) -> list[UInt8[Array, "h w 3"]]:
    """The first reference of one clip of each scene; `shrink` pixels in a row become one."""
    clips = [open_clip(folder) for folder in folders]
    firsts = {clip.scene: clip.frame(0) for clip in reversed(clips)}  # of several, the first stays
    scenes = dict.fromkeys(clip.scene for clip in clips)
    means = [F.avg_pool2d(firsts[scene].reference.mean, shrink) for scene in scenes]
    return [tone_map(mean[0].movedim(0, -1).numpy(), 1.0) for mean in means]


def write_sheet(images: Sequence[UInt8[Array, "h w 3"]], out: Path, columns: int = 2) -> Path:
    """Write images of one size as a PNG, `columns` in a row."""
    from PIL import Image

    with paths.atomic_write(out) as temporary:
        page = tile_images(images, columns)
        Image.fromarray(page).save(temporary, format="png", optimize=True)
    return out


def tone_map(radiance: Float[Array, "h w 3"], exposure: float) -> UInt8[Array, "h w 3"]:
    """Linear radiance as an 8-bit image for people: exposed, tone-mapped, sRGB.

    The tone curve L (1 + L / white^2) / (1 + L) on luminance is equation 4 of Reinhard et al. 2002,
    Photographic Tone Reproduction for Digital Images; colours keep their ratios until they clip.
    Differs from the paper: L is the exposed luminance times 1 / (1 - 0.18), so that middle grey
    stays about where the scene's exposure puts it. Non-finite radiance becomes black.
    """
    finite = np.nan_to_num(radiance.astype(np.float64), posinf=0.0, neginf=0.0)
    linear = torch.from_numpy(MIDDLE_GREY_GAIN * exposure * finite).clamp_min(0).movedim(-1, 0)
    light = luminance(linear, REC709_LUMINANCE)
    mapped = linear * (1 + light / (MIDDLE_GREY_GAIN * WHITE) ** 2) / (1 + light)
    display = encode_srgb(mapped.clamp(0, 1)).movedim(0, -1).numpy()
    return np.asarray(np.round(255 * display), np.uint8)


def tile_images(images: Sequence[UInt8[Array, "h w 3"]], columns: int = 2) -> UInt8[Array, "H W 3"]:
    """Images of one size, `columns` in a row, on white."""
    height, width = images[0].shape[:2]
    columns = min(columns, len(images))
    rows = math.ceil(len(images) / columns)
    shape = (rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3)
    page = np.full(shape, 255, np.uint8)
    for number, image in enumerate(images):
        row, column = divmod(number, columns)
        top, left = row * (height + GAP), column * (width + GAP)
        page[top : top + height, left : left + width] = image
    return page


def cut_tile(page: UInt8[Array, "H W 3"], number: int, count: int) -> UInt8[Array, "h w 3"]:
    """Image `number`, from 0, of the `count` images that `tile_images` put on a page by twos."""
    rows, columns = math.ceil(count / 2), min(2, count)
    height = (page.shape[0] + GAP) // rows - GAP
    width = (page.shape[1] + GAP) // columns - GAP
    top, left = number // 2 * (height + GAP), number % 2 * (width + GAP)
    return page[top : top + height, left : left + width]


def _cached_frame(
    scene: Scene, size: int, spp: int, on_samples: Callable[[str, int], None]
) -> Float[Array, "h w 3"]:
    """The frame at TIME, from the cache or traced and stored there."""
    name = f"{scene.name}-{fingerprint(scene, int(TIME) + 1)}-{size}-{spp}.npy"
    file = paths.cache_folder() / "contact" / name
    if file.exists():
        on_samples(scene.name, spp)
        cached: Float[Array, "h w 3"] = np.load(file, allow_pickle=False)
        return cached
    tracer = open_tracer(scene, size, size)
    tracer.set_time(TIME)
    image = tracer.trace_mean(spp, STREAM, on_samples=lambda count: on_samples(scene.name, count))
    with paths.atomic_write(file) as temporary, temporary.open("wb") as stream:
        np.save(stream, image)
    return image


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the sheet from the command line."""
    parser = argparse.ArgumentParser(description="One frame of each scene in one PNG.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--preset", help="show references of its clips, five in a row")
    parser.add_argument("--shrink", type=int, default=1, help="show means of so many pixels a side")
    parser.add_argument("--scenes", default=",".join(TEST_SCENES), help="names a,b")
    parser.add_argument("--size", type=int, default=512, help="width and height of each image")
    parser.add_argument("--spp", type=int, default=1000)
    options = parser.parse_args(arguments)
    if options.preset:
        folders = render_preset_clips(None, options.preset)
        write_sheet(read_references(folders, options.shrink), options.out, 5)
        return
    names = options.scenes.split(",")
    columns = (
        TextColumn("{task.description:>10}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
    )
    with LoggedProgress(*columns, TimeRemainingColumn()) as bar:
        task = bar.add_task("", total=len(names) * options.spp)

        def on_samples(name: str, spp: int) -> None:
            bar.update(task, advance=spp, description=name)

        write_sheet(trace_images(names, options.size, options.spp, on_samples), options.out)


if __name__ == "__main__":
    main()
