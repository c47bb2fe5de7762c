"""Presets: named sets of clips with their scenes, sizes and sample counts."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from rlbench.clips.header import OPTIONAL_BUFFERS
from rlbench.errors import RlbenchError
from rlbench.registry.near_names import unknown_name

TEST_SCENES = ("city", "temple", "hall", "ripples")
REAL_SCENES = (  # by others, complete
    "living-room", "classroom", "staircase2", "veach-mis", "cornell_box_picture",
    "isometric-room", "office-room", "low-poly-jungle-scene", "shanghai", "snowy-hut",
)  # fmt: skip
REAL = tuple(f"{name}-{seed:03d}" for seed in range(2) for name in REAL_SCENES)
REAL_CHECK = ("dining-room", "bathroom2", "staircase", "veach-bidir")
# a scene that no training sees, and other paths in two that it sees
REAL_DEVELOPMENT = (
    *(f"living-room-2-{seed:03d}" for seed in range(8)),
    *(f"bathroom-{seed:03d}" for seed in range(100, 104)),
    *(f"kitchen-{seed:03d}" for seed in range(100, 104)),
)
TRAIN_REAL = tuple(
    f"{name}-{seed:03d}"
    for name, paths in (("bathroom", 12), ("kitchen", 12), ("spaceship", 4))
    for seed in range(paths)
)
REAL_DEVELOPMENT_LARGE = (
    "living-room-2-000", "living-room-2-001", "living-room-2-005", "bathroom-102", "kitchen-101",
)  # fmt: skip
SIZE = r"-([1-9]\d*)x([1-9]\d*)"  # in the name of a preset at another size: width and height
VARIANT = r"-(cap[^-]*|views)"  # in the name of a preset with a radiance cap or extra buffers
SPEEDS = (3.0, 1.0, 2.0)  # of clips of 640x360, whose motion so reaches 30 pixels a frame
# presets of which NAME-windows exists
WINDOWED = ("train", "train-hard", "train-eventful", "train-real")
WINDOW_FRAMES = 12  # of their clips, at least
PATH_AND_RESTIR = ("path", "restir")  # entry points in the group rlbench.pools
GENERATORS = ("generated", "eventful", "hard")  # scenes that take a seed; clips <name>-<seed>
TakeSelection = Literal["main", "all"]
PresetUse = Literal["train", "decide", "report"]


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
    # what its clips may be used for: to train, to decide while developing, or to be reported alone
    uses: tuple[PresetUse, ...] = ("report",)
    takes: TakeSelection = "main"  # clips per scene: the main one, or one for each take as well
    pool_spp: int = 8  # stored 1-spp images per frame
    radiance_cap: float = math.inf  # upper bound of each sample, in display whites
    # PSNR: more rounds of the reference follow until it is reached
    min_noise_ceiling_db: float = math.inf
    max_reference_rounds: int = 1
    # others come from plugins, where this machine can trace them
    pools: tuple[str, ...] = ("path",)
    extra_buffers: tuple[str, ...] = ()  # G-buffer channels beside those that every clip has
    speeds: tuple[float, ...] = (1.0,)  # factors on all motion, dealt to clips by their seed
    windows: bool = False  # True: a clip shows a window of a larger frame

    @property
    def is_test_set(self) -> bool:
        """True if its clips are scored, and never trained on."""
        return "train" not in self.uses

    @property
    def scene_names(self) -> tuple[str, ...]:
        """The names of its scenes; a generated one is called after its generator and seed."""
        return (*self.scenes, *(f"{self.generator}-{seed:03d}" for seed in self.seeds))

    def clip_names(
        self, scenes: Iterable[str] | None = None, seeds: Iterable[int] | None = None
    ) -> list[str]:
        """The names of its scenes and generated clips, or those of other `scenes` and `seeds`.

        If only one of the two is given, the other is empty.
        """
        if scenes is None and seeds is None:
            scenes, seeds = self.scenes, self.seeds
        return [*(scenes or ()), *(f"{self.generator}-{seed:03d}" for seed in seeds or ())]

    @property
    def paths_per_frame(self) -> int:
        """Upper bound of light paths per frame: the pool and all rounds of both halves.

        Two CPU cores trace about a million a second.
        """
        spp = self.pool_spp + 2 * self.reference_spp * self.max_reference_rounds
        return self.size[0] * self.size[1] * spp

    def speed(self, clip: str) -> float:
        """The factor on the motion of a clip, by the seed in its name; 1 without a seed."""
        seed = clip.rpartition("-")[2]
        return self.speeds[int(seed) % len(self.speeds)] if seed.isdecimal() else 1.0

    def with_size(self, size: tuple[int, int]) -> Preset:
        """This preset with frames of `size` pixels (height, width) and a name of its own.

        A preset of that name that has clips of its own is preferred.

        >>> PRESETS["mini"].with_size((360, 640)).name
        'mini-640x360'
        >>> PRESETS["development"].with_size((360, 640)).frames
        8
        """
        if size == self.size:
            return self
        base = PRESETS.get(re.sub(SIZE, "", self.name), self)
        name = f"{base.name}-{size[1]}x{size[0]}"
        if size == base.size:
            return base
        return PRESETS.get(name) or replace(base, name=name, size=size)

    def with_windows(self) -> Preset:
        """This preset whose clips show windows of larger frames, under a name of its own.

        >>> PRESETS["train"].with_windows().name
        'train-windows'
        """
        return replace(
            self, name=f"{self.name}-windows", windows=True, frames=max(self.frames, WINDOW_FRAMES)
        )

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


# fmt: off
_ROWS = (
    Preset("tiny", "tests", (96, 96), 4, 16, ("temple", "city"), pools=PATH_AND_RESTIR),
    Preset("mini", "the first command: about 4 minutes on two cores",
           (192, 192), 8, 64, pools=PATH_AND_RESTIR),
    # a ceiling of 33 dB changes a score of 23 dB by 0.4 dB for all methods, not mse_debiased
    Preset("standard", "a workstation: all takes", (256, 256), 20, 32, takes="all",
           min_noise_ceiling_db=33.0, max_reference_rounds=12, pools=PATH_AND_RESTIR),
    Preset("takes",
           "static cameras, cuts, switched lights: all takes, in half an hour on two cores",
           (160, 160), 20, 32, takes="all",
           min_noise_ceiling_db=30.0, max_reference_rounds=4, pools=PATH_AND_RESTIR),
    # main takes only, as in the paper: a clip has 10^10 paths, three hours on two cores
    Preset("paper", "the paper's protocol: 1000 spp references", (720, 720), 20, 500),
    # up to 10^9 paths a frame: two cores take a quarter of an hour for it
    Preset("hd", "a GPU: frames of 1080p; further scenes by --scenes, other presets by --size",
           (1080, 1920), 8, 32, min_noise_ceiling_db=31.0, max_reference_rounds=8),
    Preset("train", "training: generated scenes", (160, 160), 5, 64, (), tuple(range(28)),
           uses=("train", "decide"), pools=PATH_AND_RESTIR),
    # halves of 32 spp: a noise ceiling of 33 dB, for 150 scenes in the time of 50
    Preset("train-eventful",
           "training: many generated scenes with switched lights, cuts and fast motion",
           (128, 128), 12, 32, (), tuple(range(128, 278)), "eventful", ("train", "decide")),
    Preset("train-hard",
           "training: furnished interiors with indirect light, small lamps, metals and glass",
           (160, 160), 8, 32, (), tuple(range(1000, 1120)), "hard", ("train",),
           min_noise_ceiling_db=32.0, max_reference_rounds=4),
    Preset("development",
           "decisions while developing: generated scenes, neither trained on nor reported",
           (160, 160), 5, 64, (), tuple(range(40, 56)), uses=("decide",)),
    Preset("real", "scenes by others, two random paths in each: reported, never decided on",
           (192, 192), 8, 32, REAL, min_noise_ceiling_db=31.0, max_reference_rounds=8),
    Preset("real-640x360", "the same scenes from their own cameras, at the size of a real frame",
           (360, 640), 8, 32, REAL_SCENES, min_noise_ceiling_db=31.0, max_reference_rounds=8),
    Preset("real-check", "further scenes by others, for a last check",
           (192, 192), 8, 32, REAL_CHECK, min_noise_ceiling_db=31.0, max_reference_rounds=8),
    # of the scenes of these two presets, files may be missing
    Preset("real-development", "decisions: random paths in scenes by others (rlbench scenes)",
           (160, 160), 8, 32, REAL_DEVELOPMENT, uses=("decide",),
           min_noise_ceiling_db=29.0, max_reference_rounds=4),
    Preset("development-long", "decisions on shots: does a memory gather errors (drift)?",
           (160, 160), 24, 64, (), tuple(range(52, 56)), uses=("decide",)),
    Preset("development-640x360", "decisions at the size of a real frame, with motion of users",
           (360, 640), 8, 32, (), tuple(range(40, 48)), uses=("decide",), speeds=SPEEDS,
           min_noise_ceiling_db=29.0, max_reference_rounds=4),
    Preset("real-development-640x360", "the same, in scenes by others",
           (360, 640), 8, 32, REAL_DEVELOPMENT_LARGE, uses=("decide",), speeds=SPEEDS,
           min_noise_ceiling_db=29.0, max_reference_rounds=4),
    Preset("train-real", "training: random paths in scenes by others",
           (160, 160), 8, 32, TRAIN_REAL, uses=("train",),
           min_noise_ceiling_db=29.0, max_reference_rounds=2),
    Preset("unseen",
           "many clips, so that small differences show: generated scenes kept from training",
           (160, 160), 5, 64, (), tuple(range(400, 448))),
)
# fmt: on
PRESETS = {
    preset.name: preset
    for preset in (*_ROWS, *(each.with_windows() for each in _ROWS if each.name in WINDOWED))
}


def is_test_split(preset: str) -> bool:
    """True if clips of this preset are scored, and never trained on, as of other packages.

    >>> is_test_split("unseen"), is_test_split("train-views"), is_test_split("")
    (True, False, False)
    """
    return bool(preset) and "train" not in _uses(preset)


def is_clip_for(use: PresetUse, preset: str, scene: str, name: str) -> bool:
    """True if a clip may be used so, by the preset, scene and name in its header.

    A clip of another scene, rendered at the size of a preset, does not belong to that preset.

    >>> is_clip_for("train", "mini", "hall", "hall-night"), is_clip_for("train", "", "mine", "mine")
    (False, True)
    >>> is_clip_for("train", "mini", "mine", "mine-orbit")
    True
    """
    known = PRESETS.get(_base(preset))
    labels = {scene, name, name.rpartition("-")[0]}  # the last one of a take
    is_foreign = known is not None and not labels & set(known.scene_names)
    return not preset or is_foreign or use in _uses(preset)


def _base(preset: str) -> str:
    """The preset of which a name with another size, windows, a cap or buffers is a variant."""
    return re.sub(rf"{VARIANT}|-windows|{SIZE}", "", preset)


def _uses(preset: str) -> tuple[PresetUse, ...]:
    known = PRESETS.get(_base(preset))
    return known.uses if known else ("report",)


def get_preset(name: str, size: tuple[int, int] | None = None) -> Preset:
    """The preset called `name`, or `name-WIDTHxHEIGHT`, at its own size or at `size`.

    Raises UnknownPresetError, which lists all presets.

    >>> get_preset("real-640x360") == get_preset("real", (360, 640))
    True
    """
    preset = find_preset(name)
    if preset is None:
        raise UnknownPresetError(unknown_name(f"no preset '{name}'", name, PRESETS))
    return preset.with_size(size) if size else preset


def preset_of_clip(name: str) -> Preset | None:
    """The preset in a clip's header, whose radiance cap and extra buffers are not known here."""
    return find_preset(re.sub(VARIANT, "", name))


def find_preset(name: str) -> Preset | None:
    """The preset of a name such as `mini` or `mini-640x360`; None if there is none."""
    base, sized = PRESETS.get(re.sub(f"{SIZE}$", "", name)), re.search(f"{SIZE}$", name)
    if name in PRESETS or not base or not sized:
        return PRESETS.get(name)
    return base.with_size((int(sized[2]), int(sized[1])))
