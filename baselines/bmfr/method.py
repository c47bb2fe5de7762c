"""One frame of BMFR: accumulate noisy light, fit blocks, accumulate the fit, antialias."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from baselines.bmfr import FAMILY
from baselines.bmfr.regression import fit_blocks, stack_features
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.accumulation import AccumulatedRadiance, fill_holes
from rlbench.ops.color import luminance
from rlbench.ops.demodulation import reflectance, surface_mask
from rlbench.ops.exposure import log_average
from rlbench.ops.fireflies import mean_without_fireflies, repair_radiance_history
from rlbench.ops.reprojection import reproject
from rlbench.ops.sanitize import repair_history, sanitize_radiance
from rlbench.ops.surface_taps import SurfaceTaps, find_surface_taps
from rlbench.ops.transfer import log_forward, log_inverse

MIN_NORMAL_COSINE = 0.5  # squared distance of unit normals below 1, as in the authors' code
MAX_LENGTH = 255.0  # frames of a history; theirs is a byte
MAX_LOG_IMAGE = 4.0  # of an image in log transfer; that of 65504 is 3.7


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants, and the published constants."""

    noise: float = 0.01  # largest noise of a feature in the fit
    alpha_noisy: float = 0.2  # least weight of a new frame in the light that is fitted
    alpha_filtered: float = 0.1  # least weight of a new frame in the fitted light
    alpha_image: float = 0.2  # weight of a new frame in antialiasing; 1: none
    contrast: float = 16.0  # of irradiance to its log-average, above which a surface emits
    fills_holes: bool = False  # fit light of the neighbourhood where no sample and no history is


BASE = Config()
VARIANTS = {
    "": BASE,
    "filled": replace(BASE, fills_holes=True),  # does it work below 1 spp?
}


class History(NamedTuple):
    """The state between frames; length 0 means no history, depth 0 no surface."""

    noisy: Float[Tensor, "n 3 h w"]  # accumulated irradiance
    filtered: Float[Tensor, "n 3 h w"]  # accumulated fits of it
    length: Float[Tensor, "n 1 h w"]  # frames
    image: Float[Tensor, "n 3 h w"]  # last output, log transfer
    depth: Float[Tensor, "n 1 h w"]
    normal: Float[Tensor, "n 3 h w"]
    frame: Int[Tensor, " n"]  # of each clip since its last cut; decides offset and noise


@dataclass(frozen=True)
class Bmfr:
    """Blockwise multi-order feature regression (Koskela et al. 2019).

    The mean of the samples is divided by albedo and accumulated along the motion vectors: all
    frames of a short history weigh the same, and a new one at least 0.2. Each block of 32 x 32
    pixels of this light is fitted by least squares with 10 features: 1, the normal, the position,
    and its squares, the last six less the block's minimum and divided by their range if it exceeds
    1. Uniform noise of 0.01 on every feature but the constant keeps blocks solvable. Blocks move by
    one of 16 offsets in each frame and are mirrored at borders. The fit at a pixel's own features,
    at least 0, is accumulated with weights of at least 0.1, multiplied by albedo, and antialiased:
    the last image, clamped in YCoCg to the mean of box and cross of the 3 x 3 neighbourhood, weighs
    0.8. Constants and order are those of the authors' code (github.com/maZZZu/bmfr, MIT), which was
    read; none of it was copied. Uniform sampling.

    Differs from it: clips hold no camera, so positions are those in camera space with a focal
    length of the image's height. With the constant, they span in every block the functions that
    world positions span, up to an affine map; their squares do not, and whether a range exceeds 1
    depends on the scene's unit. History taps match within 10 % of depth, since there are no world
    positions, and within the published distance of normals. Normals and positions of pixels without
    a surface, and of emitters that reflect nothing, have no part in history or fit; these pixels
    pass to antialiasing as they are. A renderer knows what a surface emits, and adds it after the
    filter; a G-buffer holds no emission, and a lamp of low albedo would spread over its block: a
    loss of 6 to 12 dB in four generated scenes with visible lamps. So a surface with 16 times the
    log-average irradiance of its frame is taken for an emitter (`find_emitters`); this takes
    fireflies and the brightest sunlit spots along. Dim lamps stay, and lamps that fill little of a
    pixel: of these, more samples find fewer, so that a larger budget may look worse. Antialiasing
    works in log transfer before any tone mapping, and starts anew where the previous position is
    outside. Offsets and noise start anew in a clip all of which lost its history. Noise comes from
    another hash, in single precision; a ridge of 0.001 per coefficient gives blocks without a
    surface a solution.

    Ours, as in `svgf`: albedo is the mean of 3 x 3 pixels; fireflies are limited; a pixel whose
    mean is not finite keeps its history, or is black; broken history is replaced by a neighbour.
    In `filled`, a pixel without a sample keeps its history, and without history gets the light of
    its neighbourhood before the fit.
    """

    config: Config = BASE
    traits: Traits = FAMILY.variants[""].traits
    device: torch.device = torch.device("cpu")

    def start(self, size: Size) -> History:
        """No history."""
        zeros = torch.zeros(size.n, 3, size.h, size.w, device=self.device)
        one = zeros[:, :1]
        frame = torch.zeros(size.n, dtype=torch.int64, device=self.device)
        return History(zeros, zeros, one, zeros, one, zeros, frame)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: History) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.depth)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: History
    ) -> tuple[Float[Tensor, "n 3 h w"], History]:
        """The image in linear radiance, and the history for the next frame."""
        # demodulate
        noisy, albedo = samples.mean, reflectance(gbuffer.albedo)
        surface = surface_mask(gbuffer.albedo, gbuffer.depth)
        limited = mean_without_fireflies(samples.radiance, samples.counts)
        irradiance = torch.where(surface, limited / albedo, 0.0)
        is_sampled = surface & (samples.counts > 0) & noisy.isfinite().all(1, keepdim=True)
        outshines = find_emitters(irradiance, is_sampled, self.config.contrast)
        surface, is_sampled = (mask & ~outshines for mask in (surface, is_sampled))
        irradiance, depth, normal = (
            part.where(surface, 0.0) for part in (irradiance, gbuffer.depth, gbuffer.normal)
        )

        # reproject
        taps = find_surface_taps(
            gbuffer.motion, (depth, normal), (state.depth, state.normal), MIN_NORMAL_COSINE
        )
        history = _gather(state, taps)
        is_known = taps.valid.flatten(1).any(1)
        frame = torch.where(is_known, state.frame + 1, 0)

        # accumulate, fit, accumulate
        length = (history.length + is_sampled).clamp_max(MAX_LENGTH)
        light = self._blend(irradiance, history.noisy, length, self.config.alpha_noisy, is_sampled)
        if self.config.fills_holes:
            light = _fill(light, length, surface)
        features = stack_features(normal, depth)
        fitted = fit_blocks(light, features, surface, frame, self.config.noise)
        has_light = (length > 0) | self.config.fills_holes
        filtered = self._blend(
            fitted, history.filtered, length, self.config.alpha_filtered, has_light
        )

        # modulate and antialias
        image = torch.where(surface, filtered * albedo, sanitize_radiance(noisy))
        previous, inside = reproject(
            repair_history(state.image, 0.0, MAX_LOG_IMAGE), gbuffer.motion
        )
        inside = inside & (frame > 0).view(-1, 1, 1, 1)
        image = antialias(log_forward(image), previous, inside, self.config.alpha_image)
        state = History(light, filtered, length, image, depth, normal, frame)
        return log_inverse(image), state

    def _blend(
        self, new: Tensor, old: Tensor, length: Tensor, least: float, is_used: Tensor
    ) -> Float[Tensor, "n 3 h w"]:
        """The new light mixed into the old by max(1 / length, least); the old where not used."""
        alpha = (1 / length.clamp_min(1)).clamp_min(least)
        return torch.lerp(old, new, torch.where(is_used, alpha, 0.0))


def find_emitters(
    irradiance: Float[Tensor, "n 3 h w"], known: Bool[Tensor, "n 1 h w"], contrast: float
) -> Bool[Tensor, "n 1 h w"]:
    """Where the luminance of irradiance exceeds `contrast` times its log-average over known pixels.

    Irradiance is that of the surfaces of a frame, 0 elsewhere.
    """
    brightness = luminance(irradiance)
    return brightness > contrast * log_average(brightness.where(known, 0.0), known)


def antialias(
    image: Float[Tensor, "n 3 h w"],
    previous: Float[Tensor, "n 3 h w"],
    valid: Bool[Tensor, "n 1 h w"],
    alpha: float,
) -> Float[Tensor, "n 3 h w"]:
    """The image, mixed with the previous one clamped to the colours of the neighbourhood.

    Both are in log transfer. Bounds are the mean of those of the 3 x 3 box and of its cross, in
    YCoCg. Where `valid` is false the image is returned as it is.
    """
    colour = _to_ycocg(image)
    both = torch.cat((colour, -colour), 1)  # least values are greatest ones of the negative
    h, w = image.shape[2:]
    rows = F.pad(both, (1, 1, 1, 1), mode="replicate")
    beside = _greatest(rows[..., x : x + w] for x in range(3))  # of three columns
    box = _greatest(beside[..., y : y + h, :] for y in range(3))
    above_below = torch.maximum(rows[..., :h, 1 : 1 + w], rows[..., 2:, 1 : 1 + w])
    cross = torch.maximum(beside[..., 1 : 1 + h, :], above_below)
    most, least = ((box + cross) / 2).chunk(2, 1)
    clamped = _to_ycocg(previous).clamp(-least, most)
    mixed = _from_ycocg(torch.lerp(clamped, colour, alpha)).clamp_min(0)
    return torch.where(valid, mixed, image)


def _greatest(images: Iterable[Tensor]) -> Tensor:
    """The greatest value at each pixel."""
    return reduce(torch.maximum, images)


def _to_ycocg(rgb: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    red, green, blue = rgb.unbind(1)
    return torch.stack(
        ((red + 2 * green + blue) / 4, (red - blue) / 2, (2 * green - red - blue) / 4), 1
    )


def _from_ycocg(colour: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    y, orange, green = colour.unbind(1)
    return torch.stack((y + orange - green, y + green, y - orange - green), 1)


def _gather(state: History, taps: SurfaceTaps) -> History:
    """Light and length as seen from this frame; 0 where there is no history."""
    noisy, filtered = map(repair_radiance_history, (state.noisy, state.filtered))
    length = repair_history(state.length, 0.0, MAX_LENGTH)
    moved = taps.gather(torch.cat((noisy, filtered, length), 1))
    noisy, filtered, length = moved.split_with_sizes((3, 3, 1), 1)
    return state._replace(noisy=noisy, filtered=filtered, length=length)


def _fill(
    light: Float[Tensor, "n 3 h w"],
    length: Float[Tensor, "n 1 h w"],
    surface: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, "n 3 h w"]:
    """Irradiance, where nothing is known that of the neighbourhood's surfaces."""
    known = AccumulatedRadiance(light, length, length)  # the second moment is not read
    return fill_holes(known, torch.ones_like(light)).mean.where(surface, 0.0)


def build(variant: str, device: torch.device, weights: str | None) -> Bmfr:
    """BMFR with the published constants; it has no weights."""
    return Bmfr(VARIANTS[variant], FAMILY.variants[variant].traits, device)
