"""Presets: named sets of clips with their scenes, sizes and sample counts."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from rlbench.clips.header import OPTIONAL_BUFFERS
from rlbench.errors import RlbenchError
from rlbench.registry.near_names import unknown_name

__all__ = [
    "GENERATORS",
    "PRESETS",
    "TEST_SCENES",
    "Preset",
    "PresetError",
    "TakeSelection",
    "UnknownPresetError",
    "get_preset",
    "is_test_split",
]

TEST_SCENES = ("city", "temple", "hall", "ripples")
PATH_AND_RESTIR = ("path", "restir")  # entry points in the group rlbench.pools
GENERATORS = (
    "generated",
    "eventful",
    "hard",
)  # scene entry points that take a seed; clips <name>-<seed>
TakeSelection = Literal["main", "all"]


class PresetError(RlbenchError, ValueError):
    """A preset option that cannot be used."""


class UnknownPresetError(RlbenchError, LookupError):
    """The name of a preset that does not exist."""


@dataclass(frozen=True)
class Preset:
    """One set of clips.

    A reference consists of two halves, so one round of it has twice `reference_spp` samples.
    """

    name: str
    purpose: str
    size: tuple[int, int]  # pixels: height, width
    frames: int  # of each clip
    reference_spp: int  # samples per pixel of each half of the reference, in each round
    scenes: tuple[str, ...] = TEST_SCENES  # entry points in the group rlbench.scenes
    seeds: tuple[int, ...] = ()  # of generated scenes
    generator: str = GENERATORS[0]  # entry point that generates them
    is_test_set: bool = True  # scored clips, which must not be trained on?
    takes: TakeSelection = "main"  # clips per scene: the main one, or one for each take as well
    pool_spp: int = 8  # stored 1-spp images per frame
    radiance_cap: float = math.inf  # upper bound of each sample, in display whites
    min_noise_ceiling_db: float = (
        math.inf
    )  # PSNR: more rounds follow until the reference reaches it
    max_reference_rounds: int = 1
    pools: tuple[str, ...] = (
        "path",
    )  # others come from plugins, where this machine can trace them
    extra_buffers: tuple[str, ...] = ()  # G-buffer channels beside those that every clip has

    @property
    def paths_per_clip(self) -> int:
        """Upper bound of light paths per clip; two CPU cores trace about a million a second."""
        return self.frames * self.paths_per_frame

    @property
    def paths_per_frame(self) -> int:
        """Upper bound of light paths per frame: the pool and all rounds of both halves."""
        spp = self.pool_spp + 2 * self.reference_spp * self.max_reference_rounds
        return self.size[0] * self.size[1] * spp

    def with_radiance_cap(self, cap: float) -> Preset:
        """This preset with a radiance cap and a name of its own.

        Raises PresetError unless `cap` > 0.

        >>> PRESETS["mini"].with_radiance_cap(64).name
        'mini-cap64'
        """
        if not cap > 0:
            raise PresetError(f"the radiance cap is {cap:g}; it must be above 0")
        return replace(self, name=f"{self.name}-cap{cap:g}", radiance_cap=cap)

    def with_buffers(self, buffers: Collection[str]) -> Preset:
        """This preset with extra G-buffer channels and a name of its own.

        Raises PresetError for an unknown buffer; the message lists those available.
        """
        if unknown := sorted(set(buffers) - set(OPTIONAL_BUFFERS)):
            raise PresetError(
                f"no G-buffer channel {', '.join(unknown)} to add; "
                f"available: {', '.join(OPTIONAL_BUFFERS)}"
            )
        chosen = tuple(name for name in OPTIONAL_BUFFERS if name in set(buffers))
        return replace(self, name=f"{self.name}-views", extra_buffers=chosen)

    def with_takes(self, takes: str) -> Preset:
        """This preset, under the same name, with `main` or `all` takes of each scene.

        Raises PresetError for any other word.
        """
        if takes not in get_args(TakeSelection):
            raise PresetError(f"--takes was given '{takes}'; it must be main or all")
        return replace(self, takes=cast(TakeSelection, takes))

    def with_pools(self, kinds: Collection[str]) -> Preset:
        """This preset, under the same name, without pools other than `path` and `kinds`."""
        return replace(self, pools=tuple(p for p in self.pools if p == "path" or p in kinds))


PRESETS = {
    preset.name: preset
    for preset in (
        Preset("tiny", "tests", (96, 96), 4, 16, ("temple", "city"), pools=PATH_AND_RESTIR),
        Preset(
            "mini",
            "the first command: about 4 minutes on two cores",
            (192, 192),
            8,
            64,
            pools=PATH_AND_RESTIR,
        ),
        # a ceiling of 33 dB changes a score of 23 dB by 0.4 dB for all methods, not mse_debiased
        Preset(
            "standard",
            "a workstation: all takes",
            (256, 256),
            20,
            32,
            takes="all",
            min_noise_ceiling_db=33.0,
            max_reference_rounds=12,
            pools=PATH_AND_RESTIR,
        ),
        Preset(
            "takes",
            "static cameras, cuts, switched lights: all takes, in half an hour on two cores",
            (160, 160),
            20,
            32,
            takes="all",
            min_noise_ceiling_db=30.0,
            max_reference_rounds=4,
            pools=PATH_AND_RESTIR,
        ),
        # main takes only, as in the paper: a clip has 10^10 paths, three hours on two cores
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
            pools=PATH_AND_RESTIR,
        ),
        # halves of 32 spp: a noise ceiling of 33 dB, for 150 scenes in the time of 50
        Preset(
            "train-eventful",
            "training: many generated scenes with switched lights, cuts and fast motion",
            (128, 128),
            12,
            32,
            (),
            tuple(range(128, 278)),
            generator="eventful",
            is_test_set=False,
        ),
        Preset(
            "train-hard",
            "training: furnished interiors with indirect light, small lamps, metals and glass",
            (160, 160),
            8,
            32,
            (),
            tuple(range(1000, 1120)),
            generator="hard",
            is_test_set=False,
            min_noise_ceiling_db=32.0,
            max_reference_rounds=4,
        ),
        Preset(
            "development",
            "decisions while developing: generated scenes, neither trained on nor reported",
            (160, 160),
            5,
            64,
            (),
            tuple(range(40, 56)),
        ),
        Preset(
            "unseen",
            "many clips, so that small differences show: generated scenes kept from training",
            (160, 160),
            5,
            64,
            (),
            tuple(range(400, 448)),
        ),
    )
}


def is_test_split(preset: str) -> bool:
    """Are clips of this preset scored, and never trained on? True for presets of other packages.

    >>> is_test_split("unseen"), is_test_split("train"), is_test_split("")
    (True, False, False)
    """
    return bool(preset) and (preset not in PRESETS or PRESETS[preset].is_test_set)


def get_preset(name: str) -> Preset:
    """The preset called `name`. Raises UnknownPresetError, which lists all presets."""
    if name not in PRESETS:
        raise UnknownPresetError(unknown_name(f"no preset '{name}'", name, PRESETS))
    return PRESETS[name]
