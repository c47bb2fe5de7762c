"""Wrappers around a method: the base class, half-precision inference, skipped tiles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.errors import PluginError
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.method import Method, State
from rlbench.ops.tiles import Window, cover_tiles, find_changed_tiles

__all__ = ["HalfPrecision", "MethodWrapper", "SkipTiles", "TileMemory", "crop_inputs", "map_state"]

M = TypeVar("M", bound=Method)


@dataclass(frozen=True)
class MethodWrapper(Generic[M]):
    """A method that forwards every call to another method, like `gymnasium.Wrapper`.

    Subclass it and override the members that differ. A wrapper is itself a `Method`.

    >>> @dataclass(frozen=True)
    ... class Brighter(MethodWrapper[Method]):
    ...     def denoise(self, gbuffer, samples, state):
    ...         image, state = super().denoise(gbuffer, samples, state)
    ...         return 2 * image, state
    >>> from rlbench import registry
    >>> Brighter(registry.load_method("mean", torch.device("cpu"))).traits.adaptive
    False
    """

    method: M

    @property
    def traits(self) -> Traits:
        """The wrapped method's traits."""
        return self.method.traits

    @property
    def config(self) -> Any:
        """The wrapped method's config, or None."""
        return getattr(self.method, "config", None)

    def start(self, size: Size) -> State:
        """The wrapped method's state before the first frame of a clip."""
        return self.method.start(size)

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The wrapped method's density."""
        return self.method.plan(gbuffer, samples, state)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image, and the next state."""
        return self.method.denoise(gbuffer, samples, state)


@dataclass(frozen=True)
class HalfPrecision(MethodWrapper[Method]):
    """A method with convolutions and matrix products in `dtype`; density and image stay float32.

    torch.autocast keeps sums, norms and other precision-critical operations in float32. The method
    itself needs no change. Its state may hold tensors of `dtype`.
    """

    device: torch.device  # where the method computes
    dtype: torch.dtype  # see rlbench.system.half_precision.half_dtype

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The method's density, in float32."""
        with torch.autocast(self.device.type, self.dtype):
            return super().plan(gbuffer, samples, state).float()

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The method's image, in float32, and the next state."""
        with torch.autocast(self.device.type, self.dtype):
            image, state = super().denoise(gbuffer, samples, state)
        return image.float(), state


class TileMemory(NamedTuple):
    """The state of a method whose unchanged tiles are skipped."""

    state: State  # of the method
    gbuffer: GBuffer | None = None  # of the last frame; None before the first
    counts: Tensor | None = None  # samples per pixel of the last frame
    state_before: State = None  # that the method had before the last frame
    image: Tensor | None = None  # of the last frame
    skipped: float = 0.0  # share of the last frame's pixels that were kept, in [0, 1]


@dataclass(frozen=True)
class SkipTiles(MethodWrapper[Method]):
    """A method that denoises only tiles that changed, and keeps the others of the last image.

    For methods with `Traits(receptive_field=...)`. A pixel is unchanged if it got no samples in
    this frame and in the last one, and its buffers and state are bit by bit those before the last
    frame. Tiles of 32 x 32 pixels with a changed pixel in reach of the receptive field are denoised
    in windows, which hold all pixels in reach; the others keep image and state. Both are those of
    the method itself, bit by bit if its operations are elementwise. In windows torch's sums over a
    dimension round their last 64 elements in another way, and convolutions all. A frame whose
    windows have as many pixels as the image is denoised as a whole.

    Raises PluginError for a method without a receptive field, and for a state other than None or a
    named tuple of tensors [n c h w].

    >>> from rlbench import registry
    >>> from rlbench.clips.procedural.clip import procedural_clip
    >>> from rlbench.run import run_clip
    >>> method = SkipTiles(registry.load_method("mean", torch.device("cpu")))
    >>> clip = procedural_clip(size=Size(1, 64, 96), frames=2, static=True)
    >>> [result.state.skipped for result in run_clip(method, clip, spp=0.0)]
    [0.0, 1.0]
    """

    def __post_init__(self) -> None:
        """Reject a method whose image may depend on far pixels."""
        if self.traits.receptive_field is None:
            raise PluginError(
                "the method has no receptive field, so none of its tiles can be skipped; "
                "declare Traits(receptive_field=...) if it is local"
            )

    def start(self, size: Size) -> TileMemory:
        """The method's first state, and no image."""
        return TileMemory(super().start(size))

    def plan(
        self, gbuffer: GBuffer, samples: Samples, state: TileMemory
    ) -> Float[Tensor, "n 1 h w"]:
        """The method's density."""
        return super().plan(gbuffer, samples, state.state)

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: TileMemory
    ) -> tuple[Float[Tensor, "n 3 h w"], TileMemory]:
        """The method's image, with unchanged tiles from the last one."""
        radius, (h, w) = self.traits.receptive_field or 0, samples.counts.shape[-2:]
        tiles = find_changed_tiles(_find_changes(gbuffer, samples, state), radius)
        windows = cover_tiles(tiles, radius, h, w)
        reads = [window.grow(radius, h, w) for window in windows]
        if state.image is None or sum(read.area for read in reads) >= h * w:
            image, after = super().denoise(gbuffer, samples, state.state)
            return image, TileMemory(after, gbuffer, samples.counts, state.state, image)
        image, next_state = state.image.clone(), map_state(torch.clone, state.state)
        kept = torch.ones(h, w, dtype=torch.bool)
        for window, read in zip(windows, reads, strict=True):
            denoised, after = super().denoise(*crop_inputs(gbuffer, samples, state.state, read))
            inner = window.relative_to(read)
            targets, sources = (image, *_parts(next_state)), (denoised, *_parts(after))
            for target, source in zip(targets, sources, strict=True):
                target[..., window.rows, window.columns] = inner.crop(source)
            kept[window.rows, window.columns] = False
        skipped = float(kept.float().mean())
        return image, TileMemory(next_state, gbuffer, samples.counts, state.state, image, skipped)


def _find_changes(
    gbuffer: GBuffer, samples: Samples, memory: TileMemory
) -> Bool[Tensor, "n 1 h w"]:
    """True for pixels with samples in this frame or the last, another G-buffer or another state."""
    if memory.gbuffer is None or memory.counts is None:
        return torch.ones_like(samples.counts, dtype=torch.bool)
    changed = (samples.counts > 0) | (memory.counts > 0)
    before, now = (*memory.gbuffer.buffers.values(),), (*gbuffer.buffers.values(),)
    old, new = _parts(memory.state_before), _parts(memory.state)
    for last, current in zip((*before, *old), (*now, *new), strict=True):
        if last is not current:
            changed = changed | (last != current).any(1, keepdim=True)
    return changed


def crop_inputs(
    gbuffer: GBuffer, samples: Samples, state: State, window: Window
) -> tuple[GBuffer, Samples, State]:
    """The arguments of `denoise` for a window of the image. Raises as `map_state` does."""
    buffers = {name: window.crop(buffer) for name, buffer in gbuffer.buffers.items()}
    cropped = Samples(window.crop(samples.radiance), window.crop(samples.counts))
    return GBuffer(buffers, gbuffer.static), cropped, map_state(window.crop, state)


def map_state(function: Callable[[Tensor], Tensor], state: State) -> State:
    """The state of a local method with `function` applied to each of its tensors.

    Raises PluginError for a state other than None or a named tuple of tensors [n c h w].
    """
    return None if state is None else state._make(map(function, _parts(state)))


def _parts(state: State) -> tuple[Tensor, ...]:
    """The tensors of a local method's state."""
    if state is None:
        return ()
    is_named_tuple = isinstance(state, tuple) and hasattr(state, "_make")
    if is_named_tuple and all(isinstance(part, Tensor) and part.ndim == 4 for part in state):
        return tuple(state)
    raise PluginError(
        f"the state of a method with a receptive field is {type(state).__name__}; "
        "return None or a named tuple of tensors [n c h w]"
    )
