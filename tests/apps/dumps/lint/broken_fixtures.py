"""A correct clip, how to store it, and its faulty versions with the check that must fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.clips.exr import write_exr
from rlbench.clips.frame_files import exr_path, write_frame
from rlbench.clips.header import Header, write_header
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from tests.apps.dumps.importers.dumps import camera_axes, ray_length

POOL, HALF = 8, 256  # samples of the pool, and of each half of the reference
Fault = Callable[[ClipArrays], ClipArrays]


def correct_clip(
    seed: int = 0, height: int = 72, width: int = 96, frames: int = 4, half: int = HALF
) -> ClipArrays:
    """A procedural clip whose reference halves are means of samples outside the pool."""
    clip = procedural_clip(seed, Size(1, height, width), frames, POOL + 2 * half, speed=1.5)
    rendered = list(clip)
    samples = torch.cat([frame.pool.radiance for frame in rendered])
    parts = samples.split([POOL, half, half], 1)
    gbuffer = {
        k: torch.cat([f.gbuffer.buffers[k] for f in rendered]) for k in rendered[0].gbuffer.buffers
    }
    header = Header(
        name=f"correct-{seed}",
        scene="procedural",
        sampler="torch",
        height=height,
        width=width,
        frames=frames,
        reference_spp=(2 * half,) * frames,
        exposure=0.5,
    )
    return ClipArrays(header, gbuffer, {"path": parts[0]}, parts[1].mean(1), parts[2].mean(1))


def store(arrays: ClipArrays, folder: Path) -> Path:
    """Write the arrays as a clip folder, with the writers that every clip uses."""

    def channels_last(image: torch.Tensor) -> np.ndarray:
        return image.movedim(-3, -1).numpy()

    for i in range(len(arrays)):
        gbuffer = {name: channels_last(image[i]) for name, image in arrays.gbuffer.items()}
        pools = {kind: channels_last(pool[i]) for kind, pool in arrays.pools.items()}
        halves = channels_last(arrays.half_a[i]), channels_last(arrays.half_b[i])
        write_frame(folder, i, gbuffer, pools, *halves)
    write_header(folder, arrays.header)
    return folder


def break_values(folder: Path, arrays: ClipArrays) -> None:
    """Write half A of frame 1 with a NaN and an infinity, which the clip writers refuse."""
    image = arrays.half_a[1].clone()
    image[0, 3, 5], image[2, 4, 6] = torch.nan, torch.inf
    planes = dict(zip("RGB", image.numpy(), strict=True))
    write_exr(exr_path(folder, "referenceA", 1), planes)


def change_buffer(name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> Fault:
    """Change one buffer of the G-buffer."""
    return lambda f: replace(f, gbuffer={**f.gbuffer, name: change(f.gbuffer[name])})


def change_pool(change: Callable[[torch.Tensor], torch.Tensor]) -> Fault:
    """Change the samples [t s 3 h w]."""
    return lambda f: replace(f, pools={"path": change(f.pools["path"])})


def change_header(**fields: object) -> Fault:
    """Change fields of clip.toml."""
    return lambda f: replace(f, header=replace(f.header, **fields))


def scale_motion(x: float, y: float) -> Fault:
    """Scale the motion's axes."""
    return change_buffer("motion", lambda m: m * torch.tensor([x, y]).view(1, 2, 1, 1))


def motion_to_next_frame(arrays: ClipArrays) -> ClipArrays:
    """Motion to the next frame: for a steady camera nearly the negative of that frame's motion."""
    later = arrays.gbuffer["motion"].roll(-1, 0)
    return change_buffer("motion", lambda _: -later)(arrays)


def still_sky(arrays: ClipArrays) -> ClipArrays:
    """As Cycles writes it: no motion where nothing is hit."""
    motion = arrays.gbuffer["motion"].where(arrays.gbuffer["depth"].isfinite(), 0.0)
    return replace(arrays, gbuffer={**arrays.gbuffer, "motion": motion})


def distance_to_camera(arrays: ClipArrays) -> ClipArrays:
    return change_buffer("depth", lambda d: d * ray_length(*d.shape[-2:]))(arrays)


def normalised_depth(arrays: ClipArrays) -> ClipArrays:
    """Depth divided by the largest of each frame."""
    most = arrays.gbuffer["depth"].where(arrays.surface_mask, 0.0).amax((1, 2, 3), keepdim=True)
    return change_buffer("depth", lambda d: d / most)(arrays)


def camera_space_normals(arrays: ClipArrays) -> ClipArrays:
    axes = camera_axes(arrays)
    return change_buffer("normal", lambda n: torch.einsum("tkc,tchw->tkhw", axes, n))(arrays)


def upside_down(arrays: ClipArrays) -> ClipArrays:
    """The G-buffer flipped, including the sign of motion, with radiance unchanged."""
    flipped = {name: image.flip(-2) for name, image in arrays.gbuffer.items()}
    flipped["motion"] = flipped["motion"] * torch.tensor([1.0, -1.0]).view(1, 2, 1, 1)
    return replace(arrays, gbuffer=flipped)


def mixed_samples(samples: torch.Tensor) -> torch.Tensor:
    """Sample 1 has half of its pixels, in a checkerboard, from sample 0."""
    h, w = samples.shape[-2:]
    board = (torch.arange(h)[:, None] + torch.arange(w)) % 2 == 0
    mixed = samples.clone()
    mixed[:, 1] = torch.where(board, samples[:, 0], samples[:, 1])
    return mixed


def shared_noise(arrays: ClipArrays) -> ClipArrays:
    """All samples of a pixel share half of their noise."""
    samples = arrays.pools["path"]
    shared = samples.roll(1, 1)[:, :1] - arrays.reference[:, None]
    truth = arrays.reference[:, None]
    return change_pool(lambda p: (truth + 0.5 * (p - truth) + 0.5 * shared).clamp_min(0))(arrays)


def tent_filtered(samples: torch.Tensor) -> torch.Tensor:
    """A tent over neighbouring pixels."""
    from torch.nn import functional as F

    flat = samples.flatten(0, 1)
    return F.avg_pool2d(F.pad(flat, (1, 1, 1, 1), mode="replicate"), 3, 1).view_as(samples)


def same_seed(arrays: ClipArrays) -> ClipArrays:
    """The noise of frame 0, as a factor, in every frame."""
    factor = arrays.pools["path"][:1] / arrays.reference[:1, None].clamp_min(1e-3)
    return change_pool(lambda _: arrays.reference[:, None] * factor)(arrays)


def shared_seeds(arrays: ClipArrays) -> ClipArrays:
    """Half A contains the samples of the pool."""
    total = arrays.half_a * (HALF - POOL) + arrays.pools["path"].sum(1)
    return replace(arrays, half_a=total / HALF)


def filtered_reference(arrays: ClipArrays) -> ClipArrays:
    smooth = [tent_filtered(half[:, None])[:, 0] for half in (arrays.half_a, arrays.half_b)]
    return replace(arrays, half_a=smooth[0], half_b=smooth[1])


def negative_radiance(arrays: ClipArrays) -> ClipArrays:
    changed = arrays.half_b.clone()
    changed[2, 1, 7, 9] = -0.02
    return replace(arrays, half_b=changed)


def noisy_reference(arrays: ClipArrays) -> ClipArrays:
    """A reference of 2 samples, as in clip.toml."""
    drawn = correct_clip(int(arrays.header.name.rsplit("-", 1)[1]), half=1)
    return replace(drawn, header=drawn.header)


def ndc_motion(arrays: ClipArrays) -> ClipArrays:
    return scale_motion(2 / arrays.header.width, 2 / arrays.header.height)(arrays)


def negative_y(normals: torch.Tensor) -> torch.Tensor:
    return normals * torch.tensor([1.0, -1.0, 1.0]).view(1, 3, 1, 1)


FAULTS: dict[str, dict[str, Fault]] = {  # by the check that must fail
    "motion": {
        "y points up": scale_motion(1, -1),
        "it is negated": scale_motion(-1, -1),
        "y is its first channel": change_buffer("motion", lambda m: m.flip(1)),
        "it is in NDC": ndc_motion,
        "it is doubled": scale_motion(2, 2),
        "it points to the next frame": motion_to_next_frame,
        "it is zero": scale_motion(0, 0),
        "a moving clip is declared static": change_header(static=True),
    },
    "sky motion": {"the sky does not move": still_sky},
    "depth": {
        "it is the distance to the camera": distance_to_camera,
        "it is normalised": normalised_depth,
        "it is inverse": change_buffer("depth", lambda d: 1 / d + 1e-6),
        "background is a large number": change_buffer("depth", lambda d: d.nan_to_num(posinf=1e10)),
    },
    "normal": {
        "they are in camera space": camera_space_normals,
        "they are encoded in 0..1": change_buffer("normal", lambda n: n * 0.5 + 0.5),
        "they are not of unit length": change_buffer("normal", lambda n: n * 0.8),
        "they are mirrored": change_buffer("normal", negative_y),
    },
    "albedo": {
        "it is sRGB": change_buffer("albedo", lambda a: a ** (1 / 2.2)),
        "it is in 0..255": change_buffer("albedo", lambda a: a * 255),
        "it is black": change_buffer("albedo", torch.zeros_like),
    },
    "orientation": {
        "the G-buffer is upside down": upside_down,
        "the samples are mirrored": change_pool(lambda p: p.flip(-1)),
    },
    "sample independence": {
        "a sample is stored twice": change_pool(lambda p: torch.cat((p[:, :-1], p[:, :1]), 1)),
        "two samples share half of their pixels": change_pool(mixed_samples),
        "all samples share noise": shared_noise,
    },
    "noise pattern": {
        "samples are filtered": change_pool(tent_filtered),
        "all frames have the same seed": same_seed,
    },
    "independent seeds": {"half A contains the pool": shared_seeds},
    "brightness": {"samples are half as bright": change_pool(lambda p: p / 2)},
    "reference halves": {
        "they overlap": lambda f: replace(f, half_b=f.half_a * 0.7 + f.half_b * 0.3),
        "they are equal": lambda f: replace(f, half_b=f.half_a),
        "the reference is filtered": filtered_reference,
    },
    "non-negative radiance": {"a reference is negative": negative_radiance},
    "noise ceiling": {"the reference is noisy": noisy_reference},
    "exposure": {
        "it is a thousand times too high": change_header(exposure=1e4),
        "it is far too low": change_header(exposure=1e-5),
    },
}
