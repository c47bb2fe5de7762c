"""Dumps of a procedural clip in the layout of each engine, written by the inverse conversions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from rlbench.clips.procedural import world
from tests.apps.dumps.exr_files import Planes, write_file

FOV = 60.0  # horizontal, degrees, of the procedural camera
SAMPLES = 8


def halves(
    image: torch.Tensor, names: Iterable[str], prefix: str = "", kind: npt.DTypeLike = np.float16
) -> Planes:
    """The channels of an image [c h w], in half precision."""
    return {
        f"{prefix}{name}": plane.astype(kind)
        for name, plane in zip(names, image.numpy(), strict=True)
    }


floats = partial(halves, kind=np.float32)


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
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        depth = buffers["depth"].nan_to_num(posinf=0.0)
        images = {
            "sample0/Mogwai.GBufferRT.diffuseOpacity": halves(buffers["albedo"], "RGB"),
            "sample0/Mogwai.GBufferRT.normW": halves(buffers["normal"], "RGB"),
            "sample0/Mogwai.GBufferRT.linearZ": floats(torch.cat((depth, depth)), "RG"),
            "sample0/Mogwai.GBufferRT.mvec": floats(scaled(buffers["motion"], 1 / w, 1 / h), "RG"),
            "referenceA/Mogwai.AccumulatePass.output": floats(arrays.half_a[t], "RGB"),
            "referenceB/Mogwai.AccumulatePass.output": floats(arrays.half_b[t], "RGB"),
        }
        for s in range(SAMPLES):
            sample = floats(arrays.pools["path"][t, s], "RGB")
            images[f"sample{s}/Mogwai.PathTracer.color"] = sample
        for name, channels in images.items():
            write_file(folder / f"{name}.{t}.exr", {"": channels})


# One file a frame, with all layers; samples and references in folders

Buffers = dict[str, torch.Tensor]  # of one frame [c h w]


def scaled(image: torch.Tensor, *factors: float) -> torch.Tensor:
    return image * torch.tensor(factors).view(-1, 1, 1)


def background(buffers: Buffers, value: float) -> torch.Tensor:
    """Depth with another value than infinity in the background."""
    return buffers["depth"].nan_to_num(posinf=value)


def alpha(buffers: Buffers, name: str) -> Planes:
    return halves(buffers["depth"].isfinite().float(), [name])


def unreal(buffers: Buffers) -> Planes:
    h, w = buffers["depth"].shape[-2:]
    material = "FinalImageMovieRenderQueue_"
    normal = scaled(buffers["normal"], 1, -1, 1)
    return {
        **halves(buffers["albedo"], "RGB", "FinalImageBaseColor."),
        **halves((normal + 1) / 2, "RGB", "FinalImageWorldNormal."),
        **floats(buffers["depth"], "R", f"{material}WorldDepth."),
        **floats(0.5 - scaled(buffers["motion"], 1 / w, -1 / h), "RG", f"{material}MotionVectors."),
    }


def blender(buffers: Buffers) -> Planes:
    vector = torch.cat((scaled(buffers["motion"], 1, -1), 0 * buffers["motion"]))
    return {
        **halves(buffers["albedo"], "RGB", "ViewLayer.Denoising Albedo."),
        **halves(buffers["normal"], "XYZ", "ViewLayer.Normal."),
        **floats(background(buffers, 1e10), "Z", "ViewLayer.Depth."),
        **floats(vector, "XYZW", "ViewLayer.Vector."),
    }


def mitsuba(buffers: Buffers) -> Planes:
    distance = buffers["depth"] * ray_length(*buffers["depth"].shape[-2:])
    return {
        **halves(buffers["albedo"], "RGB", "albedo."),
        **halves(buffers["normal"], "XYZ", "nn."),
        **floats(distance.nan_to_num(posinf=0.0), "T", "dd."),
    }


def renderman(buffers: Buffers) -> Planes:
    velocity = torch.cat([24 * buffers["motion"], buffers["motion"][:1]])
    return {
        **halves(buffers["albedo"], "rgb", "albedo."),
        **halves(buffers["normal"], "xyz", "Nn."),
        **floats(background(buffers, 1e30), "z"),
        **halves(velocity, "xyz", "dPcameradtime."),
        **alpha(buffers, "a"),
    }


LAYERED: dict[str, tuple[str, str, Callable[[Buffers], Planes]]] = {
    # names of files, the layer of the beauty and its channels, and the other layers
    "unreal": ("{kind}/Shot.{frame:04d}.exr", "RGB", unreal),
    "blender": ("{kind}/atrium{frame:04d}.exr", "ViewLayer.Combined.RGB", blender),
    "mitsuba": ("{kind}/{frame:03d}.exr", "RGB", mitsuba),
    "renderman": ("sh010/{kind}_{frame:04d}.exr", "Ci.rgb", renderman),
}


def write_layered(name: str, arrays: ClipArrays, folder: Path) -> None:
    pattern, beauty, layers = LAYERED[name]
    for t in range(len(arrays)):
        others = layers({key: image[t] for key, image in arrays.gbuffer.items()})
        images = {f"sample{s}": arrays.pools["path"][t, s] for s in range(SAMPLES)}
        images |= {"referenceA": arrays.half_a[t], "referenceB": arrays.half_b[t]}
        for kind, image in images.items():
            path = folder / pattern.format(kind=kind, frame=t + 1)
            write_file(path, {"": floats(image, beauty[-3:], beauty[:-3]) | others})


write_blender = partial(write_layered, "blender")


# Others


def write_nrd_sample(arrays: ClipArrays, folder: Path) -> None:
    for t in range(len(arrays)):
        buffers = {name: image[t] for name, image in arrays.gbuffer.items()}
        black = buffers["albedo"].sum(0, keepdim=True) == 0  # the sky emits, and reflects nothing
        for s in range(SAMPLES):
            light = arrays.pools["path"][t, s].where(~black, 0.0)
            diffuse = 0.7 * light / buffers["albedo"].clamp_min(1e-6)
            for name, image in (("DIFF", diffuse), ("SPEC", 0.3 * light)):
                path = folder / f"sample{s}" / f"IN_{name}_RADIANCE_HITDIST.{t}.exr"
                write_file(path, {"": floats(image, "RGB")})
        images = {
            "sample0/DirectLighting": floats(arrays.half_a[t].where(black, 0.0), "RGB"),
            "sample0/IN_BASECOLOR_METALNESS": floats(srgb(buffers["albedo"]), "RGB"),
            "sample0/IN_NORMAL_ROUGHNESS": halves(buffers["normal"], "RGB"),
            "sample0/IN_VIEWZ": floats(background(buffers, 1e6), "R"),
            "sample0/IN_MV": floats(buffers["motion"], "RG"),
            "referenceA/Composed": floats(arrays.half_a[t], "RGB"),
            "referenceB/Composed": floats(arrays.half_b[t], "RGB"),
        }
        for name, channels in images.items():
            write_file(folder / f"{name}.{t}.exr", {"": channels})


WRITERS: dict[str, Callable[[ClipArrays, Path], None]] = {
    "falcor": write_falcor,
    "nrd-sample": write_nrd_sample,
    **{name: partial(write_layered, name) for name in ("unreal", "blender", "mitsuba")},
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
            write_file(path, {"": floats(mean, "RGB")})
        x, y, z = torch.einsum("kc,chw->khw", axes[t], buffers["normal"])
        view = torch.stack((-y, z, x))  # so that x y z are the third, minus the first, the second
        near, far = 0.1, 50.0
        window = (near * far / buffers["depth"] - near) / (far - near)
        window = window.where(buffers["depth"].isfinite(), 0.0)  # the cleared value
        scale = torch.tensor([2 / w, -2 / h]).view(2, 1, 1)
        parts = {
            "emission": floats(arrays.half_a[t].where(is_black, 0.0), "RGB"),
            "converged": floats(arrays.reference[t], "RGB"),
            "albedo": halves(buffers["albedo"], "RGB"),
            "normal": floats((view + 1) / 2, "XYZ"),
            "depth": floats(window, "V"),
            "motion": floats(buffers["motion"] * scale, "RG"),
        }
        write_file(folder / str(t) / "all.exr", parts)
    matrices = np.tile(np.eye(4), (len(arrays), 1, 1))
    matrices[:, :3, :3] = axes.mT.numpy()
    (folder / "cameras.json").write_text(json.dumps({"camera_to_world": matrices.tolist()}))
    (folder / "engine.toml").write_text(OWN_LAYOUT)
    return folder / "engine.toml"
