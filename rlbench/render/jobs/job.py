"""One clip to be rendered: what of it is there, and whether that is of this very scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from rlbench.clips.header import FILE, Header, version_1_names
from rlbench.clips.stored import ClipError, has_frame
from rlbench.frames import BUFFERS
from rlbench.render.fingerprint import fingerprint
from rlbench.render.jobs.references import NOTES, noted, stored_ceiling_db
from rlbench.render.presets import Preset
from rlbench.render.scene import Scene
from rlbench.system import paths
from rlbench.system.provenance import machine

POOLS = ("path",)
MARK = "scene.txt"  # beside the frames: what they were rendered from


@dataclass(frozen=True, eq=False)
class Job:
    """One clip to be rendered into a folder."""

    name: str
    scene: Scene
    preset: Preset
    folder: Path

    @property
    def buffers(self) -> tuple[str, ...]:
        """The view buffers to write: where nothing moves, there is no motion."""
        names = (*BUFFERS, *self.preset.extras)
        return tuple(b for b in names if not (self.scene.static and b == "motion"))

    @property
    def missing(self) -> list[int]:
        """Frames that are not wholly there, or are of another scene or preset."""
        ours = marked(self.folder) == self.content_key
        return [i for i in range(self.preset.frames) if not (ours and self._there(i))]

    def _there(self, index: int) -> bool:
        return has_frame(self.folder, index, POOLS) and self.reference_spp(index) > 0

    def reference_spp(self, index: int) -> int:
        """Samples per pixel of a frame's reference, both halves; 0 where that is not known."""
        if self.preset.max_reference_rounds == 1:
            return 2 * self.preset.reference_spp
        return noted(self.folder, index) or 0

    @property
    def content_key(self) -> str:
        """What the frames are rendered from; frames of another mark do not belong here."""
        plan = self.preset
        samples = f"{plan.pool_spp} + 2 x {plan.reference_spp} spp"
        size = "x".join(map(str, plan.size))
        samples += f", up to {plan.max_reference_rounds} rounds to {plan.ceiling_db:g} dB" * (
            plan.max_reference_rounds > 1
        )
        samples += f", cap {plan.cap:g}" * (plan.cap < math.inf)
        samples += f", with {' '.join(version_1_names(plan.extras))}" * bool(plan.extras)
        return f"{fingerprint(self.scene, plan.frames)} {size} {plan.frames} frames {samples}\n"

    @property
    def finished(self) -> bool:
        """Is there a header, and every frame, of this very scene?"""
        return (self.folder / FILE).is_file() and not self.missing

    def header(
        self,
        sampler: str,
        version: str,
        sample_ms: float,
        seed: int = 0,
        stratified: bool = False,
    ) -> Header:
        """What clip.toml says of the clip, whose frames are all there.

        The arguments are what only the tracer knows: its name, version, time of a sample (nan: not
        known) and seed, and whether samples of a half of the reference follow a pattern.
        """
        plan, scene = self.preset, self.scene
        return Header(
            name=self.name,
            scene=scene.name,
            preset=plan.name,
            sampler=sampler,
            sampler_version=version,
            height=plan.size[0],
            width=plan.size[1],
            frames=plan.frames,
            seed=seed,
            exposure=scene.exposure,
            pool_spp=plan.pool_spp,
            radiance_cap=plan.cap,
            reference_spp=tuple(map(self.reference_spp, range(plan.frames))),
            stratified=stratified,
            noise_ceiling_db=tuple(
                stored_ceiling_db(self.folder, index, *plan.size, scene.exposure)
                for index in range(plan.frames)
            ),
            buffers=self.buffers,
            pools=POOLS,
            static=scene.static,
            cuts=tuple(cut for cut in scene.cuts if cut < plan.frames),
            licence=scene.licence,
            sample_ms=sample_ms,
            device=machine().name,
        )

    def claim(self) -> None:
        """Say what the frames of a folder are, after removing those of another scene or preset.

        Raises ClipError where there are frames that bear no mark, for they are not ours to remove.
        """
        files = [self.folder / FILE, *self.folder.glob("*.exr"), *self.folder.glob(NOTES)]
        kept = [file for file in files if file.is_file()]
        if marked(self.folder) == self.content_key:
            return
        if kept and not marked(self.folder):
            raise ClipError(
                f"{self.folder} holds frames that `rlbench render` did not write; "
                "move the folder away, or render into another"
            )
        for file in kept:
            file.unlink()
        with paths.replacing(self.folder / MARK) as path:
            path.write_text(self.content_key)


def marked(folder: Path) -> str:
    """What a folder's frames were rendered from, or empty where `rlbench render` wrote none."""
    mark = folder / MARK
    return mark.read_text() if mark.is_file() else ""
