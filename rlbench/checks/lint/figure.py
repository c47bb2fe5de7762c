"""One picture of a clip for a person: what is shown, where it was, and how noisy it is."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rlbench.checks.finding import Finding, Verdict
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.reference import shown
from rlbench.ops.reprojection import reproject
from rlbench.system.paths import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {Verdict.PASS: "#2E7D32", Verdict.WARN: "#B8860B", Verdict.FAIL: "#C62828"}
BINS = 80
WORST = 0.25  # difference of clipped sRGB that is drawn as white


def draw(footage: ClipArrays, findings: Sequence[Finding], path: Path) -> Path:
    """Write a PNG: last frame, the previous moved onto it, errors, buffers, noise, tick list."""
    from matplotlib.figure import Figure

    sound = footage.sound
    figure = Figure(figsize=(16, 11.2), layout="constrained")
    grid = figure.subplots(3, 4)
    light = sound.reference * sound.header.exposure
    last = len(footage) - 1
    _image(grid[0, 0], shown(light[last]), f"reference, frame {last}")
    if last > 0:
        _moved(grid[0], sound, light, last)
    else:
        for axes in grid[0, 1:]:
            axes.set_axis_off()
    pool = next(iter(sound.pools.values()))
    _image(grid[1, 0], shown(pool[last, 0] * sound.header.exposure), "one sample")
    _buffers(grid[1], sound, last)
    _noise(grid[2, 0], sound)
    apart = (
        shown(sound.half_a[last : last + 1] * sound.header.exposure)
        - shown(sound.half_b[last : last + 1] * sound.header.exposure)
    ).abs()
    _map(grid[2, 1], apart[0].mean(0), "noise of the reference: |A - B|", WORST / 2)
    for axes in grid[2, 2:]:
        axes.set_axis_off()
    _ticks(grid[2, 2], findings)
    bad = sum(each.verdict is Verdict.FAIL for each in findings)
    figure.suptitle(f"{footage.header.name}: {bad} of {len(findings)} checks failed", fontsize=15)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")
    return path


def _moved(row: Sequence[Axes], footage: ClipArrays, light: Tensor, last: int) -> None:
    """The previous frame moved by the stored motion, and the error with and without."""
    motion = footage.gbuffer["motion"][last, None] if "motion" in footage.gbuffer else None
    now, before = shown(light[last]), shown(light[last - 1])
    moved, valid = reproject(before[None], motion)
    _image(row[1], moved[0] * valid[0], f"frame {last - 1} moved onto it by motion")
    errors = {"with": (moved[0] - now) * valid[0], "without": before - now}
    for axes, (kind, error) in zip(row[2:], errors.items(), strict=True):
        size = error.abs().mean(0)
        _map(axes, size, f"error {kind} motion, mean {float(size.mean()):.3f}", WORST)


def _buffers(row: Sequence[Axes], footage: ClipArrays, last: int) -> None:
    for axes, (name, scale, shift) in zip(
        row[1:], (("albedo", 1.0, 0.0), ("normal", 0.5, 0.5)), strict=False
    ):
        if name in footage.gbuffer:
            _image(axes, (footage.gbuffer[name][last] * scale + shift).clamp(0, 1), name)
        else:
            axes.set_axis_off()
    if "depth" in footage.gbuffer:
        disparity = 1 / footage.gbuffer["depth"][last, 0].abs().clamp_min(1e-6)
        _map(row[3], disparity, "1 / depth: near is bright", float(disparity.max()))
    else:
        row[3].set_axis_off()


def _noise(axes: Axes, footage: ClipArrays) -> None:
    """Histograms of luminance: samples have long tails, the reference has not."""
    pool = next(iter(footage.pools.values()))
    for name, image in (("samples", pool), ("reference", footage.reference)):
        log = (image.mean(-3) * footage.header.exposure).clamp_min(1e-5).log10().flatten()
        counts = torch.histc(log, BINS, -5, 3) / log.numel()
        axes.stairs(counts.numpy(), torch.linspace(-5, 3, BINS + 1).numpy(), label=name, fill=False)
    axes.axvline(0, color="#8A8A8A", lw=0.8)
    axes.set_yscale("log")
    axes.set_title("radiance, log10; 0 is display white")
    axes.set_ylabel("share of pixels")
    axes.legend(frameon=False)


def _ticks(axes: Axes, findings: Sequence[Finding]) -> None:
    y = 1.0
    for each in findings:
        told = textwrap.shorten(each.found, 230, placeholder=" ...")
        lines = textwrap.wrap(f"{each.check}: {told}", 105)
        axes.text(
            0, y, f"{each.verdict.value}  ", color=COLOURS[each.verdict], fontsize=9,
            fontweight="bold", va="top", transform=axes.transAxes, in_layout=False,
        )  # fmt: skip
        axes.text(
            0.13, y, "\n".join(lines), fontsize=8.5, va="top", transform=axes.transAxes,
            in_layout=False,
        )  # fmt: skip
        y -= 0.042 * len(lines) + 0.012


def _image(axes: Axes, image: Tensor, title: str) -> None:
    axes.imshow(image.movedim(0, -1).numpy(), interpolation="nearest")
    axes.set_title(title)
    axes.set_axis_off()


def _map(axes: Axes, values: Tensor, title: str, most: float) -> None:
    axes.imshow(values.numpy(), cmap="magma", vmin=0, vmax=most, interpolation="nearest")
    axes.set_title(title)
    axes.set_axis_off()
