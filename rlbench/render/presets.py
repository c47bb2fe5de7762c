"""What to render, as data: scenes, sizes, and samples for pools and references."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from rlbench.clips.header import EXTRAS
from rlbench.errors import RlbenchError

FOUR = ("city", "temple", "hall", "ripples")
BOTH = ("path", "restir")  # pools, by entry point of the group rlbench.pools
GENERATED = "generated"  # clips of rlbench.scenes.generator.scene are named generated-<seed>
Takes = Literal["main", "all"]


class PresetError(RlbenchError, ValueError):
    """A preset that cannot be rendered."""


@dataclass(frozen=True)
class Preset:
    """One set of clips. A reference is two halves, so a round has twice `reference_spp` samples."""

    name: str
    purpose: str
    size: tuple[int, int]  # pixels: height, width
    frames: int  # of each clip
    reference_spp: int  # samples per pixel of each half of the reference
    scenes: tuple[str, ...] = FOUR  # by entry point of the group rlbench.scenes
    seeds: tuple[int, ...] = ()  # of generated scenes
    is_test_set: bool = True  # are methods scored on it? Then nothing may be trained on it
    takes: Takes = "main"  # of each scene, that are clips of their own
    pool_spp: int = 8  # stored 1-spp images per frame
    cap: float = math.inf  # brightest that a sample may be, times display white
    ceiling_db: float = math.inf  # PSNR by which the noise of a reference must not limit a score
    max_reference_rounds: int = 1  # of `reference_spp` each, at most, until it does not
    pools: tuple[str, ...] = ("path",)  # others are of plugins, and added where they can be traced
    extras: tuple[str, ...] = ()  # view buffers beside those that every clip has

    @property
    def clip_samples(self) -> int:
        """Light paths that one clip costs at most; two cores trace a million a second."""
        return self.frames * self.frame_samples

    @property
    def frame_samples(self) -> int:
        """Light paths that one frame costs at most: the pool and all rounds of both halves."""
        most = self.pool_spp + 2 * self.reference_spp * self.max_reference_rounds
        return self.size[0] * self.size[1] * most

    def capped(self, cap: float) -> Preset:
        """The same with a cap, under a name of its own. Raises PresetError unless it is above 0."""
        if not cap > 0:
            raise PresetError(f"a radiance cap of {cap:g} was asked for; it must be above 0")
        return replace(self, name=f"{self.name}-cap{cap:g}", cap=cap)

    def with_buffers(self, extras: Collection[str]) -> Preset:
        """The same with more view buffers, under a name of its own. Raises PresetError."""
        chosen = tuple(name for name in EXTRAS if name in set(extras))
        if unknown := sorted(set(extras) - set(EXTRAS)):
            raise PresetError(
                f"no view buffer {', '.join(unknown)} to add; there are: {', '.join(EXTRAS)}"
            )
        return replace(self, name=f"{self.name}-views", extras=chosen)

    def with_takes(self, takes: str) -> Preset:
        """The same, under its name, with the main take of each scene, or all. PresetError."""
        if takes not in get_args(Takes):
            raise PresetError(f"--takes is main or all, and was given '{takes}'")
        return replace(self, takes=cast(Takes, takes))

    def with_pools(self, kinds: Collection[str]) -> Preset:
        """The same, under its name, with no pools but these kinds and the path tracer's."""
        return replace(self, pools=tuple(p for p in self.pools if p == "path" or p in kinds))


PRESETS = {
    preset.name: preset
    for preset in (
        Preset("tiny", "tests", (96, 96), 4, 16, ("temple", "city"), pools=BOTH),
        Preset(
            "mini", "the first command: about 4 minutes on two cores", (192, 192), 8, 64, pools=BOTH
        ),
        # 33 dB adds 0.4 dB to an error of 23 dB, for all methods alike; not to mse_debiased
        Preset(
            "standard",
            "a workstation: all takes",
            (256, 256),
            20,
            32,
            takes="all",
            ceiling_db=33.0,
            max_reference_rounds=12,
            pools=BOTH,
        ),
        # of each scene one take, as in the paper: a clip is 10^10 paths, three hours of two cores
        Preset("paper", "the paper's protocol: 1000 spp references", (720, 720), 20, 500),
        Preset(
            "train",
            "training: generated scenes",
            (160, 160),
            5,
            64,
            (),
            tuple(range(28)),
            is_test_set=False,
            pools=BOTH,
        ),
        Preset(
            "unseen",
            "many clips, so that small differences show: generated scenes kept from training",
            (160, 160),
            5,
            64,
            (),
            tuple(range(80, 128)),
        ),
    )
}


def preset(name: str) -> Preset:
    """The preset of that name. Raises LookupError, which lists those that exist."""
    if name not in PRESETS:
        raise LookupError(f"no preset '{name}'; there are: {', '.join(PRESETS)}")
    return PRESETS[name]
