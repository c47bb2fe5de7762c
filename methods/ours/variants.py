"""The table of variants: one frozen Config each, one changed field for each question."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Config:
    """What makes a variant. Channel counts follow from these (methods/ours/network.py)."""

    slots: int = 8  # individual samples the encoder sees, per pixel
    latent: int = 32  # channels of the state
    sampler: tuple[int, ...] = (4, 8, 16, 32)  # widths of the sampler's levels; empty: uniform
    bptt: int = 1  # frames through which gradients flow
    flat: bool = False  # is the sampler's map ignored?


BASE = Config()
VARIANTS = {
    "": BASE,
    "A2": replace(BASE, sampler=()),  # is planning worth its time?
    "flat": replace(BASE, flat=True),  # what does the map give, all else equal?
}
