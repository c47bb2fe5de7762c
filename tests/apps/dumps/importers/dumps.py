"""Dumps of a procedural clip in the layout of each engine, written by the inverse conversions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.clips.procedural import world
from tests.apps.dumps.exr_files import Planes, write_file

FOV = 60.0  # horizontal, degrees, of the procedural camera
SAMPLES = 8


def planes(
    image: torch.Tensor, names: Iterable[str], prefix: str = "", kind: npt.DTypeLike = np.float16
) -> Planes:
    """The channels of an image [c h w]."""
    return {
        f"{prefix}{name}": plane.astype(kind)
        for name, plane in zip(names, image.numpy(), strict=True)
    }


def srgb(linear: torch.Tensor) -> torch.Tensor:
    """The curve of IEC 61966-2-1."""
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def camera_axes(arrays: ClipArrays) -> torch.Tensor:
    """The axes of the procedural camera in each frame as rows: right, down, forward."""
    seed = arrays.header.name.rsplit("-", 1)[1]
    own = world.random_world([f"{seed}/0"], torch.device("cpu"))
    poses = [world.camera_pose(own, 1.5 * t)[1] for t in range(len(arrays))]
    return torch.cat(poses).float()


def ray_length(h: int, w: int) -> torch.Tensor:
    """Distance to the camera over depth along the view axis."""
    step = 2 * np.tan(np.radians(FOV / 2)) / w
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    return ((step * (x + 0.5 - w / 2)) ** 2 + (step * (y + 0.5 - h / 2)) ** 2 + 1).sqrt()


def write_falcor(arrays: ClipArrays, folder: Path) -> None:
    h, w = arrays.half_a.shape[-2:]
    for t in range(len(arrays)):
        for s in range(SAMPLES):
            path = folder / f"sample{s}" / f"Mogwai.PathTracer.color.{t}.exr"
            write_file(path, {"": planes(arrays.pools["path"][t, s], "RGB", kind=np.float32)})
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        size = torch.tensor([w, h]).view(2, 1, 1)
        depth = buffers["depth"].nan_to_num(posinf=0.0)
        images = {
            "diffuseOpacity": planes(buffers["albedo"], "RGB"),
            "normW": planes(buffers["normal"], "RGB"),
            "linearZ": planes(torch.cat((depth, depth)), "RG", kind=np.float32),
            "mvec": planes(buffers["motion"] / size, "RG", kind=np.float32),
        }
        for name, channels in images.items():
            write_file(folder / "sample0" / f"Mogwai.GBufferRT.{name}.{t}.exr", {"": channels})
        for half, image in (("A", arrays.half_a), ("B", arrays.half_b)):
            path = folder / f"reference{half}" / f"Mogwai.AccumulatePass.output.{t}.exr"
            write_file(path, {"": planes(image[t], "RGB", kind=np.float32)})


def _write_layered(
    arrays: ClipArrays,
    folder: Path,
    name: str,
    beauty: str,
    layers: Callable[[int], Planes],
) -> None:
    """One file a frame, with all layers; samples and references in folders."""
    for t in range(len(arrays)):
        kinds = {f"sample{s}": arrays.pools["path"][t, s] for s in range(SAMPLES)}
        kinds |= {"referenceA": arrays.half_a[t], "referenceB": arrays.half_b[t]}
        for kind, image in kinds.items():
            channels = planes(image, "RGB", beauty, np.float32)
            write_file(folder / kind / name.format(t + 1), {"": channels | layers(t)})


def write_unreal(arrays: ClipArrays, folder: Path) -> None:
    h, w = arrays.half_a.shape[-2:]

    def layers(t: int) -> Planes:
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        x, y = buffers["motion"]
        velocity = torch.stack((0.5 - x / w, 0.5 + y / h))
        normal = buffers["normal"] * torch.tensor([1.0, -1, 1]).view(3, 1, 1)
        prefix = "FinalImage{}."
        material = "FinalImageMovieRenderQueue_{}."
        return {
            **planes(buffers["albedo"], "RGB", prefix.format("BaseColor")),
            **planes((normal + 1) / 2, "RGB", prefix.format("WorldNormal")),
            **planes(buffers["depth"], "R", material.format("WorldDepth"), np.float32),
            **planes(velocity, "RG", material.format("MotionVectors"), np.float32),
        }

    _write_layered(arrays, folder, "Shot.{:04d}.exr", "", layers)


def write_blender(arrays: ClipArrays, folder: Path) -> None:
    def layers(t: int) -> Planes:
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        x, y = buffers["motion"]
        vector = torch.stack((x, -y, torch.zeros_like(x), torch.zeros_like(x)))
        depth = buffers["depth"].nan_to_num(posinf=1e10)
        return {
            **planes(buffers["albedo"], "RGB", "ViewLayer.Denoising Albedo."),
            **planes(buffers["normal"], "XYZ", "ViewLayer.Normal."),
            **planes(depth, "Z", "ViewLayer.Depth.", np.float32),
            **planes(vector, "XYZW", "ViewLayer.Vector.", np.float32),
        }

    _write_layered(arrays, folder, "atrium{:04d}.exr", "ViewLayer.Combined.", layers)


def write_mitsuba(arrays: ClipArrays, folder: Path) -> None:
    h, w = arrays.half_a.shape[-2:]

    def layers(t: int) -> Planes:
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        distance = (buffers["depth"] * ray_length(h, w)).nan_to_num(posinf=0.0)
        return {
            **planes(buffers["albedo"], "RGB", "albedo."),
            **planes(buffers["normal"], "XYZ", "nn."),
            **planes(distance, "T", "dd.", np.float32),
        }

    _write_layered(arrays, folder, "{:03d}.exr", "", layers)


def write_nrd_sample(arrays: ClipArrays, folder: Path) -> None:
    for t in range(len(arrays)):
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        black = buffers["albedo"].sum(0, keepdim=True) == 0  # the sky emits, and reflects nothing
        for s in range(SAMPLES):
            light = arrays.pools["path"][t, s].where(~black, 0.0)
            diffuse = 0.7 * light / buffers["albedo"].clamp_min(1e-6)
            for name, image in (("DIFF", diffuse), ("SPEC", 0.3 * light)):
                path = folder / f"sample{s}" / f"IN_{name}_RADIANCE_HITDIST.{t}.exr"
                write_file(path, {"": planes(image, "RGB", kind=np.float32)})
        images = {
            "DirectLighting": planes(arrays.half_a[t].where(black, 0.0), "RGB", kind=np.float32),
            "IN_BASECOLOR_METALNESS": planes(srgb(buffers["albedo"]), "RGB", kind=np.float32),
            "IN_NORMAL_ROUGHNESS": planes(buffers["normal"], "RGB"),
            "IN_VIEWZ": planes(buffers["depth"].nan_to_num(posinf=1e6), "R", kind=np.float32),
            "IN_MV": planes(buffers["motion"], "RG", kind=np.float32),
        }
        for name, channels in images.items():
            write_file(folder / "sample0" / f"{name}.{t}.exr", {"": channels})
        for half, image in (("A", arrays.half_a), ("B", arrays.half_b)):
            path = folder / f"reference{half}" / f"Composed.{t}.exr"
            write_file(path, {"": planes(image[t], "RGB", kind=np.float32)})


def write_oidn(arrays: ClipArrays, folder: Path) -> None:
    for t in range(len(arrays)):
        for s in range(SAMPLES):
            stem = folder / f"room_{t:04d}_seed{s}_0001spp"
            path = Path(f"{stem}.hdr.exr")
            write_file(path, {"": planes(arrays.pools["path"][t, s], "RGB", kind=np.float32)})
            for name, suffix in (("albedo", "alb"), ("normal", "nrm")):
                path = Path(f"{stem}.{suffix}.exr")
                write_file(path, {"": planes(arrays.gbuffer[name][t], "RGB")})
        for seed, image in ((8, arrays.half_a), (9, arrays.half_b)):
            path = folder / f"room_{t:04d}_seed{seed}_0256spp.hdr.exr"
            write_file(path, {"": planes(image[t], "RGB", kind=np.float32)})


WRITERS = {
    "falcor": write_falcor,
    "unreal": write_unreal,
    "blender": write_blender,
    "mitsuba": write_mitsuba,
    "nrd-sample": write_nrd_sample,
    "oidn": write_oidn,
}

OWN_LAYOUT = """
[radiance]  # means of the first 1, 2, 3, ... samples, bottom row first
files = "{frame}/mean_{spp}spp.exr"
samples = "accumulated"
demodulated = true
flip = "vertical"

[emission]  # of the sky, which has no albedo to multiply light by
files = "{frame}/all.exr"
part = "emission"

[reference]
files = "{frame}/all.exr"
part = "converged"
spp = 512

[albedo]
files = "{frame}/all.exr"
channels = ["albedo.R", "albedo.G", "albedo.B"]

[normal]
files = "{frame}/all.exr"
part = "normal"
space = "view"
encoded = true
axes = ["z", "-x", "y"]
camera = "cameras.json"

[depth]
files = "{frame}/all.exr"
channels = ["depth.V"]
kind = "reversed z-buffer"
near = 0.1
far_plane = 50.0

[motion]
files = "{frame}/all.exr"
channels = ["motion.R", "motion.G"]
unit = "ndc"
y = "up"
"""


def write_own(arrays: ClipArrays, folder: Path) -> Path:
    """Multi-part files in a layout of their own, which is returned; one reference alone."""
    h, w = arrays.half_a.shape[-2:]
    axes = camera_axes(arrays)
    for t in range(len(arrays)):
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        light = arrays.pools["path"][t] / buffers["albedo"].clamp_min(1e-6)
        is_black = buffers["albedo"].sum(0) == 0  # the sky emits, and reflects nothing
        light = light.where(~is_black, 0.0)
        for k in range(1, SAMPLES + 1):
            mean = light[:k].mean(0).flip(-2)
            path = folder / str(t) / f"mean_{k}spp.exr"
            write_file(path, {"": planes(mean, "RGB", kind=np.float32)})
        x, y, z = torch.einsum("kc,chw->khw", axes[t], buffers["normal"])
        view = torch.stack((-y, z, x))  # so that x y z are the third, minus the first, the second
        near, far = 0.1, 50.0
        window = (near * far / buffers["depth"] - near) / (far - near)
        window = window.where(buffers["depth"].isfinite(), 0.0)  # the cleared value
        scale = torch.tensor([2 / w, -2 / h]).view(2, 1, 1)
        parts = {
            "emission": planes(arrays.half_a[t].where(is_black, 0.0), "RGB", kind=np.float32),
            "converged": planes(arrays.reference[t], "RGB", kind=np.float32),
            "albedo": planes(buffers["albedo"], "RGB"),
            "normal": planes((view + 1) / 2, "XYZ", kind=np.float32),
            "depth": planes(window, "V", kind=np.float32),
            "motion": planes(buffers["motion"] * scale, "RG", kind=np.float32),
        }
        write_file(folder / str(t) / "all.exr", parts)
    matrices = np.tile(np.eye(4), (len(arrays), 1, 1))
    matrices[:, :3, :3] = axes.mT.numpy()
    (folder / "cameras.json").write_text(json.dumps({"camera_to_world": matrices.tolist()}))
    (folder / "engine.toml").write_text(OWN_LAYOUT)
    return folder / "engine.toml"
