"""Metadata of a method, readable without torch: paper, licence, variants, requirements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Family", "Traits", "Variant"]


@dataclass(frozen=True)
class Traits:
    """The requirements of a method. Renderer and loader provide exactly this and no more.

    The pilot is part of the budget: with pilot_spp=1 and a budget of 4 spp, the method places the
    other 3; at a budget of 1 spp, the pilot takes everything. `passes` are cumulative shares of the
    budget and include the pilot; one that ends below the pilot adds no samples. With
    `discard_pilot`, `min_samples` counts the samples of the last pass alone.

    A method with a `receptive_field` of r computes a pixel of its image and of its next state from
    the buffers, samples and state of the pixels at most r away, along both axes, and from nothing
    else: no average over the image, no read along motion vectors. Without samples, and with equal
    buffers and state, it then returns equal pixels, so `rlbench.wrappers.SkipTiles` can keep them.
    Its state is None or a named tuple of tensors [n c h w]. `plan` may depend on the whole image.

    Raises ValueError if the pilot or the receptive field is negative, or if the passes do not
    increase to 1.0.

    >>> Traits(inputs=frozenset({"albedo"}), adaptive=True, passes=(0.25, 1.0)).max_samples is None
    True
    """

    inputs: frozenset[str] = frozenset()  # G-buffer channels to read, see rlbench.frames.GBuffer
    pool: str = "path"  # name of the sample pool (rlbench.pools.PoolKind)
    adaptive: bool = False  # True if the density of `plan` can vary between pixels
    temporal: bool = False  # True if `state` carries information from frame to frame
    pilot_spp: float = 0.0  # uniform samples per pixel, >= 0, drawn before the first call of `plan`
    passes: tuple[float, ...] = (1.0,)  # share of the budget spent by the end of each pass, (0, 1]
    discard_pilot: bool = False  # True if `denoise` gets only the samples of the last pass
    min_samples: int = 0  # least samples of a pixel after the last pass, whatever the density
    max_samples: int | None = None  # most samples of a pixel; None: as many as the pool has
    spp_range: tuple[float, float] = (0.0, 8.0)  # supported budgets in spp, both ends included
    receptive_field: int | None = None  # of `denoise`, radius in pixels; None: the whole image
    reads_each_sample: bool = False  # True if their mean in place of each harms the image
    eager_reason: str = ""  # why its frames cannot be recorded: what asks for values; else empty

    def __post_init__(self) -> None:
        """Reject values below zero and passes that do not increase to the whole budget."""
        if not self.pilot_spp >= 0:  # also rejects NaN
            raise ValueError(f"pilot_spp is {self.pilot_spp}; it must be 0 or more")
        if self.receptive_field is not None and self.receptive_field < 0:
            raise ValueError(f"receptive_field is {self.receptive_field}; it must be 0 or more")
        pairs = zip((0.0, *self.passes), self.passes, strict=False)
        if not all(a < b for a, b in pairs) or self.passes[-1:] != (1.0,):
            raise ValueError(
                f"passes are {self.passes}; they must increase from above 0 to exactly 1.0, "
                "for example (0.25, 1.0)"
            )

    def unsupported_reason(self, spp: float) -> str | None:
        """Why a budget of `spp` samples per pixel cannot be run, or None if it can.

        >>> Traits(spp_range=(1.0, 8.0)).unsupported_reason(0.5)
        'supports 1 to 8 spp, requested 0.5'
        """
        low, high = self.spp_range
        if not low <= spp <= high:
            return f"supports {low:g} to {high:g} spp, requested {spp:g}"
        discarded = max(self.pilot_spp, *(share * spp for share in (0.0, *self.passes[:-1])))
        if self.discard_pilot and round(spp - discarded, 6) < self.min_samples:
            left = max(spp - discarded, 0.0)
            return (
                f"discards {min(discarded, spp):g} of {spp:g} spp, and the {left:g} left cannot "
                f"pay for min_samples of {self.min_samples}"
            )
        return None

    def nearest_spp(self, spp: float) -> float:
        """The budget within `spp_range` that is nearest to `spp` samples per pixel."""
        low, high = self.spp_range
        return min(max(low, spp), high)


@dataclass(frozen=True)
class Variant:
    """One configuration of a family, and the question that its results answer."""

    question: str  # shown by `rlbench list`
    traits: Traits
    learned: bool = True  # True if it needs trained weights
    pretrained: bool = True  # True if its weights are shipped; if not, `FAMILY/*` leaves it out
    weights_from: str | None = None  # method whose weights it uses, "oidn/tuned"; None: its own
    trained_by: str = ""  # who published its weights; empty if `rlbench train` makes them
    requires: tuple[str, ...] = ()  # PyPI distributions whose versions can change its images


@dataclass(frozen=True)
class Family:
    """A published method and its variants. The variant `""` is the method as published.

    `build` names a function as `module:name`, imported at first use, that takes (variant, device,
    weights) and returns a `Method`. `weights` is the path of a file, `"random"` for untrained
    weights from a fixed seed, or None for the shipped file. Shipped files are
    `cards/NAME.safetensors` beside the module of `build`; when one changes, results are measured
    again. `train` names a function in the same way (see `rlbench.training.loop`); it is empty if
    nothing is learned.

    >>> box = Family("box", "Box filter", "Nobody 2026, A paper", "MIT", build="box.method:build",
    ...     variants={"": Variant("Is blurring enough?", Traits(), learned=False)})
    """

    name: str
    title: str
    paper: str  # author, year, title
    licence: str  # of the implementation and its weights
    variants: Mapping[str, Variant]
    build: str
    train: str = ""

    def method_names(self) -> list[str]:
        """Names of all variants as on the command line: `family` or `family/variant`."""
        return [f"{self.name}/{key}" if key else self.name for key in self.variants]

    def weights_file(self, variant: str) -> str:
        """File name of the shipped weights of `variant`, or of the method in `weights_from`."""
        source = self.variants[variant].weights_from
        return f"{(source or variant or self.name).rpartition('/')[2]}.safetensors"
