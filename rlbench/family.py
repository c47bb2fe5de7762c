"""What a plugin says of itself before torch is imported: paper, licence, variants, needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Traits:
    """What a method asks of the bench; the bench reads, traces and buys no more than this.

    A pilot is a part of the budget: with one of 1 spp and a budget of 4, the method is asked where
    the other 3 go, and at a budget of 1 nothing is left to ask for. `passes` count it in, as they
    do each other. Raises ValueError for a pilot below zero, and for passes that do not rise to the
    whole budget.
    """

    inputs: frozenset[str] = frozenset()  # view buffers it reads: albedo, normal, depth, motion
    pool: str = "path"  # the kind of sample pool it buys from
    adaptive: bool = False  # does `plan` ever differ from a constant?
    temporal: bool = False  # does `state` carry anything between frames?
    pilot_spp: float = (
        0.0  # samples per pixel, evenly spread, bought before the method is first asked
    )
    passes: tuple[float, ...] = (1.0,)  # share of the budget bought by the end of each pass
    discard_pilot: bool = (
        False  # are samples of earlier passes, which chose where to sample, left out?
    )
    min_samples: int = 0  # samples that every pixel has at last, whatever the densities
    max_samples: int | None = (
        None  # most samples of one pixel that it can take in; None is as many as sold
    )
    spp_range: tuple[float, float] = (
        0.0,
        8.0,
    )  # budgets that make sense, samples per pixel, inclusive

    def __post_init__(self) -> None:
        """Refuse passes by which less than the budget would be bought, or less than before."""
        if not self.pilot_spp >= 0:
            raise ValueError(f"the pilot is {self.pilot_spp} samples per pixel; it is 0 or more")
        rising = all(a < b for a, b in zip((0.0, *self.passes), self.passes, strict=False))
        if not rising or self.passes[-1:] != (1.0,):
            raise ValueError(
                f"passes are {self.passes}; they must rise from above 0 to 1.0 at last"
            )

    def unsupported_reason(self, spp: float) -> str | None:
        """Why a budget of `spp` cannot be run, or None if it can."""
        low, high = self.spp_range
        if low <= spp <= high:
            return None
        return f"supports {low:g} to {high:g} spp, asked for {spp:g}"


@dataclass(frozen=True)
class Variant:
    """One row of a family's table: the question it answers, and what it asks of the bench."""

    question: str
    traits: Traits
    learned: bool = True  # does it need trained weights?
    pretrained: bool = (
        True  # do they come with it? if not, `*` passes it over, and training makes them
    )
    weights_from: str | None = None  # the variant whose weights it uses, if not its own
    requires: tuple[str, ...] = ()  # distributions that make its images; measured anew with others


@dataclass(frozen=True)
class Family:
    """A published method and its variants. The variant `""` is the method itself.

    `build` names a function, as `module:name`, that takes (variant, device, weights) and returns a
    `Method`; it is imported when the method is first asked for. `weights` is the path of a file, or
    `"random"` for seeded untrained weights, or None for the shipped ones: NAME.safetensors in the
    folder `cards` beside that module, NAME as in `weights`; results are measured anew when this
    file changes. `train` names a function in the same way (see `rlbench.training.loop`), or is
    empty where nothing is learned.
    """

    name: str
    title: str
    paper: str  # author, year, title
    licence: str
    variants: Mapping[str, Variant]
    build: str
    train: str = ""
    aliases: Mapping[str, str] = field(default_factory=dict)  # former variant name -> current one

    def names(self) -> list[str]:
        """Every variant as it is written on the command line, `family` or `family/variant`."""
        return [f"{self.name}/{key}" if key else self.name for key in self.variants]

    def weights(self, variant: str) -> str:
        """File name of a variant's shipped weights: its own name, or that of whose it borrows."""
        borrowed = self.variants[variant].weights_from
        return f"{(variant if borrowed is None else borrowed) or self.name}.safetensors"
