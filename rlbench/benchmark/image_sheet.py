"""Pictures of one frame: what each method shows, its error, and where its samples went."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.cell_ids import CellIds
from rlbench.benchmark.cell_loader import CellLoader
from rlbench.benchmark.run_plan import Cell, RunPlan
from rlbench.clips.exr import write_exr
from rlbench.errors import RlbenchError
from rlbench.run import FrameResult, run_clip
from rlbench.system import paths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

NONFINITE_COLOUR = (255, 0, 255)  # of pixels that are not finite, which a display would hide
WORST = 0.25  # mean error of a pixel's colours, of display white, at the end of the scale
SIDE, TITLE = 2.6, 0.25  # inches of a picture on the sheet, and of the line above it
DPI = 150


class ImagesError(RlbenchError, ValueError):
    """What cannot be pictured."""


@dataclass(frozen=True)
class Picture:
    """One frame as a method shows it."""

    method: str  # as in the results
    radiance: Float[Array, "h w 3"]  # linear, 1.0 is display white
    counts: Int[Array, "h w"]  # samples of each pixel
    psnr: float  # dB

    @property
    def broken(self) -> int:
        """Pixels that are not finite."""
        return int((~np.isfinite(self.radiance).all(-1)).sum())


class Sheet(NamedTuple):
    """A picture of all methods, and which are not on it, each with the reason."""

    file: Path
    without: dict[str, str]


def write(
    request: RunPlan, frame: int, out: Path, tell: Callable[[Cell], None] = lambda cell: None
) -> Iterator[Sheet]:
    """Write pictures of one frame, -1 for a clip's last, into OUT/CLIP-SPPspp-FRAME; yields sheets.

    Frames before it are run too, for what methods remember. Raises ImagesError where a clip has no
    such frame, and where no method can be run on it, with the reasons.
    """
    ready, names = CellLoader(request), CellIds(request)
    for clip, spp in product(request.clips, request.spp):
        index = frame if frame >= 0 else clip.header.frames + frame
        if not 0 <= index < clip.header.frames:
            raise ImagesError(
                f"--frame {frame}: clip '{clip.header.name}' has frames 0 to "
                f"{clip.header.frames - 1}"
            )
        made: list[Picture] = []
        without: dict[str, str] = {}
        for cell in (Cell(method, clip, spp, request.seeds[0]) for method in request.methods):
            try:
                shown = _frame(ready, cell, index)
            except Exception as error:  # whatever a stranger's method may raise is what is told
                own = isinstance(error, (ImagesError, registry.PluginError))
                without[cell.method] = str(error) if own else f"{type(error).__name__}: {error}"
            else:
                made.append(picture(names.method(cell.method), shown))
                reference = _pixels(shown.frame.reference.mean)
            tell(cell)
        if not made:
            raise ImagesError("; ".join(f"{method}: {why}" for method, why in without.items()))
        name = f"{clip.header.name}-{spp:g}spp-{index:02}"
        _save(out / name / "reference", reference)
        for each in made:
            _save(out / name / each.method.replace("/", "-"), each.radiance)
        title = f"{clip.header.name}, frame {index}, {spp:g} spp"
        yield Sheet(_sheet(made, reference, title, out / f"{name}.png"), without)


def display(radiance: Float[Array, "h w 3"]) -> UInt8[Array, "h w 3"]:
    """Linear radiance as clipped sRGB (IEC 61966-2-1), which PSNR is of; BROKEN if not finite."""
    from skimage.util import img_as_ubyte

    shown = img_as_ubyte(_curve(radiance))
    shown[~np.isfinite(radiance).all(-1)] = NONFINITE_COLOUR
    return np.asarray(shown)


def _curve(radiance: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    import torch
    from kornia.color import linear_rgb_to_rgb

    finite = np.nan_to_num(radiance, nan=0.0).clip(0, 1)
    curved: Tensor = linear_rgb_to_rgb(torch.from_numpy(finite).movedim(-1, 0))
    return curved.movedim(0, -1).clamp(0, 1).numpy()


def _frame(ready: CellLoader, cell: Cell, index: int) -> FrameResult:
    if why := ready.unusable(cell):
        raise ImagesError(why)
    return frame_at(run_clip(ready.method(cell), ready.clip(cell), cell.spp), index)


def frame_at(run: Iterable[FrameResult], index: int) -> FrameResult:
    """The frame of that number; those after it are not run."""
    return next(shown for shown in run if shown.frame.index == index)


def picture(method: str, shown: FrameResult) -> Picture:
    """What came of a frame, as a picture with its score."""
    reference = shown.frame.reference
    score = registry.load_or_explain("metrics", "psnr").score(
        shown.image, reference.half_a, reference.half_b
    )
    counts = shown.samples.counts[0, 0].cpu().numpy()
    return Picture(method, _pixels(shown.image), counts, float(score[0]))


def _pixels(image: Tensor) -> Float[Array, "h w 3"]:
    return np.asarray(image[0].movedim(0, -1).float().cpu().numpy())


def _save(stem: Path, radiance: Float[Array, "h w 3"]) -> None:
    from PIL import Image

    stem.parent.mkdir(parents=True, exist_ok=True)
    channels = dict(zip("RGB", np.moveaxis(radiance.astype(np.float32), -1, 0), strict=True))
    write_exr(stem.parent / f"{stem.name}.exr", channels)
    with paths.replacing(stem.parent / f"{stem.name}.png") as temporary:
        Image.fromarray(display(radiance)).save(temporary, format="png")


def _sheet(
    made: Sequence[Picture], reference: Float[Array, "h w 3"], title: str, file: Path
) -> Path:
    """Images, errors and, where any method adapts, samples: a column a method, reference first."""
    from matplotlib.figure import Figure

    adapts = any(each.counts.min() < each.counts.max() - 1 for each in made)
    rows, columns = 2 + adapts, 1 + len(made)
    wide, high = SIDE * columns, (SIDE * reference.shape[0] / reference.shape[1] + TITLE) * rows
    figure = Figure(figsize=(wide, high + TITLE))
    grid = figure.subplots(rows, columns, squeeze=False)
    edges = {"left": 0.0, "right": 1.0, "bottom": 0.0, "top": 1 - 2 * TITLE / (high + TITLE)}
    figure.subplots_adjust(**edges, wspace=0.02, hspace=TITLE * rows / high)
    most = max(int(each.counts.max()) for each in made)
    for axes in grid.flat:
        axes.set_axis_off()
    _show(grid[0, 0], display(reference), "reference")
    truth = _curve(reference)
    for column, each in enumerate(made, 1):
        broken = f", {each.broken} broken" if each.broken else ""
        _show(grid[0, column], display(each.radiance), f"{each.method}  {each.psnr:.2f} dB{broken}")
        error = np.abs(_curve(each.radiance) - truth).mean(-1)
        errors = _show(grid[1, column], error, "error", cmap="magma", vmin=0, vmax=WORST)
        if adapts:
            told = f"{each.counts.min()} to {each.counts.max()} samples a pixel"
            samples = _show(grid[2, column], each.counts, told, cmap="viridis", vmin=0, vmax=most)
    _scale(grid[1, 0], errors, "mean error of a pixel's colours,\nof display white", "max")
    if adapts:
        _scale(grid[2, 0], samples, "samples of a pixel", "neither")
    figure.suptitle(title, fontsize=9, y=1 - 0.25 * TITLE / (high + TITLE))
    with paths.replacing(file) as temporary:
        figure.savefig(temporary, dpi=DPI, format="png")
    return file


def _show(axes: Axes, values: Array, title: str, **how: Any) -> AxesImage:
    axes.set_title(title, fontsize=8, pad=3)
    return axes.imshow(values, interpolation="nearest", **how)


def _scale(axes: Axes, shown: AxesImage, label: str, extend: str) -> None:
    """The scale of a row, in the column of the reference."""
    place = axes.inset_axes((0.1, 0.5, 0.8, 0.05))
    bar = axes.figure.colorbar(shown, cax=place, orientation="horizontal", extend=extend)
    bar.set_label(label, fontsize=8)
    place.tick_params(labelsize=7)
