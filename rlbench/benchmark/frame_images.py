"""Images of one frame: each method's image as PNG and EXR, and a sheet of all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.image_sheet import LinearImage, MethodImage, draw_sheet
from rlbench.benchmark.resolve import ResolvedCell, resolve_cells
from rlbench.benchmark.run_plan import RunPlan
from rlbench.clips.exr import write_exr
from rlbench.clips.header import Header
from rlbench.errors import RlbenchError
from rlbench.parallel.executor import LOCAL, ProgressCallback
from rlbench.run import FrameResult, run_clip
from rlbench.system import paths

__all__ = ["ImagesError", "Sheet", "frame_at", "method_image", "write_images"]


class ImagesError(RlbenchError, ValueError):
    """A frame of which there are no images."""


class Sheet(NamedTuple):
    """The image of all methods on one frame, and the methods it lacks."""

    file: Path  # written if there is an image
    drawn: tuple[str, ...]  # names of the rows with an image
    missing: dict[str, str]  # method -> reason
    failed: frozenset[str]  # those of `missing` that an error stopped
    nonfinite: dict[str, int]  # pixels that are not finite, of the rows that have some


def write_images(
    plan: RunPlan,
    frame: int,
    out: Path,
    on_cell: Callable[[ResolvedCell], None] = lambda cell: None,
) -> Iterator[Sheet]:
    """Write images of one frame, -1 for a clip's last, into OUT/CLIP-SPPspp-FRAME; yields sheets.

    The first seed of `plan` is used. Earlier frames are run too, so that methods have a history.
    Raises ImagesError if a clip has no such frame.
    """
    loader = CellLoader(plan)
    for clip, spp in product(plan.clips, plan.target_spp):
        part = replace(plan, clips=(clip,), target_spp=(spp,), seeds=plan.seeds[:1])
        index = _frame_index(clip.header, frame)
        yield _write_sheet(loader, resolve_cells(part), index, out, on_cell)


def frame_at(results: Iterable[FrameResult], index: int) -> FrameResult:
    """The result of frame `index`; later frames are not run."""
    return next(result for result in results if result.frame.index == index)


def method_image(row_name: str, result: FrameResult) -> MethodImage:
    """The image of a frame with its PSNR and sample counts."""
    reference = result.frame.reference
    psnr = registry.load_or_explain("metrics", "psnr")
    score = psnr.score(psnr.compare(result.image, reference.half_a, reference.half_b))
    counts = result.samples.counts[0, 0].cpu().numpy()
    return MethodImage(row_name, _linear_image(result.image), counts, float(score[0]))


def _frame_index(header: Header, frame: int) -> int:
    index = frame if frame >= 0 else header.frames + frame
    if not 0 <= index < header.frames:
        raise ImagesError(
            f"--frame {frame}: clip '{header.name}' has frames 0 to {header.frames - 1}, and -1 is "
            "its last"
        )
    return index


def _write_sheet(
    loader: CellLoader,
    cells: list[ResolvedCell],
    index: int,
    out: Path,
    on_cell: Callable[[ResolvedCell], None],
) -> Sheet:
    """Run all methods on one clip at one budget, and write their images and the sheet."""
    images: list[MethodImage] = []
    missing: dict[str, str] = {}
    failed: set[str] = set()
    for outcome in LOCAL.map(partial(_run_to, loader, index), cells):
        name, error = outcome.job.method.name, outcome.error
        if isinstance(error, ImagesError):
            missing[name] = str(error)
        elif error:  # whatever a method may raise is reported beside the sheet
            missing[name] = registry.failure_reason(name, error)
            failed.add(name)
        else:
            image, reference = outcome.result()
            images.append(image)
        on_cell(outcome.job)
    clip, spp = cells[0].header.name, cells[0].target_spp
    folder = out / f"{clip.replace('/', '-')}-{spp:g}spp-{index:02}"
    if folder.is_symlink():
        raise ImagesError(
            f"{folder} is a link, to {folder.resolve()}, and no image is written through one; "
            "remove it, or choose another --out"
        )
    drawn = tuple(image.row_name for image in images)
    nonfinite = {each.row_name: n for each in images if (n := each.image.nonfinite_pixels)}
    sheet = Sheet(out / f"{folder.name}.png", drawn, missing, frozenset(failed), nonfinite)
    if not images:
        return sheet
    _save(folder / "reference", reference)
    for image in images:
        _save(folder / image.row_name.replace("/", "-"), image.image)
    title = f"{clip}, frame {index}, {spp:g} spp"
    draw_sheet(images, reference, title, sheet.file)
    return sheet


def _run_to(
    loader: CellLoader, index: int, cell: ResolvedCell, on_progress: ProgressCallback
) -> tuple[MethodImage, LinearImage]:
    """A method's image of frame `index`, and the reference.

    Raises ImagesError where the method cannot run on the clip, and whatever it raises itself.
    """
    if reason := loader.incompatibility(cell):
        raise ImagesError(reason)
    results = run_clip(loader.method(cell), loader.clip(cell), cell.target_spp)
    result = frame_at(results, index)
    reference = _linear_image(result.frame.reference.mean)
    return method_image(cell.method.row_name, result), reference


def _linear_image(image: Tensor) -> LinearImage:
    return LinearImage(np.asarray(image[0].movedim(0, -1).float().cpu().numpy()))


def _save(stem: Path, image: LinearImage) -> None:
    """Write STEM.exr with linear radiance and STEM.png with clipped sRGB."""
    from PIL import Image

    planes = np.moveaxis(image.radiance.astype(np.float32), -1, 0)
    write_exr(stem.parent / f"{stem.name}.exr", dict(zip("RGB", planes, strict=True)))
    with paths.atomic_write(stem.parent / f"{stem.name}.png") as temporary:
        Image.fromarray(image.rgb8).save(temporary, format="png")
