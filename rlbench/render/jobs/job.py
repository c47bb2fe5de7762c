"""A render job: one clip, which of its frames are missing, and what its frames depend on."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from rlbench.clips.header import FILE, Header, names_in_digests
from rlbench.clips.stored import ClipError, has_frame
from rlbench.frames import BUFFERS
from rlbench.render.fingerprint import fingerprint
from rlbench.render.jobs.references import SPP_FILES, read_spp, stored_noise_ceiling_db
from rlbench.render.presets import Preset
from rlbench.render.scene import Scene
from rlbench.system import paths
from rlbench.system.provenance import machine

__all__ = ["CONTENT_KEY_FILE", "FRAME_POOLS", "Job", "read_content_key"]

FRAME_POOLS = ("path",)  # pools that are traced with each frame; others are added to finished clips
CONTENT_KEY_FILE = "scene.txt"  # beside the frames


@dataclass(frozen=True, eq=False)
class Job:
    """One clip to render into a folder."""

    name: str
    scene: Scene
    preset: Preset
    folder: Path

    @property
    def buffers(self) -> tuple[str, ...]:
        """The G-buffer channels to write; a static scene has no motion."""
        names = (*BUFFERS, *self.preset.extra_buffers)
        return tuple(b for b in names if not (self.scene.static and b == "motion"))

    @property
    def missing_frames(self) -> list[int]:
        """Frames whose files are incomplete or were rendered with another content key."""
        is_ours = read_content_key(self.folder) == self.content_key
        return [i for i in range(self.preset.frames) if not (is_ours and self._is_complete(i))]

    def _is_complete(self, index: int) -> bool:
        return has_frame(self.folder, index, FRAME_POOLS) and self.reference_spp(index) > 0

    def reference_spp(self, index: int) -> int:
        """Samples per pixel of a frame's reference, both halves together; 0 if unknown."""
        if self.preset.max_reference_rounds == 1:
            return 2 * self.preset.reference_spp
        return read_spp(self.folder, index) or 0

    @cached_property
    def content_key(self) -> str:
        """Everything the pixels depend on, as one line of text.

        Frames that were rendered with another key are rendered again.
        """
        preset = self.preset
        samples = f"{preset.pool_spp} + 2 x {preset.reference_spp} spp"
        size = "x".join(map(str, preset.size))
        samples += (
            f", up to {preset.max_reference_rounds} rounds to {preset.min_noise_ceiling_db:g} dB"
        ) * (preset.max_reference_rounds > 1)
        samples += f", cap {preset.radiance_cap:g}" * (preset.radiance_cap < math.inf)
        samples += f", with {' '.join(names_in_digests(preset.extra_buffers))}" * bool(
            preset.extra_buffers
        )
        return f"{fingerprint(self.scene, preset.frames)} {size} {preset.frames} frames {samples}\n"

    def inspect(self) -> Job:
        """The job with its scene as it is rendered; see `Scene.inspect`."""
        return replace(self, scene=self.scene.inspect(self.preset.frames, self.preset.size))

    @property
    def is_finished(self) -> bool:
        """Does the folder hold a header and all frames with this content key?"""
        return (self.folder / FILE).is_file() and not self.missing_frames

    def make_header(
        self,
        sampler: str,
        version: str,
        sample_ms: float,
        seed: int = 0,
        stratified: bool = False,
    ) -> Header:
        """The header of the clip, whose frames must all be on disk.

        The tracer provides the arguments: its name, version, milliseconds per sample (nan if
        unknown), seed, and whether the samples of a reference half are stratified together.
        """
        preset, scene = self.preset, self.scene
        return Header(
            name=self.name,
            scene=scene.name,
            preset=preset.name,
            sampler=sampler,
            sampler_version=version,
            height=preset.size[0],
            width=preset.size[1],
            frames=preset.frames,
            seed=seed,
            exposure=scene.exposure,
            pool_spp=preset.pool_spp,
            radiance_cap=preset.radiance_cap,
            reference_spp=tuple(map(self.reference_spp, range(preset.frames))),
            stratified=stratified,
            noise_ceiling_db=tuple(
                stored_noise_ceiling_db(self.folder, index, *preset.size, scene.exposure)
                for index in range(preset.frames)
            ),
            buffers=self.buffers,
            pools=FRAME_POOLS,
            static=scene.static,
            missing_files=scene.missing_files,
            cuts=tuple(cut for cut in scene.cuts if cut < preset.frames),
            light_changes=scene.light_changes(preset.frames),
            licence=scene.licence,
            sample_ms=sample_ms,
            device=machine().name,
        )

    def claim_folder(self) -> None:
        """Remove frames with another content key from the folder and write this job's key.

        Raises ClipError if the folder holds frames without any key, which `rlbench render` did not
        write and must not delete.
        """
        files = [self.folder / FILE, *self.folder.glob("*.exr"), *self.folder.glob(SPP_FILES)]
        existing = [file for file in files if file.is_file()]
        if read_content_key(self.folder) == self.content_key:
            return
        if existing and not read_content_key(self.folder):
            raise ClipError(
                f"{self.folder} holds frames that `rlbench render` did not write; "
                "move that folder, or render into another one"
            )
        for file in existing:
            file.unlink()
        with paths.atomic_write(self.folder / CONTENT_KEY_FILE) as path:
            path.write_text(self.content_key)


def read_content_key(folder: Path) -> str:
    """The content key of the frames in a folder; empty if `rlbench render` did not write them."""
    file = folder / CONTENT_KEY_FILE
    return file.read_text() if file.is_file() else ""
