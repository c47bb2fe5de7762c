"""What to render, as data: scenes, sizes, and samples for pools and references."""

from __future__ import annotations

from dataclasses import dataclass

FOUR = ("city", "temple", "hall", "ripples")
GENERATED = "generated"  # clips of rlbench.scenes.generator are named generated-<seed>


@dataclass(frozen=True)
class Preset:
    """One set of clips. A reference is two halves, so it has twice `reference_spp` samples."""

    name: str
    purpose: str
    size: tuple[int, int]  # pixels: height, width
    frames: int  # of each clip
    reference_spp: int  # samples per pixel of each half of the reference
    scenes: tuple[str, ...] = FOUR  # by entry point of the group rlbench.scenes
    seeds: tuple[int, ...] = ()  # of generated training scenes
    pool_spp: int = 8  # stored 1-spp images per frame

    @property
    def clip_samples(self) -> int:
        """Light paths that one clip costs."""
        return self.frames * self.frame_samples

    @property
    def frame_samples(self) -> int:
        """Light paths that one frame costs: those of the pool and of both reference halves."""
        return self.size[0] * self.size[1] * (self.pool_spp + 2 * self.reference_spp)

    @property
    def samples(self) -> int:
        """Light paths that the whole preset costs; two cores trace about a million a second."""
        return self.clip_samples * (len(self.scenes) + len(self.seeds))


PRESETS = {
    preset.name: preset
    for preset in (
        Preset("tiny", "tests", (96, 96), 4, 16, ("temple", "city")),
        Preset("mini", "the first command: about 3 minutes on two cores", (192, 192), 8, 64),
        Preset("standard", "a workstation", (256, 256), 20, 256),
        Preset("paper", "the paper's protocol: 1000 spp references", (720, 720), 20, 500),
        Preset("train", "training: generated scenes", (160, 160), 5, 64, (), tuple(range(28))),
    )
}


def preset(name: str) -> Preset:
    """The preset of that name. Raises LookupError, which lists those that exist."""
    if name not in PRESETS:
        raise LookupError(f"no preset '{name}'; there are: {', '.join(PRESETS)}")
    return PRESETS[name]
