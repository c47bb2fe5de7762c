"""Contact sheet: one frame of each test scene in one picture, for people.

    python -m rlbench.render.jobs.contact_sheet docs/scenes.png --spp 1000 --size 512

What is traced is kept in the cache per scene, so that a killed sheet goes on with the next scene.
"""

from __future__ import annotations

import argparse
import gc
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rlbench.render.fingerprint import fingerprint
from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.presets import FOUR
from rlbench.render.scene import Scene
from rlbench.system import paths

TIME = 4.0  # the frame that is shown
STREAM = "referenceA"
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB: Rec. 709
WHITE = 4.0  # luminance, in display whites, that the tone curve maps to 1
KEEP = 1 / (1 - 0.18)  # leaves middle grey, 0.18, where it is
GAP = 4  # pixels between pictures


def sheet(
    names: Sequence[str],
    size: int,
    spp: int,
    out: Path,
    traced: Callable[[str, int], None] = lambda name, spp: None,
) -> Path:
    """Write a PNG with one frame of each scene, `size` x `size` pixels each, two in a row.

    `traced` is told of samples per pixel as they are done, with the scene's name. Raises
    LookupError for an unknown scene.
    """
    from PIL import Image

    scenes = [scene_of_clip(name) for name in names]
    pictures = [shown(_traced(scene, size, spp, traced), scene.exposure) for scene in scenes]
    with paths.replacing(out) as temporary:
        Image.fromarray(tiled(pictures)).save(temporary, format="png", optimize=True)
    return out


def shown(radiance: Float[Array, "h w 3"], exposure: float) -> UInt8[Array, "h w 3"]:
    """Linear radiance as a person should see it: exposed, tone-mapped, sRGB, 8 bits.

    The tone curve L (1 + L / white^2) / (1 + L) on luminance is equation 4 of Reinhard et al. 2002,
    Photographic Tone Reproduction for Digital Images; colours keep their ratios until they clip.
    Differs from the paper: L is the exposed luminance times 1 / (1 - 0.18), so that middle grey
    stays about where the scene's exposure has put it. What is not finite is black.
    """
    linear = KEEP * exposure * np.nan_to_num(radiance.astype(np.float64), posinf=0.0, neginf=0.0)
    luminance = (linear.clip(0) @ np.array(LUMINANCE))[..., None]
    mapped = linear.clip(0) * (1 + luminance / (KEEP * WHITE) ** 2) / (1 + luminance)
    light = mapped.clip(0, 1)
    curve = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light.clip(1e-8) ** (1 / 2.4) - 0.055
    )  # IEC 61966-2-1
    return np.asarray(np.round(255 * curve), np.uint8)


def tiled(pictures: Sequence[UInt8[Array, "h w 3"]]) -> UInt8[Array, "H W 3"]:
    """Pictures of one size, two in a row, on white."""
    height, width = pictures[0].shape[:2]
    rows = math.ceil(len(pictures) / 2)
    columns = min(2, len(pictures))
    area = (rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3)
    page = np.full(area, 255, np.uint8)
    for number, picture in enumerate(pictures):
        top, left = number // 2 * (height + GAP), number % 2 * (width + GAP)
        page[top : top + height, left : left + width] = picture
    return page


def _traced(
    scene: Scene, size: int, spp: int, traced: Callable[[str, int], None]
) -> Float[Array, "h w 3"]:
    """The frame at TIME: from the cache, or traced and put there."""
    known = f"{scene.name}-{fingerprint(scene, int(TIME) + 1)}-{size}-{spp}.npy"
    file = paths.cache() / "contact" / known
    if file.exists():
        traced(scene.name, spp)
        kept: Float[Array, "h w 3"] = np.load(file, allow_pickle=False)
        return kept
    tracer = open_tracer(scene, size, size)
    tracer.set_time(TIME)
    image = tracer.mean(spp, STREAM, traced=lambda count: traced(scene.name, count))
    with paths.replacing(file) as temporary, temporary.open("wb") as stream:
        np.save(stream, image)
    del tracer
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    return image


def main(words: Sequence[str] | None = None) -> None:
    """The sheet from the command line."""
    parser = argparse.ArgumentParser(description="One frame of each scene in one PNG.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", default=",".join(FOUR), help="names a,b")
    parser.add_argument("--size", type=int, default=512, help="pixels of each side of a picture")
    parser.add_argument("--spp", type=int, default=1000)
    asked = parser.parse_args(words)
    names = asked.scenes.split(",")
    columns = (TextColumn("{task.description:>10}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=len(names) * asked.spp)

        def tell(name: str, spp: int) -> None:
            bar.update(task, advance=spp, description=name)

        sheet(names, asked.size, asked.spp, asked.out, tell)


if __name__ == "__main__":
    main()
