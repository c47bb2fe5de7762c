"""Kinds of sample pool: how the samples were drawn that a method buys.

Samples of the path tracer are independent, so each frame can be traced by itself. Those of any
other pool come in chains: chain number s gives one sample of every pixel of every frame, and may
remember what it found in the frames before. A plugin brings such a pool as a function, `make`, that
is handed a `Stage`: the renderer's scene, which the renderer moves from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True)
class PoolKind:
    """A way of drawing samples. `name` is what traits and clip.toml say.

    `make` names a function, as `module:name`, that takes (stage, numbers), where the range
    `numbers` tells chains apart, and returns `Chains`; it is imported when samples are first
    traced, and empty for what the renderer draws by itself.
    """

    name: str
    title: str
    factory: str = ""
    recipe: int = 1  # raised whenever `make` draws other samples of the same scene
    independent: bool = True  # is the noise of each pixel and frame its own, and its mean right?


class RenderContext(Protocol):
    """What a renderer shows to a pool: its scene at the present frame, in Mitsuba with wavefronts.

    Pixels count row by row from the upper left; a place on the film is in pixels, x right, y down.
    """

    height: int
    width: int

    @property
    def scene(self) -> Any:
        """The Mitsuba scene, as it is now."""

    @property
    def depth(self) -> int:
        """Longest light path, in edges."""

    def rays(self, x: Any, y: Any) -> Any:
        """The camera's rays through places on the film (mi.Float)."""

    def numbers(self, pixels: Any, samples: Any) -> Any:
        """A sampler for lanes of pixels and samples (mi.UInt32), which decide its numbers.

        So do the frame and the seed. Its generator, a PCG32, is its field `rng`.
        """

    def motion(self) -> tuple[Any, Any]:
        """Of every pixel (mi.Float, x and y): pixels to where the same was one frame earlier.

        It leads outside the image where another shot begins.
        """


class SampleStreams(Protocol):
    """Chains of samples, which remember."""

    def __call__(self) -> Float[Array, "chains h w 3"]:
        """One sample per pixel of each chain, linear radiance; once a frame, in order."""


PATH = PoolKind("path", "independent path-traced samples, one per pixel and image")
