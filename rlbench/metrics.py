"""The metrics as functions of images: tensors, arrays or files.

    >>> import torch
    >>> from rlbench import metrics
    >>> reference = torch.linspace(0, 1, 64 * 96).expand(3, -1).reshape(3, 64, 96)
    >>> image = (reference + 0.1).clamp(0, 1)
    >>> round(metrics.psnr(image, reference), 2), round(metrics.ssim(image, reference), 4)
    (20.85, 0.9807)
    >>> mask = torch.zeros(64, 96, dtype=torch.bool)
    >>> mask[:32] = True  # the upper half alone
    >>> round(metrics.psnr(image, reference, mask=mask, convention="linear"), 2)
    20.0
    >>> sorted(metrics.score(image, reference))
    ['bias', 'ms_ssim_3', 'nonfinite', 'psnr', 'relmse', 'relmse_trimmed', 'smape', 'ssim']

There is a function for each metric of `rlbench list metrics`, those of plugins too, with the
arguments of `score`: `psnr`, `ssim`, `ms_ssim`, `mse`, `relmse`, `relmse_trimmed`, `smape`, `bias`,
`rel_l2`, `nonfinite`, `flip`, `hdr_flip`, `lpips`; with a pair of half references `psnr_debiased`,
`mse_debiased` and `blotches`; of frames in order `tpsnr`, `psnr_late`, `drift`, `warped_error`,
`flicker`, `image_flicker` and `cvvdp`; with counts `effort_error`, `effort_noise` and `at_cap`.
Values equal those in the rows of `rlbench run`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.evaluation import OF_RUNS, load_metric
from rlbench.clips.linear_images import ANY_IMAGE, ANY_MODE, LooseImageError, read_linear
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    from metrics.metric import Comparison, Metric

__all__ = ["Scores", "score"]

Image = Any  # one image or several: a tensor, an array, a file, or a list of these
Value = float | Tensor  # of one image a number; of n images [n], in float32


class Scores(dict[str, Value]):
    """Values by the names of their metrics."""

    metrics: Mapping[str, Metric] = {}  # by the same names, with unit, direction and convention


def score(
    image: Image,
    reference: Image = None,
    metrics: str | Iterable[str] = (),
    *,
    data_range: float | None = None,
    convention: str = "",
    mask: Any = None,
    counts: Any = None,
    max_samples: int | None = None,
    motion: Any = None,
    static: bool = False,
    layer: str = "",
) -> Scores:
    """Several metrics of an image beside its reference, by name.

    An image is a torch tensor [c h w], a NumPy array [h w c] or [h w], or an EXR, PFM or PNG file;
    several of one size are a tensor [n c h w], an array [n h w c], or a list. c is 3, or 1 for
    grey. Values are linear radiance: EXR and PFM are read as they are, in Rec. 709, PNG as 8-bit
    sRGB that is decoded. A pixel that is NaN or infinite has the largest error that a display can
    show; references must be finite. Scores are computed in float32, without gradients.

    Args:
        image: the image, or several.
        reference: its reference, one for all images, or one for each. A tuple of two is a pair of
            independent halves; `rlbench.Frame.reference` is one. `nonfinite`, `image_flicker` and
            `at_cap` need none.
        metrics: names; without any, those of `rlbench run` that these arguments allow. Metrics of
            motion take the images as frames in order, and have no value of the first ones.
        data_range: the value of display white; default 1, and integers need one. With 255 and
            "linear", 8-bit values are compared as they are; of an EXR with an exposure it is
            1 / exposure.
        convention: how radiance becomes the values that PSNR and SSIM compare: "srgb", the default,
            "linear", "hable", "paper2023" or "noisebase-v1" (`metrics.conventions`).
        mask: [h w], true for pixels that count, in all images. For metrics whose errors are those
            of single pixels, not for SSIM and others that see neighbours.
        counts: samples of each pixel, [n 1 h w]; the most that one can have is `max_samples`.
        motion: pixels to the previous frame, [n 2 h w], x right, y down; or all is `static`.
        layer: layer of EXR files that have several.

    Returns:
        A number for one image, a tensor [n] for several; its `metrics` have the units. Names are
        those of `rlbench run`: MS-SSIM of sides of 160 pixels or less is called `ms_ssim_4` to
        `ms_ssim_1`, PSNR under another convention `psnr@hable`.

    Raises:
        LooseImageError: a ValueError and RlbenchError, for images that cannot be read or compared,
            and metrics that these arguments do not allow.
        PluginError: for a metric that does not exist or needs a package.
    """
    read = partial(_read_images, data_range=data_range, layer=layer)
    images = read(image, "image")
    is_single = isinstance(image, str | Path) or not isinstance(image, list) and image.ndim < 4
    pixels = _Pixels(
        images,
        *_read_halves(reference, images, read),
        max_samples,
        static,
        counts=_read_buffer("counts", counts, 1, images),
        motion=_read_buffer("motion", motion, 2, images),
    )
    if mask is not None:
        pixels = pixels.select(_read_mask(mask, images))
    pixels.check_references()
    names = [metrics] if isinstance(metrics, str) else list(metrics)
    return pixels.score(_select_metrics(names, convention, pixels), is_single)


def __getattr__(name: str) -> Callable[..., Value]:
    """The function of a metric."""
    known = [] if name.startswith("__") else registry.list_plugins("metrics")
    if name not in known:
        problem = f"module '{__name__}' has no function '{name}'"
        raise AttributeError(unknown_name(problem, name, known))
    metric: Metric = registry.load_or_explain("metrics", name)

    def measure(image: Image, reference: Image = None, **options: Any) -> Value:
        ((found, value),) = score(image, reference, [name], **options).items()
        if found.partition("@")[0] != name:
            raise LooseImageError(
                f"{name} is not defined at this size; {__name__}.score(image, reference, "
                f"['{name}']) returns {found}, which is another metric"
            )
        return value

    signature = inspect.signature(score)
    parameters = [each for each in signature.parameters.values() if each.name != "metrics"]
    measure.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=parameters, return_annotation="Value"
    )
    measure.__name__ = measure.__qualname__ = name
    better = f", {metric.direction} is better" if metric.direction else ""
    unit = f" in {metric.unit}" if metric.unit else ""
    measure.__doc__ = (
        f"{name}{unit}{better}: {metric.convention}.\n\nSource: {metric.source or 'not given'}. "
        "`score` describes the arguments."
    )
    return measure


def __dir__() -> list[str]:
    """The functions, those of plugins too."""
    return sorted([*__all__, *registry.list_plugins("metrics")])


@dataclass(frozen=True)
class _Pixels:
    """Images beside their references, [n 3 h w] in display whites, and what else metrics read."""

    images: Tensor
    half_a: Tensor
    half_b: Tensor
    halves: int  # that are known of each reference: 0 without one, 2 if they are independent
    max_samples: int | None
    static: bool
    counts: Tensor | None
    motion: Tensor | None
    is_masked: bool = False

    def select(self, mask: Tensor) -> _Pixels:
        """The pixels of a mask [h w] in a row, for metrics of single pixels."""
        parts = {name: getattr(self, name) for name in ("images", "half_a", "half_b", "counts")}
        row = {k: v[..., mask].unsqueeze(-2) for k, v in parts.items() if v is not None}
        return replace(self, **row, motion=None, is_masked=True)

    def check_references(self) -> None:
        """Raise LooseImageError for references that are not finite."""
        wrong = ~(self.half_a.isfinite() & self.half_b.isfinite()).all(1)
        if count := int(wrong.sum()):
            raise LooseImageError(
                f"the reference has NaN or infinite pixels: {count} of {wrong.numel()}. Leave them "
                "out with a mask, or correct the reference"
            )

    def find_lack(self, metric: Metric) -> str:
        """What a metric needs that is not there; empty if nothing."""
        known = {"counts": self.counts, "max_samples": self.max_samples, "motion": self.motion}
        lacks = [name for name in metric.needs if known.get(name) is None]
        frames = metric.previous_frames + 1
        if self.is_masked and not metric.pixelwise:
            return "all pixels, as it sees neighbours. Crop the images in place of a mask"
        if metric.needs_reference_halves and self.halves < 2:
            return "a pair of independent half references, (half_a, half_b)"
        if metric.needs_reference and not self.halves:
            return "a reference"
        if lacks and not (self.static and lacks == ["motion"]):
            return f"{lacks[0]}"
        if len(self.images) < frames:
            return f"{frames} frames in order, or more; there is {len(self.images)}"
        return ""

    @torch.no_grad()
    def score(self, metrics: Sequence[Metric], is_single: bool) -> Scores:
        """The values of metrics by name."""
        values, batch, frames = Scores(), list[Any](), list[Any]()
        sized = [each.at(*self.images.shape[-2:]) for each in metrics]
        values.metrics = {each.name: each for each in sized}
        for metric in sized:
            if not (metric.previous_frames or metric.whole_clip):
                batch = batch or list(self._compare(metric, [slice(None)]))
                value = metric.score(batch[0])
                values[metric.name] = float(value[0]) if is_single else value
                continue
            frames = frames or list(
                self._compare(metric, [slice(i, i + 1) for i in range(len(self.images))])
            )
            if metric.whole_clip:
                values[metric.name] = float(metric.score(frames))
            else:
                scored = frames[metric.previous_frames :]
                values[metric.name] = torch.cat([metric.score(each) for each in scored])
        return values

    def _compare(self, metric: Metric, parts: Iterable[slice]) -> Iterator[Comparison]:
        """Comparisons of parts of the images, each after the one before."""
        previous = None
        for part in parts:
            counts, motion = (x if x is None else x[part] for x in (self.counts, self.motion))
            truth = metric.ground_truth_type(
                self.half_a[part], self.half_b[part], motion, self.static
            )
            previous = metric.comparison_type(
                self.images[part],
                truth,
                counts=counts,
                max_samples=self.max_samples,
                previous=previous,
            )
            yield previous


def _select_metrics(names: Sequence[str], convention: str, pixels: _Pixels) -> list[Metric]:
    """The named metrics, or those of a run that are possible, under a convention."""
    named = [load_metric(name) for name in dict.fromkeys(names)]
    for metric in named:
        if lack := pixels.find_lack(metric):
            raise LooseImageError(f"{metric.name} needs {lack}")
    found = named or [
        each
        for each in registry.load_run_metrics().values()
        if not each.previous_frames and not pixels.find_lack(each)
    ]
    if not convention or convention == OF_RUNS:
        return found
    try:  # where none takes one, the first says so
        takes = any(each.takes_convention for each in found)
        return [
            each.under(convention) if each.takes_convention or not takes else each for each in found
        ]
    except ValueError as error:
        raise LooseImageError(f"convention '{convention}': {error}") from error


def _read_images(images: Image, what: str, data_range: float | None, layer: str) -> Tensor:
    """Images [n 3 h w] in float32, where display white is 1."""
    read = _to_tensor(images, what, layer)
    if not read.is_floating_point() and data_range is None:
        raise LooseImageError(
            f"{what} has values of {read.dtype}: give the value of display white, such as "
            "data_range=255, and convention='linear' if the values are encoded already"
        )
    if data_range is not None and not 0 < data_range < math.inf:
        raise LooseImageError(f"data_range={data_range}: it is a finite number above 0")
    n, channels, h, w = read.shape
    if channels not in (1, 3):
        raise LooseImageError(
            f"{what} has {channels} channels of {w} x {h} pixels; 3 are expected, or 1. Channels "
            "are first in a tensor, [c h w], and last in an array, [h w c]"
        )
    return (read.float() / (data_range or 1.0)).expand(n, 3, h, w)


def _read_halves(
    reference: Image, images: Tensor, read: Callable[[Image, str], Tensor]
) -> tuple[Tensor, Tensor, int]:
    """Both halves of the references, for each image, and how many are known."""
    if reference is None:
        none = torch.zeros_like(images)
        return none, none, 0
    if hasattr(reference, "half_a"):
        reference = reference.half_a, reference.half_b
    pair = reference if isinstance(reference, tuple) else (reference,)
    if len(pair) > 2:
        raise LooseImageError(
            f"a tuple is a pair of independent half references, and this one has {len(pair)}; "
            "several images are a list"
        )
    halves = [_match(read(each, "reference"), images, "reference") for each in pair]
    return halves[0], halves[-1], len(pair)


def _read_buffer(what: str, values: Any, channels: int, images: Tensor) -> Tensor | None:
    """Other values of each pixel, [n c h w], or None."""
    if values is None:
        return None
    read = _to_tensor(values, what)
    if read.shape[1] != channels:
        raise LooseImageError(f"{what} has {read.shape[1]} channels, expected {channels}")
    return _match(read, images, what)


def _read_mask(mask: Any, images: Tensor) -> Tensor:
    """A mask [h w] on the device of the images."""
    found = torch.as_tensor(mask, device=images.device)
    h, w = images.shape[-2:]
    if found.dtype != torch.bool or found.shape != (h, w):
        raise LooseImageError(
            f"the mask is {found.dtype} {list(found.shape)}; expected true or false for each pixel "
            f"of the images, [{h} {w}]"
        )
    if not found.any():
        raise LooseImageError("the mask leaves no pixel to compare")
    return found


def _match(values: Tensor, images: Tensor, what: str) -> Tensor:
    """Values for each image, on their device. Raises LooseImageError for another size."""
    (n, _, h, w), (count, channels, rows, columns) = images.shape, values.shape
    if (rows, columns) != (h, w):
        raise LooseImageError(
            f"the image has {w} x {h} pixels, and {what} {columns} x {rows}; crop or scale one"
        )
    if count not in (1, n):
        raise LooseImageError(f"there are {n} images, and of {what} {count}; give 1 or {n}")
    return values.to(images.device).expand(n, channels, h, w)


def _to_tensor(images: Image, what: str, layer: str = "") -> Tensor:
    """One image or several as [n c h w]."""
    if isinstance(images, list) and images:
        parts = [_to_tensor(each, what, layer) for each in images]
        if len(sizes := {tuple(part.shape[1:]) for part in parts}) > 1:
            found = ", ".join(f"{w} x {h} of {c} channels" for c, h, w in sorted(sizes))
            raise LooseImageError(f"the images of {what} have several sizes: {found}")
        return torch.cat(parts)
    if isinstance(images, str | Path):
        images = read_linear(Path(images), ANY_IMAGE, ANY_MODE, layer)
    if isinstance(images, np.ndarray):
        array = images[..., None] if images.ndim == 2 else images
        images = torch.from_numpy(np.ascontiguousarray(np.moveaxis(array, -1, -3)))
    if not isinstance(images, Tensor) or images.ndim not in (3, 4) or not images.numel():
        shape = list(getattr(images, "shape", ()))
        raise LooseImageError(
            f"{what} is a {type(images).__name__} {shape or ''}; expected a tensor [c h w] or "
            "[n c h w], an array [h w c] or [n h w c], a file, or a list of these"
        )
    return images if images.ndim == 4 else images[None]
