"""Parts of the light of a frame, passes or light groups, denoised so that they add up to the image.

Each part is denoised as an image of its own, with the buffers and a state of its own. Then all are
scaled, in each pixel and channel, so that their sum is the denoised image; the light that is in no
named part counts as one more, which is not written. So each part costs one denoising.

Renderers divide the light of surfaces by their colour: Blender's DiffDir times DiffCol is a part.
Where a colour is black (below 0.001) its part has no light, so light that is blurred onto such a
pixel is in the parts without a colour, or in none.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.clips.exr import ExrHeader, Window
from rlbench.clips.image_files import (
    Channels,
    Pixels,
    find_channels,
    has_channels,
    list_channels,
    read_exr_image,
)
from rlbench.denoise import DenoiseError, NoisyFrame, denoise_frame
from rlbench.errors import SourceError
from rlbench.method import Method, State

__all__ = ["DenoisedParts", "LightPass", "denoise_parts", "find_passes"]

COLOURS = (  # the colour that Blender divides a pass by, 4.x and 5.x
    (re.compile(r"(Diff|Gloss|Trans)(Dir|Ind)"), r"\1Col"),
    (re.compile(r"(Diffuse|Glossy|Transmission) (Direct|Indirect)"), r"\1 Color"),
)
IMAGE, REST = "image", "rest"  # beside the names of passes
MAX_EXCESS = 0.05  # of the image's light, that parts may have more than the image has
ROUNDING = 0.01  # of the image, that halves of light, colour and image make
BLACK = 1e-3  # colours below have no light: the quotient would exceed a half number
FAINT = 1e-6  # weight of noisy light against denoised light, which counts where that is black


@dataclass(frozen=True)
class LightPass:
    """Where a part of the light is in the file of the image."""

    name: str
    light: Channels
    colour: Channels | None = None  # that the light is divided by


@dataclass(frozen=True)
class Part:
    """A part of the light of one frame."""

    light: Float[Tensor, "n 3 h w"]  # as the file has it
    colour: Float[Tensor, "n 3 #h #w"]  # that it is divided by

    @property
    def is_divided(self) -> bool:
        """Whether the light has a colour of its own."""
        return self.colour.shape != (1, 3, 1, 1)

    @property
    def is_lit(self) -> Bool[Tensor, "n 3 #h #w"]:
        """Where the colour can be divided by."""
        return self.colour >= BLACK

    @property
    def radiance(self) -> Float[Tensor, "n 3 h w"]:
        """Its share of the image."""
        return self.light * self.colour


def find_passes(path: Path, names: Sequence[str], layer: str = "") -> tuple[LightPass, ...]:
    """The passes of these names in a file, `LIGHT` or `LIGHT*COLOUR`.

    Raises SourceError for a name that the file does not have, or that stands twice.
    """
    found = []
    for name in names:
        light, _, colour = (word.strip() for word in name.partition("*"))
        guess = next((p.sub(c, light) for p, c in COLOURS if p.fullmatch(light)), "")
        if not colour and guess and has_channels(path, _channels(guess, layer)):
            colour = guess
        for each in filter(None, (light, colour)):
            if not has_channels(path, _channels(each, layer)):
                raise SourceError(
                    f"{path} has no layer '{each}' with the channels R, G and B; it has: "
                    f"{', '.join(_list_layers(path)) or 'none'}"
                )
        found.append(
            LightPass(light, _channels(light, layer), _channels(colour, layer) if colour else None)
        )
    counts = Counter(each.name.lower() for each in found)
    if twice := [each.name for each in found if counts[each.name.lower()] > 1]:
        raise SourceError(f"the pass '{twice[0]}' is named twice")
    return tuple(found)


def read_parts(
    path: Path, passes: Sequence[LightPass], window: Window | None, flip: tuple[int, ...]
) -> dict[str, Part]:
    """The passes of a file by name; values that are negative or not finite are 0.

    The images are flipped along these axes. A part of the file is decoded once, however many passes
    are in it. Raises SourceError.
    """
    places = [
        [find_channels(path, each) if each else None for each in (one.light, one.colour)]
        for one in passes
    ]
    names = defaultdict[str, list[str]](list)  # of channels, by part of the file
    for header, found in filter(None, chain.from_iterable(places)):
        names[header.name] += found
    images = {
        part: to_tensor(
            np.flip(read_exr_image(path, Channels([own], part), 0, window).pixels, flip)
        )
        for part, own in names.items()
    }
    valid = {part: image.nan_to_num(0, 0, 0).clamp_min(0) for part, image in images.items()}

    def pick(place: tuple[ExrHeader, list[str]] | None) -> Tensor:
        if place is None:
            return torch.ones(1, 3, 1, 1)
        header, found = place
        return valid[header.name][:, [names[header.name].index(name) for name in found]]

    return {each.name: Part(*map(pick, pair)) for each, pair in zip(passes, places, strict=True)}


def _channels(name: str, layer: str) -> Channels:
    """The channels of a pass, in any case, with or without the name of a view layer before it."""
    plain = [f"{name}.{letter}" for letter in "RGB"]
    return Channels([plain, [f"*.{each}" for each in plain]], layer=layer)


def _list_layers(path: Path) -> list[str]:
    """The layers of a file that have R, G and B. Raises SourceError."""
    parts = list_channels(path)
    layers = (
        (name.rpartition(".")[0] or part, names)
        for part, names in parts.items()
        for name in names
        if name.endswith("R")
    )
    return [
        layer
        for layer, names in layers
        if layer and {f"{layer}.G", f"{layer}.B"} <= {*names, *(f"{layer}.{n}" for n in names)}
    ]


@dataclass(frozen=True)
class DenoisedParts:
    """The denoised image and its parts, and what the next frame needs."""

    image: Float[Tensor, "n 3 h w"]  # linear radiance, at the exposure of the input
    lights: Mapping[str, Float[Tensor, "n 3 h w"]]  # of the parts, divided by their colours
    states: Mapping[str, State]  # of the image and of each part
    repairs: Mapping[str, int]  # invalid pixels that were replaced in the image, by buffer


def denoise_parts(
    method: Method,
    frame: NoisyFrame,
    parts: Mapping[str, Part],
    states: Mapping[str, State],
    exposure: float,
    device: torch.device | str = "cpu",
) -> DenoisedParts:
    """Denoise a frame and the parts of its light; `states` is empty before the first frame.

    Raises DenoiseError as `denoise_frame` does, and where the parts have more light than the image.
    """
    result = denoise_frame(method, frame, states.get(IMAGE), exposure, device)
    if not parts:
        return DenoisedParts(result.image, {}, {IMAGE: result.state}, result.repairs)
    noisy = {name: part.radiance for name, part in parts.items()}
    if (rest := _find_rest(frame.mean, noisy)) is not None:
        noisy[REST] = rest
    found = {
        name: denoise_frame(method, replace(frame, mean=light), states.get(name), exposure, device)
        for name, light in noisy.items()
    }
    weights = {
        name: found[name].image.clamp_min(0) + FAINT * light for name, light in noisy.items()
    }
    for name, part in parts.items():
        fallback = 0 if part.is_divided else FAINT**2
        weights[name] = (weights[name] + fallback) * part.is_lit
    total = sum(weights.values(), torch.full_like(frame.mean, torch.finfo(torch.float32).tiny))
    lights = {
        name: torch.where(part.is_lit, result.image * weights[name] / total / part.colour, 0)
        for name, part in parts.items()
    }
    states = {IMAGE: result.state, **{name: each.state for name, each in found.items()}}
    return DenoisedParts(result.image, lights, states, result.repairs)


def _find_rest(mean: Tensor, parts: Mapping[str, Tensor]) -> Tensor | None:
    """The light of the image that is in no part, if it is more than parts were rounded by.

    Raises DenoiseError for parts that have more light than the image.
    """
    mean = mean.nan_to_num(0, 0, 0).clamp_min(0)
    difference = mean - sum(parts.values(), torch.zeros_like(mean))
    excess = float(-difference.clamp_max(0).sum()) / max(float(mean.sum()), FAINT)
    if excess > MAX_EXCESS:
        raise DenoiseError(
            f"the passes {', '.join(parts)} have {excess:.0%} more light than the image, so they "
            "are not parts of it. Two may be the same light, or a light may need its colour: "
            "--also 'LIGHT*COLOUR'"
        )
    is_rounding = difference <= ROUNDING * (mean + ROUNDING * mean.mean())
    return None if is_rounding.all() else difference.clamp_min(0)


def to_tensor(pixels: Pixels) -> Float[Tensor, "1 c h w"]:
    """An image [h w c] as a tensor, float32."""
    image = torch.from_numpy(np.ascontiguousarray(pixels, np.float32))
    return image.movedim(-1, 0)[None].contiguous()
