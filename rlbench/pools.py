"""Sample pools: the interface between a renderer and a plugin that draws samples in its own way.

The path tracer's samples are independent, so each frame can be traced alone. Any other pool yields
sample streams: stream s gives one sample per pixel and frame and may reuse results of earlier
frames, as the reservoirs of ReSTIR do. A plugin registers such a pool as a `PoolKind`. Its
`factory` receives a `RenderContext`, the scene that the renderer advances from frame to frame, and
returns `SampleStreams`. This module does not import torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

__all__ = ["PATH", "PoolKind", "RenderContext", "SampleStreams"]


@dataclass(frozen=True)
class PoolKind:
    """A kind of sample pool; `name` identifies it in `Traits.pool` and clip.toml.

    `factory` names a function as `module:name`, imported when samples are first traced. It takes
    (context, streams), where the range `streams` holds the index of each stream, and returns
    `SampleStreams`. It is empty for samples that the renderer draws itself.

    >>> PoolKind("restir", "ReSTIR DI", "my_package.restir:streams", independent=False).name
    'restir'
    """

    name: str
    title: str
    factory: str = ""
    version: int = 1  # increase it when `factory` draws different samples of the same scene
    independent: bool = True  # True if samples are unbiased and independent of all other samples


class RenderContext(Protocol):
    """The renderer's scene at the current frame, in Mitsuba's wavefront mode.

    Pixels are numbered row by row from the upper left. Film positions are in pixels, x right and
    y down.
    """

    height: int  # pixels
    width: int  # pixels

    @property
    def scene(self) -> Any:
        """The Mitsuba scene (mi.Scene) at the current frame."""

    @property
    def max_depth(self) -> int:
        """Maximum path depth, in edges."""

    def camera_rays(self, x: Any, y: Any) -> Any:
        """Camera rays (mi.Ray3f) through film positions (mi.Float)."""

    def sampler(self, pixels: Any, samples: Any) -> Any:
        """A random sampler with one lane per pair of pixel and sample index (mi.UInt32).

        Its numbers depend on pixel, sample index, frame and seed alone. The field `rng` is its
        generator, a PCG32.
        """

    def motion(self) -> tuple[Any, Any]:
        """Motion vectors of all pixels (mi.Float, x and y), in pixels to the previous frame.

        They point outside the image in the first frame of a shot.
        """


class SampleStreams(Protocol):
    """Streams of samples with state; called once per frame, in order."""

    def __call__(self) -> Float[Array, "streams h w 3"]:
        """One sample per pixel from each stream, linear radiance."""


PATH = PoolKind("path", "independent path-traced samples, one per pixel and image")
