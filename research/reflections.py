"""What a second reprojection gives: history of mirrors and glass along the virtual image.

Command: python -m research.reflections --preset real-development --spp 1,4

Motion vectors follow the first surface. What a plane mirror shows stands behind it, at the length
of the whole path, and moves as that point does when the camera moves (Zimmer et al. 2015,
Path-space Motion Estimation and Decomposition for Robust Animation Filtering; NVIDIA's NRD does it
by hit distance). A renderer would have to add one number a pixel: the length of the path behind
smooth mirrors and glass, as the buffer `depth_psr` has it. Clips need not store it, since their
scenes are traced here once more, one ray a pixel.

The other motion is exact for plane mirrors, plane panes and things that stand still. Curved mirrors
shrink what they show, and rough ones blur it: neither is followed here. So two ways are measured:
the virtual image's motion in every mirror, or only where the albedo behind the mirror agrees better
with that of the last frame than along the surface's motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from statistics import fmean
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from rich.console import Console
from rich.progress import track
from torch import Tensor

from methods.ours.gradients.command import make_parser
from research.clips import print_gains
from rlbench import registry
from rlbench.apps.render.jobs.job import SEED, Job
from rlbench.apps.render.jobs.render_clips import preset_jobs
from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.scene import Pose
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import open_clip
from rlbench.frames import Clip, Frame, GBuffer
from rlbench.method import Method
from rlbench.ops.reprojection import reproject
from rlbench.run import run_clip

PROGRAM = "python -m research.reflections"
METHOD = "accumulate/tuned"
PARTS = ("whole image", "mirrors and glass")
BETTER = 0.02  # least difference of albedo, summed over channels, that decides between motions
SAME_DEPTH = 1e-3  # relative; a path that ends nearer to its first surface had no mirror


def virtual_motion(tracer: Tracer) -> tuple[Float[Array, "h w 2"], Bool[Array, "h w"]]:
    """Motion of what mirrors and glass show, in pixels, and where there is any.

    The end of the path is taken as a point on the straight line through the pixel, at the path's
    length, which only the camera moves.
    """
    height, width, pose = tracer.height, tracer.width, tracer.pose
    depths = render_gbuffer(tracer, ("depth", "depth_psr"))
    depth, behind = (depths[name].astype(np.float64).ravel() for name in ("depth", "depth_psr"))
    rows, columns = np.indices((height, width)).reshape(2, -1)
    rays = pose.ray_directions(np.stack([columns, rows], 1) + 0.5, height, width)
    is_sky = np.isinf(behind)
    length = np.where(is_sky, 1.0, behind) / (rays @ pose.camera_axes()[2])
    points = np.where(is_sky[:, None], rays, rays * length[:, None] + pose.camera.origin)
    points = np.column_stack([points, ~is_sky])
    earlier = Pose.at_time(tracer.scene, tracer.time - 1)
    now, before = (each.project(points, height, width)[0] for each in (pose, earlier))
    is_mirror = np.isfinite(depth) & ~np.isclose(behind, depth, rtol=SAME_DEPTH, atol=0)
    return (before - now).reshape(height, width, 2), is_mirror.reshape(height, width)


class Reflections(NamedTuple):
    """A clip with the motion of virtual images, and its mirrors and glass."""

    always: Clip  # in every mirror
    where_better: Clip  # where the albedo agrees better than along the surface's motion
    masks: list[Bool[Tensor, "1 1 h w"]]  # of mirrors and glass, one for each frame


def follow_reflections(job: Job, inputs: frozenset[str]) -> Reflections:
    """The clip of a job, whose scene is traced for what mirrors and glass show."""
    tracer = open_tracer(job.scene, *job.preset.size, SEED)
    clip, masks = open_clip(job.folder, inputs), list[Tensor]()
    always, where_better, last = list[Frame](), list[Frame](), None
    for frame in clip:
        tracer.set_time(float(frame.index))
        motion, is_mirror = virtual_motion(tracer)
        mask = torch.from_numpy(is_mirror)[None, None]
        virtual = torch.from_numpy(motion).movedim(-1, 0)[None].float()
        buffers, surface = frame.gbuffer.buffers, frame.gbuffer.buffers["motion"]
        last = buffers["albedo"] if last is None else last
        differences = [albedo_difference(last, buffers["albedo"], m) for m in (surface, virtual)]
        is_better = mask & (differences[1] < differences[0] - BETTER)
        for frames, use in ((always, mask), (where_better, is_better)):
            followed = {**buffers, "motion": virtual.where(use, surface)}
            frames.append(replace(frame, gbuffer=GBuffer(followed)))
        masks.append(mask)
        last = buffers["albedo"]
    named = partial(InMemoryClip, clip.name, clip.scene, clip.digest)
    return Reflections(named(always), named(where_better), masks)


def albedo_difference(
    last: Float[Tensor, "n 3 h w"],
    albedo: Float[Tensor, "n 3 h w"],
    motion: Float[Tensor, "n 2 h w"],
) -> Float[Tensor, "n 1 h w"]:
    """Absolute change of albedo along a motion, summed over channels; infinite from outside."""
    moved, is_inside = reproject(last, motion)
    return (moved - albedo).abs().sum(1, keepdim=True).where(is_inside > 0, math.inf)


def measure_clip(method: Method, job: Job, budgets: list[float]) -> Iterator[dict[str, object]]:
    """Gains in PSNR, dB, of a clip by each way: in the whole image, and in mirrors and glass."""
    if job.scene.static or job.scene.cuts:
        return
    reflections = follow_reflections(job, method.traits.inputs)
    masks = reflections.masks
    if not any(mask.any() for mask in masks):
        return
    stored = open_clip(job.folder, method.traits.inputs)
    share = fmean(float(mask.float().mean()) for mask in masks)
    for spp in budgets:
        base = mean_psnr(method, stored, masks, spp)
        for way in ("always", "where_better"):
            scores = mean_psnr(method, getattr(reflections, way), masks, spp)
            for part, score, before in zip(PARTS, scores, base, strict=True):
                name = f"{way.replace('_', ' ')}: {part}"
                yield {
                    "clip": job.name,
                    "spp": spp,
                    "part": name,
                    "gain": score - before,
                    "share": share,
                }


def mean_psnr(method: Method, clip: Clip, masks: list[Tensor], spp: float) -> tuple[float, float]:
    """Mean PSNR of the frames of a clip in clipped sRGB, dB: of all pixels, and of the masks'."""
    psnr = registry.load_plugin("metrics", "psnr")
    overall, in_mirrors = [], []
    for result, mask in zip(run_clip(method, clip, spp), masks, strict=True):
        reference = result.frame.reference
        compared = psnr.compare(result.image, reference.half_a, reference.half_b)
        error = compared.display_error.square().mean(1, keepdim=True)
        overall.append(-10 * float(error.mean().log10()))
        if mask.any():
            in_mirrors.append(-10 * float(error[mask].mean().log10()))
    return fmean(overall), fmean(in_mirrors)


def main() -> None:
    """Run the command line."""
    parser = make_parser(
        PROGRAM,
        f"Gain of {METHOD} in dB where the history of mirrors and glass follows what they show.",
        ["--preset development", "--preset real-development --scenes living-room-2 --spp 0.5,1,4"],
        {
            "--preset": ("real-development", "preset whose rendered clips are measured"),
            "--scenes": ("", "clips a,b"),
            "--spp": ("1,4", "samples per pixel, a,b"),
        },
    )
    arguments = parser.parse_args()
    names = arguments.scenes.split(",") if arguments.scenes else None
    jobs = [job for job in preset_jobs(arguments.preset, names) if job.is_finished]
    if not jobs:
        parser.error(f"no clip is rendered: run `rlbench render --preset {arguments.preset}`")
    budgets = [float(spp) for spp in arguments.spp.split(",")]
    method = registry.load_method(METHOD, torch.device("cpu"))
    rows = [row for job in track(jobs, "measuring") for row in measure_clip(method, job, budgets)]
    if not rows:
        parser.error(f"no mirror and no glass in the {len(jobs)} clips that are rendered")
    table = pd.DataFrame(rows)
    print_gains("motion", table.pivot_table(index="part", columns="spp", values="gain"))
    shares = table.groupby("clip")["share"].first()
    found = f"{len(shares)} of {len(jobs)} clips have mirrors or glass"
    Console().print(f"{found}, in {shares.mean():.0%} of pixels")


if __name__ == "__main__":
    main()
