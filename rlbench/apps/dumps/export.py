"""Write the noisy input and the buffers of a clip for denoisers outside of this suite.

Each frame has the mean of its first samples, in linear radiance as in the clip's files (not
exposed). Files are atomic, so a second call writes only what is missing. `export.toml` says what
was written, in which convention, and what a denoiser may want that a clip does not have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from numpy import ndarray as Array

from rlbench.clips.exr import write_exr
from rlbench.clips.header import STANDARD_BUFFERS, ClipError, read_header
from rlbench.clips.pfm import write_pfm
from rlbench.clips.stored import StoredClip, open_clip
from rlbench.ops.color import encode_srgb
from rlbench.system.documents import read_toml, write_toml

RECORD = "export.toml"
NRD_SKY, BLENDER_SKY = 1e5, 1e10  # depth of the background: INF of NRD-Sample, and of Cycles
MIN_ALBEDO = 1e-3  # darker channels are not divided: their light counts as emitted
LAYER = "ViewLayer"  # Blender's name of the only layer

Image = Float32[Array, "h w c"]
Images = Mapping[str, Image]  # radiance, the buffers that the clip has, reference halves A and B


def _write_oidn(folder: Path, frame: str, images: Images) -> None:
    names = {"reference": "reference", "albedo": "albedo", "normal": "normal", "radiance": "color"}
    for name, file in names.items():
        if name in images:
            write_pfm(folder / f"{file}.{frame}.pfm", images[name])


def _write_nrd(folder: Path, frame: str, images: Images) -> None:
    """The textures of NRD-Sample, as the layout `nrd-sample` of rlbench import reads them."""
    radiance, albedo = images["radiance"], images.get("albedo")
    divisor = np.ones_like(radiance) if albedo is None else albedo
    is_divided = divisor > MIN_ALBEDO
    irradiance = np.where(is_divided, radiance / np.maximum(divisor, MIN_ALBEDO), 0)
    one = np.ones_like(radiance[..., :1])
    textures = {"DirectLighting": np.where(is_divided, 0, radiance)}
    if albedo is not None:
        base = encode_srgb(torch.from_numpy(albedo)).numpy()
        textures["IN_BASECOLOR_METALNESS"] = np.concatenate([base, 0 * one], -1)
    if "normal" in images:
        textures["IN_NORMAL_ROUGHNESS"] = np.concatenate([images["normal"], one], -1)
    if "depth" in images:
        textures["IN_VIEWZ"] = np.where(np.isposinf(images["depth"]), NRD_SKY, images["depth"])
    if "motion" in images:
        textures["IN_MV"] = images["motion"]
    textures["IN_DIFF_RADIANCE_HITDIST"] = np.concatenate([irradiance, 0 * one], -1)
    _write_references(folder, frame, images, prefix="")
    for name, pixels in textures.items():
        letters = "RGBA"[: pixels.shape[-1]]
        planes = dict(zip(letters, _split(pixels), strict=True))
        write_exr(folder / f"{name}.{frame}.exr", _planes(planes))


def _write_exr(folder: Path, frame: str, images: Images) -> None:
    """One multilayer file a frame, as the layout `blender` of rlbench import reads it."""
    layers = {"Combined": ("RGB", images["radiance"])}
    if "albedo" in images:
        layers["Denoising Albedo"] = "RGB", images["albedo"]
    if "normal" in images:
        layers["Normal"] = "XYZ", images["normal"]
    if "depth" in images:
        depth = images["depth"]
        layers["Depth"] = "Z", np.where(np.isposinf(depth), BLENDER_SKY, depth)
    if "motion" in images:
        layers["Vector"] = "XY", images["motion"] * np.array([1, -1], np.float32)
    planes = {
        f"{LAYER}.{name}.{letter}": plane
        for name, (letters, pixels) in layers.items()
        for letter, plane in zip(letters, _split(pixels), strict=True)
    }
    _write_references(folder, frame, images, prefix=f"{LAYER}.Combined.")
    write_exr(folder / f"{frame}.exr", _planes(planes))


def _write_references(folder: Path, frame: str, images: Images, prefix: str) -> None:
    for half in "AB":
        if half in images:
            planes = {f"{prefix}{c}": p for c, p in zip("RGB", _split(images[half]), strict=True)}
            write_exr(folder / f"reference{half}" / f"reference.{frame}.exr", _planes(planes))


def _split(pixels: Image) -> Array:
    return np.moveaxis(pixels, -1, 0)


def _planes(channels: Mapping[str, Array]) -> dict[str, Array]:
    return {name: np.asarray(plane, np.float32) for name, plane in channels.items()}


@dataclass(frozen=True)
class ExportFormat:
    """A set of files, and what its reader must know."""

    inputs: tuple[str, ...]  # buffers that are written, where the clip has them
    write: Callable[[Path, str, Images], None]
    last_file: str  # of a frame, with {frame}: where it exists, the frame is complete
    notes: tuple[str, ...]


ALL_BUFFERS = tuple(STANDARD_BUFFERS)
FORMATS = {
    "oidn": ExportFormat(
        ("albedo", "normal"),
        _write_oidn,
        "color.{frame}.pfm",
        (
            "color: linear radiance, HDR; albedo in [0, 1]; normal in world space, [-1, 1], 0 for "
            "background; rows from the bottom, as PFM has them",
            "run: oidnDenoise --hdr color.0000.pfm --alb albedo.0000.pfm --nrm normal.0000.pfm "
            "-o out/0000.pfm",
        ),
    ),
    "nrd": ExportFormat(
        ALL_BUFFERS,
        _write_nrd,
        "IN_DIFF_RADIANCE_HITDIST.{frame}.exr",
        (
            "IN_DIFF_RADIANCE_HITDIST: all light, divided by albedo; linear RGB, as RELAX takes it "
            "(REBLUR packs YCoCg). A is 0: a clip has no hit distance",
            "DirectLighting: light of pixels and channels without albedo, such as emitters and "
            "sky. The image is OUT_DIFF_RADIANCE_HITDIST * albedo + DirectLighting",
            "IN_SPEC_RADIANCE_HITDIST is left out: a clip does not split diffuse from specular. "
            "Use a denoiser of diffuse light",
            "IN_BASECOLOR_METALNESS: albedo, sRGB-encoded; metalness is 0, since it is unknown",
            "IN_NORMAL_ROUGHNESS: world-space normal in [-1, 1], for RGBA16_SNORM; roughness is 1, "
            "since it is unknown",
            f"IN_VIEWZ: distance along the view axis, {NRD_SKY:g} for background",
            "IN_MV: pixels, previous minus current position, y down: motionVectorScale is "
            "{1 / width, 1 / height, 0}; unjittered",
            "the camera's matrices, which NRD also takes, are not in a clip",
        ),
    ),
    "exr": ExportFormat(
        ALL_BUFFERS,
        _write_exr,
        "{frame}.exr",
        (
            "layers as Blender names them: Combined (linear radiance), Denoising Albedo, Normal "
            f"(world space), Depth (along the view axis, {BLENDER_SKY:g} for background)",
            "Vector: X, Y in pixels, previous minus current position, y up; Z and W, motion to the "
            "next frame, are left out",
        ),
    ),
}


def export_clip(
    source: Path,
    folder: Path,
    name: str,
    spp: int = 1,
    seed: int = 0,
    *,
    with_reference: bool = False,
    on_frame: Callable[[], None] = lambda: None,
) -> tuple[str, ...]:
    """Write the clip in `source` into `folder` in the format `name`; returns what to know of it.

    The samples are the first `spp` of each pixel that a uniform method buys with this `seed`. Calls
    `on_frame` after each frame. Raises ClipError where the clip has fewer samples, or where the
    folder holds another export.
    """
    chosen = FORMATS[name]
    header = read_header(source)
    if spp > header.pool_spp:
        raise ClipError(
            f"clip {source} stores {header.pool_spp} samples per pixel, {spp} were requested"
        )
    buffers = [each for each in chosen.inputs if each in header.buffers]
    buffers = [each for each in buffers if each != "motion" or not header.static]
    absent = [each for each in chosen.inputs if each not in buffers]
    notes = (*chosen.notes, *(f"{each} is left out: the clip has none" for each in absent))
    clip = open_clip(source, frozenset(buffers), spp, seed=seed)
    record = {
        "clip": header.name,
        "digest": clip.digest,
        "format": name,
        "spp": spp,
        "seed": seed,
        "exposure": header.exposure,
        "reference": with_reference,
        "notes": notes,
    }
    _claim(folder, record)
    for index in range(header.frames):
        if not (folder / chosen.last_file.format(frame=f"{index:04}")).is_file():
            images = _read_images(clip, index, with_reference)
            chosen.write(folder, f"{index:04}", images)
        on_frame()
    return notes


def _claim(folder: Path, record: Mapping[str, object]) -> None:
    """Write the record of an export. Raises ClipError where the folder holds another."""
    file = folder / RECORD
    stored = read_toml(file) if file.is_file() else None
    if stored is None:
        write_toml(file, record)
    elif stored != {key: list(v) if isinstance(v, tuple) else v for key, v in record.items()}:
        raise ClipError(
            f"{folder} holds another export: {stored.get('format')} of {stored.get('clip')} at "
            f"{stored.get('spp')} spp. Use another --out, or remove it"
        )


def _read_images(clip: StoredClip, index: int, with_reference: bool) -> dict[str, Image]:
    """Radiance, buffers and reference of a frame, in the units of the clip's files."""
    frame, exposure = clip.frame(index), clip.header.exposure
    pool = frame.pool
    counts = torch.full_like(pool.empty().counts, pool.max_samples)
    images = {"radiance": pool.read(pool.empty(), counts).mean(1) / exposure}
    images |= frame.gbuffer.buffers
    if with_reference:
        reference = frame.reference
        images |= {"A": reference.half_a / exposure, "B": reference.half_b / exposure}
        images["reference"] = reference.mean / exposure
    return {k: np.ascontiguousarray(v[0].movedim(0, -1).numpy()) for k, v in images.items()}
