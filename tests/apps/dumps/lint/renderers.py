"""Dumps with the channel names of renderers, written by the inverse of their conventions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays
from tests.apps.dumps.exr_files import Planes, write_file
from tests.apps.dumps.importers.dumps import planes

SAMPLES = 2
Buffers = dict[str, torch.Tensor]  # of one frame [c h w]


def _depth(buffers: Buffers, name: str, background: float) -> Planes:
    return planes(buffers["depth"].nan_to_num(posinf=background), [name], kind="f4")


def _motion(buffers: Buffers, names: list[str], x: float = 1, y: float = 1) -> Planes:
    return planes(buffers["motion"] * torch.tensor([x, y]).view(2, 1, 1), names, kind="f4")


def _alpha(buffers: Buffers, name: str) -> Planes:
    return planes(buffers["depth"].isfinite().float(), [name])


def arnold(buffers: Buffers) -> Planes:
    return {
        **planes(buffers["albedo"], "RGB", "diffuse_albedo."),
        **planes(buffers["normal"], "XYZ", "N."),
        **_depth(buffers, "Z", 1e30),
        **_motion(buffers, ["motionvector.R", "motionvector.G"], -1, 1),
        **_alpha(buffers, "A"),
    }


def renderman(buffers: Buffers) -> Planes:
    velocity = torch.cat([24 * buffers["motion"], buffers["motion"][:1]])
    return {
        **planes(buffers["albedo"], "rgb", "albedo."),
        **planes(buffers["normal"], "xyz", "Nn."),
        **_depth(buffers, "z", 1e30),
        **planes(velocity, "xyz", "dPcameradtime."),
        **_alpha(buffers, "a"),
    }


def karma(buffers: Buffers) -> Planes:
    h, w = buffers["depth"].shape[-2:]
    return {
        **planes(buffers["albedo"], "rgb", "albedo."),
        **planes(buffers["normal"], "xyz", "N."),
        **_depth(buffers, "depth", 1e10),
        **_motion(buffers, ["motionvectors.x", "motionvectors.y"], 2 / w, -2 / h),
    }


def unreal(buffers: Buffers) -> Planes:
    h, w = buffers["depth"].shape[-2:]
    mask = (buffers["depth"] < buffers["depth"].median()).float()
    velocity = 0.5 - buffers["motion"] * torch.tensor([1 / w, -1 / h]).view(2, 1, 1)
    normal = buffers["normal"] * torch.tensor([1.0, -1, 1]).view(3, 1, 1)
    return {
        **planes(mask, ["ActorHitProxyMask.R"]),
        **planes((normal + 1) / 2, "RGB", "WorldNormal."),
        **_depth(buffers, "WorldDepth.R", 65504.0),
        **planes(velocity, "RG", "MotionVectors.", kind="f4"),
    }


def blender(buffers: Buffers) -> Planes:
    """Other folders and names than those of the ready layout, and passes of two spaces."""
    view = buffers["normal"].roll(1, 0)
    return {
        **planes(buffers["albedo"], "RGB", "Layer.Denoising Albedo."),
        **planes(view, "XYZ", "Layer.Denoising Normal."),
        **planes(buffers["normal"], "XYZ", "Layer.Normal."),
        **_depth(buffers, "Layer.Depth.Z", 1e10),
        **_motion(buffers, ["Layer.Vector.X", "Layer.Vector.Y"], 1, -1),
        **planes(buffers["albedo"].flip(-1), "RGB", "Composite.Combined."),
    }


RENDERERS: dict[str, tuple[str, str, Callable[[Buffers], Planes]]] = {
    # names of files below a folder of a sample; channels of the beauty
    "Arnold": ("{kind}/shot_v012.{frame:04d}.exr", "R G B", arnold),
    "RenderMan": ("sh010/{kind}_{frame:04d}.exr", "Ci.r Ci.g Ci.b", renderman),
    "Karma": ("{kind}.{frame}.exr", "C.r C.g C.b", karma),
    "Unreal": ("{kind}/Seq.{frame:04d}.exr", "FinalImage.R FinalImage.G FinalImage.B", unreal),
    "Blender": (
        "{frame:04d}/{kind}.exr",
        "Layer.Combined.R Layer.Combined.G Layer.Combined.B",
        blender,
    ),
}


def write_renderer(name: str, arrays: ClipArrays, folder: Path) -> None:
    """A dump of one multi-layer file per frame and sample, numbered from 1001."""
    pattern, beauty, layers = RENDERERS[name]
    for t in range(len(arrays)):
        buffers = {key: image[t] for key, image in arrays.gbuffer.items()}
        images = {f"sample{s}": arrays.pools["path"][t, s] for s in range(SAMPLES)}
        images |= {"referenceA": arrays.half_a[t], "referenceB": arrays.half_b[t]}
        for kind, image in images.items():
            path = folder / pattern.format(kind=kind, frame=1001 + t)
            write_file(path, {"": planes(image, beauty.split(), kind="f4") | layers(buffers)})
