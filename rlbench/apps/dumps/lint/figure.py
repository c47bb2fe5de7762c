"""One figure of a clip for inspection: images, reprojection, buffers, noise and tick list."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.checks.display import to_display
from rlbench.checks.result import CheckResult, Verdict
from rlbench.ops.reprojection import reproject
from rlbench.system.paths import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    Verdict.PASSED: "#2E7D32",
    Verdict.WARNING: "#B8860B",
    Verdict.FAILED: "#C62828",
    Verdict.SKIPPED: "#8A8A8A",
}
BINS = 80
MAX_ERROR = 0.25  # difference of clipped sRGB that is drawn as white


def draw_figure(arrays: ClipArrays, results: Sequence[CheckResult], path: Path) -> Path:
    """Write a PNG: the last frame, the previous one reprojected, errors, buffers, noise, checks."""
    from matplotlib.figure import Figure

    sanitized = arrays.sanitized
    exposure = sanitized.header.exposure
    figure = Figure(figsize=(16, 11.2), layout="constrained")
    grid = figure.subplots(3, 4)
    reference = sanitized.reference * exposure
    last = len(arrays) - 1
    _draw_image(grid[0, 0], to_display(reference[last]), f"reference, frame {last}")
    if last > 0:
        _draw_reprojection(grid[0], sanitized, reference, last)
    else:
        for axes in grid[0, 1:]:
            axes.set_axis_off()
    pool = next(iter(sanitized.pools.values()))
    _draw_image(grid[1, 0], to_display(pool[last, 0] * exposure), "one sample")
    _draw_buffers(grid[1], sanitized, last)
    _draw_histogram(grid[2, 0], sanitized)
    half_a, half_b = (
        to_display(half[last : last + 1] * exposure)
        for half in (sanitized.half_a, sanitized.half_b)
    )
    noise = (half_a - half_b).abs()[0].mean(0)
    _draw_map(grid[2, 1], noise, "noise of the reference: |A - B|", MAX_ERROR / 2)
    for axes in grid[2, 2:]:
        axes.set_axis_off()
    _draw_results(grid[2, 2], results)
    failures = sum(result.verdict is Verdict.FAILED for result in results)
    title = f"{arrays.header.name}: {failures} of {len(results)} checks failed"
    figure.suptitle(title, fontsize=15)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")
    return path


def _draw_reprojection(
    row: Sequence[Axes], arrays: ClipArrays, reference: Tensor, last: int
) -> None:
    """The previous frame reprojected by the stored motion, and the error with and without it."""
    motion = arrays.gbuffer["motion"][last, None] if "motion" in arrays.gbuffer else None
    current, previous = to_display(reference[last]), to_display(reference[last - 1])
    reprojected, valid = reproject(previous[None], motion)
    _draw_image(row[1], reprojected[0] * valid[0], f"frame {last - 1} reprojected by motion")
    errors = {"with": (reprojected[0] - current) * valid[0], "without": previous - current}
    for axes, (kind, error) in zip(row[2:], errors.items(), strict=True):
        size = error.abs().mean(0)
        title = f"error {kind} motion, mean {float(size.mean()):.3f}"
        _draw_map(axes, size, title, MAX_ERROR)


def _draw_buffers(row: Sequence[Axes], arrays: ClipArrays, last: int) -> None:
    for axes, (name, scale, offset) in zip(
        row[1:], (("albedo", 1.0, 0.0), ("normal", 0.5, 0.5)), strict=False
    ):
        if name in arrays.gbuffer:
            image = (arrays.gbuffer[name][last] * scale + offset).clamp(0, 1)
            _draw_image(axes, image, name)
        else:
            axes.set_axis_off()
    if "depth" in arrays.gbuffer:
        disparity = 1 / arrays.gbuffer["depth"][last, 0].abs().clamp_min(1e-6)
        _draw_map(row[3], disparity, "1 / depth: near is bright", float(disparity.max()))
    else:
        row[3].set_axis_off()


def _draw_histogram(axes: Axes, arrays: ClipArrays) -> None:
    """Histograms of radiance: those of samples have long tails, that of the reference has none."""
    pool = next(iter(arrays.pools.values()))
    for name, image in (("samples", pool), ("reference", arrays.reference)):
        log = (image.mean(-3) * arrays.header.exposure).clamp_min(1e-5).log10().flatten()
        counts = torch.histc(log, BINS, -5, 3) / log.numel()
        axes.stairs(counts.numpy(), torch.linspace(-5, 3, BINS + 1).numpy(), label=name, fill=False)
    axes.axvline(0, color="#8A8A8A", lw=0.8)
    axes.set_yscale("log")
    axes.set_title("radiance, log10; 0 is display white")
    axes.set_ylabel("share of pixels")
    axes.legend(frameon=False)


def _draw_results(axes: Axes, results: Sequence[CheckResult]) -> None:
    y = 1.0
    for result in results:
        found = textwrap.shorten(result.found, 230, placeholder=" ...")
        lines = textwrap.wrap(f"{result.check}: {found}", 105)
        axes.text(
            0, y, f"{result.verdict.value}  ", color=COLOURS[result.verdict], fontsize=9,
            fontweight="bold", va="top", transform=axes.transAxes, in_layout=False,
        )  # fmt: skip
        axes.text(
            0.13, y, "\n".join(lines), fontsize=8.5, va="top", transform=axes.transAxes,
            in_layout=False,
        )  # fmt: skip
        y -= 0.042 * len(lines) + 0.012


def _draw_image(axes: Axes, image: Tensor, title: str) -> None:
    axes.imshow(image.movedim(0, -1).numpy(), interpolation="nearest")
    axes.set_title(title)
    axes.set_axis_off()


def _draw_map(axes: Axes, values: Tensor, title: str, maximum: float) -> None:
    axes.imshow(values.numpy(), cmap="magma", vmin=0, vmax=maximum, interpolation="nearest")
    axes.set_title(title)
    axes.set_axis_off()
