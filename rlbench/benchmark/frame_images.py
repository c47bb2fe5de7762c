"""Images of one frame: each method's image as PNG and EXR, and a sheet of all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.run_plan import Cell, CellLoader, RunPlan, list_cells
from rlbench.clips.exr import write_exr
from rlbench.clips.frame_files import is_no_reference
from rlbench.clips.header import Header
from rlbench.errors import RlbenchError
from rlbench.ops.color import encode_srgb
from rlbench.parallel.executor import LOCAL, ProgressCallback
from rlbench.run import FrameResult, run_clip
from rlbench.system import paths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

NONFINITE_COLOUR = (255, 0, 255)  # of NaN and infinite pixels, which a display would hide
MAX_ERROR = 0.25  # end of the error scale: mean over channels, in units of display white
DIFFERENCE_PERCENTILE = 98  # of the sizes of differences, at the ends of their scale
MOST_TICKS = 4  # intervals between numbers of a colour bar
PANEL_INCHES, TITLE_INCHES = 2.6, 0.25  # width of a panel, and height of the line above it
DPI = 150


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
    on_cell: Callable[[Cell], None] = lambda cell: None,
) -> Iterator[Sheet]:
    """Write images of one frame, -1 for a clip's last, into OUT/CLIP-SPPspp-FRAME; yields sheets.

    The first seed of `plan` is used. Earlier frames are run too, so that methods have a history.
    Raises ImagesError if a clip has no such frame.
    """
    loader = CellLoader(plan)
    for clip, spp in product(plan.clips, plan.spp):
        part = replace(plan, clips=(clip,), spp=(spp,), seeds=plan.seeds[:1])
        index = _frame_index(clip.header, frame)
        yield _write_sheet(loader, list_cells(part), index, out, on_cell)


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
    cells: list[Cell],
    index: int,
    out: Path,
    on_cell: Callable[[Cell], None],
) -> Sheet:
    """Run all methods on one clip at one budget, and write their images and the sheet."""
    images: list[MethodImage] = []
    missing: dict[str, str] = {}
    failed: set[str] = set()
    for outcome in LOCAL.map(partial(_run_to, loader, index), cells):
        name, error = outcome.job.method_name, outcome.error
        if isinstance(error, ImagesError):
            missing[name] = str(error)
        elif error:  # whatever a method may raise is reported beside the sheet
            missing[name] = registry.failure_reason(name, error)
            failed.add(name)
        else:
            image, reference = outcome.result()
            images.append(image)
        on_cell(outcome.job)
    clip, spp = cells[0].header.name, cells[0].spp
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
    loader: CellLoader, index: int, cell: Cell, on_progress: ProgressCallback
) -> tuple[MethodImage, LinearImage]:
    """A method's image of frame `index`, and the reference.

    Raises ImagesError where the method cannot run on the clip, and whatever it raises itself.
    """
    if reason := cell.incompatibility:
        raise ImagesError(reason)
    results = run_clip(loader.method(cell), loader.clip(cell), cell.spp)
    result = frame_at(results, index)
    reference = _linear_image(result.frame.reference.mean)
    return method_image(cell.key.method, result), reference


def _linear_image(image: Tensor) -> LinearImage:
    return LinearImage(np.asarray(image[0].movedim(0, -1).float().cpu().numpy()))


def save_png(pixels: UInt8[Array, "h w 3"], file: Path) -> None:
    """Write an image as PNG; the file appears whole or not at all."""
    from PIL import Image

    with paths.atomic_write(file) as temporary:
        Image.fromarray(np.ascontiguousarray(pixels)).save(temporary, format="png", optimize=True)


def _save(stem: Path, image: LinearImage) -> None:
    """Write STEM.exr with linear radiance and STEM.png with clipped sRGB."""
    planes = np.moveaxis(image.radiance.astype(np.float32), -1, 0)
    write_exr(stem.parent / f"{stem.name}.exr", dict(zip("RGB", planes, strict=True)))
    save_png(image.rgb8, stem.parent / f"{stem.name}.png")


@dataclass(frozen=True)
class LinearImage:
    """An image in linear radiance, with its display values computed once."""

    radiance: Float[Array, "h w 3"]  # linear, 1.0 is display white

    @cached_property
    def srgb(self) -> Float[Array, "h w 3"]:
        """Clipped sRGB in [0, 1], as PSNR sees it; NaN is black."""
        finite = np.nan_to_num(self.radiance, nan=0.0).clip(0, 1)
        return encode_srgb(torch.from_numpy(finite)).clamp(0, 1).numpy()

    @cached_property
    def rgb8(self) -> UInt8[Array, "h w 3"]:
        """Clipped sRGB in 8 bits; pixels that are not finite have NONFINITE_COLOUR."""
        rgb8 = np.rint(self.srgb * np.float32(255)).astype(np.uint8)
        rgb8[~np.isfinite(self.radiance).all(-1)] = NONFINITE_COLOUR
        return rgb8

    @property
    def is_absent(self) -> bool:
        """True if it stands for the reference of a frame that has none."""
        return is_no_reference(self.radiance)

    @property
    def nonfinite_pixels(self) -> int:
        """Number of pixels with a NaN or infinite channel."""
        return int((~np.isfinite(self.radiance).all(-1)).sum())


@dataclass(frozen=True)
class MethodImage:
    """One frame of a method: the image, its score, and the samples it took."""

    row_name: str  # of the method, as in the results
    image: LinearImage
    counts: Int[Array, "h w"]  # samples of each pixel
    psnr: float  # dB; nan for a frame without a reference


def draw_sheet(
    methods: Sequence[MethodImage], reference: LinearImage, title: str, file: Path
) -> Path:
    """Write a PNG with a column for each method, reference first; returns `file`.

    Its rows are images, errors, for several methods their squared error minus that of the best one,
    and, if any method is adaptive, samples of each pixel. Without a reference, the second row has
    the differences to the first method.
    """
    from matplotlib.figure import Figure

    is_adaptive = any(map(_is_adaptive, methods))
    is_compared = len(methods) > 1 and not reference.is_absent
    rows, columns = 2 + is_compared + is_adaptive, 1 + len(methods)
    h, w, _ = reference.radiance.shape
    width, height = PANEL_INCHES * columns, (PANEL_INCHES * h / w + TITLE_INCHES) * rows
    figure = Figure(figsize=(width, height + TITLE_INCHES))
    grid = figure.subplots(rows, columns, squeeze=False)
    top = 1 - 2 * TITLE_INCHES / (height + TITLE_INCHES)
    spacing = {"wspace": 0.02, "hspace": TITLE_INCHES * rows / height}
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=top, **spacing)
    for axes in grid.flat:
        axes.set_axis_off()
    _draw_images(grid[0], methods, reference)
    _draw_errors(grid[1], methods, reference)
    if is_compared:
        _draw_differences(grid[2], methods, reference)
    if is_adaptive:
        _draw_counts(grid[-1], methods)
    figure.suptitle(title, fontsize=9, y=1 - 0.25 * TITLE_INCHES / (height + TITLE_INCHES))
    with paths.atomic_write(file) as temporary:
        figure.savefig(temporary, dpi=DPI, format="png")
    return file


def _draw_images(
    row: Sequence[Axes], methods: Sequence[MethodImage], reference: LinearImage
) -> None:
    if reference.is_absent:
        _write(row[0], "no reference")
    else:
        _panel(row[0], reference.rgb8, "reference")
    for axes, method in zip(row[1:], methods, strict=True):
        nonfinite = method.image.nonfinite_pixels
        score = "" if reference.is_absent else f"  {method.psnr:.2f} dB"
        warning = f", {nonfinite} not finite" if nonfinite else ""
        _panel(axes, method.image.rgb8, f"{method.row_name}{score}{warning}")


def _draw_errors(
    row: Sequence[Axes], methods: Sequence[MethodImage], reference: LinearImage
) -> None:
    """Absolute errors; without a reference, differences to the image of the first method."""
    first, word = methods[0], "difference" if reference.is_absent else "error"
    truth = first.image if reference.is_absent else reference
    title = f"difference to {first.row_name}" if reference.is_absent else "error"
    for axes, method in zip(row[1:], methods, strict=True):
        error = np.abs(method.image.srgb - truth.srgb).mean(-1)
        drawn = _panel(axes, error, title, cmap="magma", vmin=0, vmax=MAX_ERROR)
    _color_bar(row[0], drawn, f"absolute {word} in sRGB,\nmean over channels", "max")


def _draw_differences(
    row: Sequence[Axes], methods: Sequence[MethodImage], reference: LinearImage
) -> None:
    """Squared errors minus that of the method with the highest PSNR; red is worse than it."""
    errors = [((method.image.srgb - reference.srgb) ** 2).mean(-1) for method in methods]
    best = max(range(len(methods)), key=lambda i: methods[i].psnr)
    others = [error - errors[best] for i, error in enumerate(errors) if i != best]
    limit = float(np.percentile(np.abs(others), DIFFERENCE_PERCENTILE)) or 1.0
    for i, axes in enumerate(row[1:]):
        if i == best:
            _write(axes, "the best: others minus this")
            continue
        difference = errors[i] - errors[best]
        title = f"minus {methods[best].row_name}"
        drawn = _panel(axes, difference, title, cmap="RdBu_r", vmin=-limit, vmax=limit)
    _color_bar(row[0], drawn, "difference of squared error in sRGB,\nmean over channels", "both")


def _is_adaptive(method: MethodImage) -> bool:
    """True if the samples of two pixels differ by more than a rounded budget makes them."""
    return bool(method.counts.min() < method.counts.max() - 1)


def _draw_counts(row: Sequence[Axes], methods: Sequence[MethodImage]) -> None:
    most = max(int(method.counts.max()) for method in methods)
    for axes, method in zip(row[1:], methods, strict=True):
        if not _is_adaptive(method):
            _write(axes, f"uniform: {method.counts.mean():.3g} spp")
            continue
        title = f"{method.counts.min()} to {method.counts.max()} samples per pixel"
        drawn = _panel(axes, method.counts, title, cmap="viridis", vmin=0, vmax=most)
    _color_bar(row[0], drawn, "samples per pixel", "neither", integer=True)


def _write(axes: Axes, text: str) -> None:
    """A sentence in place of a panel that would show one colour."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", fontsize=9)


def _panel(axes: Axes, values: Array, title: str, **style: Any) -> AxesImage:
    axes.set_title(title, fontsize=8, pad=3)
    return axes.imshow(values, interpolation="nearest", **style)


def _color_bar(
    axes: Axes, drawn: AxesImage, label: str, extend: str, integer: bool = False
) -> None:
    """The scale of a row, in the column of the reference; `integer`: only whole numbers on it."""
    from matplotlib.ticker import MaxNLocator

    inset = axes.inset_axes((0.1, 0.5, 0.8, 0.05))
    ticks = MaxNLocator(MOST_TICKS, integer=integer)
    bar = axes.figure.colorbar(
        drawn, cax=inset, orientation="horizontal", extend=extend, ticks=ticks
    )
    bar.set_label(label, fontsize=8)
    inset.tick_params(labelsize=7)
