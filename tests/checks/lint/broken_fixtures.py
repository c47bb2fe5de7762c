"""A clean clip on disk, and every fault that can be planted in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.clips.exr import write_exr
from rlbench.clips.frame_files import exr_path
from rlbench.clips.procedural.clip import procedural
from rlbench.clips.stored import Header, write_frame, write_header
from rlbench.frames import Size

POOL, HALF = 8, 256  # samples of the pool, and of each half of the reference
Fault = Callable[[ClipArrays], ClipArrays]


def clean(
    seed: int = 0, height: int = 72, width: int = 96, frames: int = 4, half: int = HALF
) -> ClipArrays:
    """A procedural clip whose reference halves are means of other samples than the pool's."""
    clip = procedural(seed, Size(1, height, width), frames, POOL + 2 * half, speed=1.5)
    shots = list(clip)
    drawn = torch.cat([shot.pool.radiance for shot in shots])
    parts = drawn.split([POOL, half, half], 1)
    gbuffer = {
        k: torch.cat([s.gbuffer.buffers[k] for s in shots]) for k in shots[0].gbuffer.buffers
    }
    header = Header(
        name=f"clean-{seed}",
        scene="procedural",
        sampler="torch",
        height=height,
        width=width,
        frames=frames,
        reference_spp=(2 * half,) * frames,
        exposure=0.5,
    )
    return ClipArrays(header, gbuffer, {"path": parts[0]}, parts[1].mean(1), parts[2].mean(1))


def store(footage: ClipArrays, folder: Path) -> Path:
    """The footage as a clip folder, by the writers that any clip is written with."""

    def last(image: torch.Tensor) -> np.ndarray:
        return image.movedim(-3, -1).numpy()

    for i in range(len(footage)):
        gbuffer = {name: last(image[i]) for name, image in footage.gbuffer.items()}
        pools = {kind: last(pool[i]) for kind, pool in footage.pools.items()}
        write_frame(folder, i, gbuffer, pools, last(footage.half_a[i]), last(footage.half_b[i]))
    write_header(folder, footage.header)
    return folder


def break_values(folder: Path, footage: ClipArrays) -> None:
    """Write half A of frame 1 with a NaN and an infinity, which the clip writers refuse."""
    image = footage.half_a[1].clone()
    image[0, 3, 5], image[2, 4, 6] = torch.nan, torch.inf
    planes = dict(zip("RGB", image.numpy(), strict=True))
    write_exr(exr_path(folder, "referenceA", 1), planes)


def change_buffer(name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> Fault:
    """Change one view buffer."""
    return lambda f: replace(f, gbuffer={**f.gbuffer, name: change(f.gbuffer[name])})


def pool(change: Callable[[torch.Tensor], torch.Tensor]) -> Fault:
    """Change the samples [t s 3 h w]."""
    return lambda f: replace(f, pools={"path": change(f.pools["path"])})


def header(**fields: object) -> Fault:
    """Change what clip.toml says."""
    return lambda f: replace(f, header=replace(f.header, **fields))


def times(x: float, y: float) -> Fault:
    """Scale the motion's axes."""
    return change_buffer("motion", lambda m: m * torch.tensor([x, y]).view(1, 2, 1, 1))


def forward(footage: ClipArrays) -> ClipArrays:
    """Motion to the next frame: of a steady camera nearly the opposite of that frame's motion."""
    later = footage.gbuffer["motion"].roll(-1, 0)
    return change_buffer("motion", lambda _: -later)(footage)


def ray_length(footage: ClipArrays) -> torch.Tensor:
    """Distance to the eye over depth along the axis, for the procedural camera of 60 degrees."""
    h, w = footage.half_a.shape[-2:]
    focal = w / 2 / np.tan(np.radians(30))
    x = (torch.arange(w) + 0.5 - w / 2) / focal
    y = (torch.arange(h)[:, None] + 0.5 - h / 2) / focal
    return (1 + x.square() + y.square()).sqrt()


def distance(footage: ClipArrays) -> ClipArrays:
    return change_buffer("depth", lambda d: d * ray_length(footage))(footage)


def normalised(footage: ClipArrays) -> ClipArrays:
    """By the largest of each frame."""
    most = footage.gbuffer["depth"].where(footage.solid, 0.0).amax((1, 2, 3), keepdim=True)
    return change_buffer("depth", lambda d: d / most)(footage)


def camera_space(footage: ClipArrays) -> ClipArrays:
    """Normals turned into the axes of the procedural camera of each frame."""
    from rlbench.clips.procedural import world

    seed = footage.header.name.rsplit("-", 1)[1]
    own = world.random_world([f"{seed}/0"], torch.device("cpu"))
    axes = torch.cat([world.camera_pose(own, 1.5 * t)[1] for t in range(len(footage))]).float()
    return change_buffer("normal", lambda n: torch.einsum("tkc,tchw->tkhw", axes, n))(footage)


def encoded(footage: ClipArrays) -> ClipArrays:
    return change_buffer("normal", lambda n: n * 0.5 + 0.5)(footage)


def upside_down(footage: ClipArrays) -> ClipArrays:
    """All of the view, motion's sign included, while radiance stays: as by one reader of files."""
    flipped = {name: image.flip(-2) for name, image in footage.gbuffer.items()}
    flipped["motion"] = flipped["motion"] * torch.tensor([1.0, -1.0]).view(1, 2, 1, 1)
    return replace(footage, gbuffer=flipped)


def twice_stored(footage: ClipArrays) -> ClipArrays:
    return pool(lambda p: torch.cat((p[:, :-1], p[:, :1]), 1))(footage)


def half_mixed(samples: torch.Tensor) -> torch.Tensor:
    """Sample 1 takes half of its pixels, in a checkerboard, from sample 0."""
    h, w = samples.shape[-2:]
    board = (torch.arange(h)[:, None] + torch.arange(w)) % 2 == 0
    mixed = samples.clone()
    mixed[:, 1] = torch.where(board, samples[:, 0], samples[:, 1])
    return mixed


def common_noise(footage: ClipArrays) -> ClipArrays:
    """All samples of a pixel share half of their noise."""
    samples = footage.pools["path"]
    shared = samples.roll(1, 1)[:, :1] - footage.reference[:, None]
    truth = footage.reference[:, None]
    return pool(lambda p: (truth + 0.5 * (p - truth) + 0.5 * shared).clamp_min(0))(footage)


def filtered(samples: torch.Tensor) -> torch.Tensor:
    """A tent over neighbouring pixels."""
    from torch.nn import functional as F

    flat = samples.flatten(0, 1)
    return F.avg_pool2d(F.pad(flat, (1, 1, 1, 1), mode="replicate"), 3, 1).view_as(samples)


def same_seed(footage: ClipArrays) -> ClipArrays:
    """The noise of frame 0, as a factor, in every frame."""
    factor = footage.pools["path"][:1] / footage.reference[:1, None].clamp_min(1e-3)
    return pool(lambda _: footage.reference[:, None] * factor)(footage)


def shared_seeds(footage: ClipArrays) -> ClipArrays:
    """Half A begins with the pool's own samples."""
    kept = footage.half_a * (HALF - POOL) + footage.pools["path"].sum(1)
    return replace(footage, half_a=kept / HALF)


def overlapping_halves(footage: ClipArrays) -> ClipArrays:
    return replace(footage, half_b=footage.half_a * 0.7 + footage.half_b * 0.3)


def equal_halves(footage: ClipArrays) -> ClipArrays:
    return replace(footage, half_b=footage.half_a)


def denoised(footage: ClipArrays) -> ClipArrays:
    smooth = [filtered(half[:, None])[:, 0] for half in (footage.half_a, footage.half_b)]
    return replace(footage, half_a=smooth[0], half_b=smooth[1])


def negative(footage: ClipArrays) -> ClipArrays:
    changed = footage.half_b.clone()
    changed[2, 1, 7, 9] = -0.02
    return replace(footage, half_b=changed)


def few_samples(footage: ClipArrays) -> ClipArrays:
    """A reference of 2 samples, as clip.toml says."""
    drawn = clean(int(footage.header.name.rsplit("-", 1)[1]), half=1)
    return replace(drawn, header=drawn.header)


FAULTS: dict[str, tuple[str, Fault]] = {  # what is wrong: the check that must say so, the fault
    "x of motion has the wrong sign": ("motion", times(-1, 1)),
    "y of motion points up": ("motion", times(1, -1)),
    "motion is from there to here": ("motion", times(-1, -1)),
    "motion has y first": ("motion", change_buffer("motion", lambda m: m.flip(1))),
    "motion is in NDC": (
        "motion",
        lambda f: times(2 / f.half_a.shape[-1], 2 / f.half_a.shape[-2])(f),
    ),
    "motion is in shares of the image": (
        "motion",
        lambda f: times(1 / f.half_a.shape[-1], 1 / f.half_a.shape[-2])(f),
    ),
    "motion is half as long": ("motion", times(0.5, 0.5)),
    "motion is twice as long": ("motion", times(2, 2)),
    "motion leads to the next frame": ("motion", forward),
    "motion is zero": ("motion", times(0, 0)),
    "static is said of what moves": ("motion", header(static=True)),
    "depth is the distance to the eye": ("depth", distance),
    "depth is normalised": ("depth", normalised),
    "depth is inverse": ("depth", change_buffer("depth", lambda d: 1 / d + 1e-6)),
    "depth is negative": (
        "depth",
        change_buffer("depth", lambda d: torch.where(d.isfinite(), -d, d)),
    ),
    "depth of background is a large number": (
        "depth",
        change_buffer("depth", lambda d: d.nan_to_num(posinf=1e10)),
    ),
    "normals are in camera space": ("normal", camera_space),
    "normals are encoded in 0..1": ("normal", encoded),
    "normals are not of unit length": ("normal", change_buffer("normal", lambda n: n * 0.8)),
    "normals are mirrored": (
        "normal",
        change_buffer("normal", lambda n: n * torch.tensor([1.0, -1.0, 1.0]).view(1, 3, 1, 1)),
    ),
    "albedo is sRGB": ("albedo", change_buffer("albedo", lambda a: a ** (1 / 2.2))),
    "albedo is in 0..255": ("albedo", change_buffer("albedo", lambda a: a * 255)),
    "albedo is black": ("albedo", change_buffer("albedo", torch.zeros_like)),
    "the view is upside down": ("orientation", upside_down),
    "the samples are mirrored": ("orientation", pool(lambda p: p.flip(-1))),
    "a sample is stored twice": ("samples", twice_stored),
    "two samples are half the same": ("samples", pool(half_mixed)),
    "all samples share noise": ("samples", common_noise),
    "samples are filtered": ("noise pattern", pool(filtered)),
    "every frame has the same seed": ("noise pattern", same_seed),
    "the pool is in half A": ("seeds", shared_seeds),
    "samples are half as bright": ("brightness", pool(lambda p: p / 2)),
    "the halves overlap": ("halves", overlapping_halves),
    "the halves are one image": ("halves", equal_halves),
    "the reference is denoised": ("halves", denoised),
    "a reference is negative": ("not negative", negative),
    "the reference is noisy": ("noise ceiling", few_samples),
    "the exposure is a thousand times too high": ("exposure", header(exposure=1e4)),
    "the exposure is far too low": ("exposure", header(exposure=1e-5)),
}
