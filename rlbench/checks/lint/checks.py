"""All checks of a clip, in the order in which they are told."""

from __future__ import annotations

import torch

from rlbench.checks.finding import Finding
from rlbench.checks.lint.albedo import albedo
from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.depth import depth
from rlbench.checks.lint.geometry import Fit, fits
from rlbench.checks.lint.motion import motion
from rlbench.checks.lint.normals import normals, unit
from rlbench.checks.lint.orientation import misoriented, orientation, reoriented, ways
from rlbench.checks.lint.reference import ceiling, exposure, halves
from rlbench.checks.lint.samples import brightness, neighbours, samples, seeds
from rlbench.checks.lint.values import finite, positive

SHOTS = 3  # frames whose normals are compared with their depth


def examine(footage: ClipArrays) -> list[Finding]:
    """What every check says; nothing is changed.

    Values that are not finite are told by one check, and are 0 for all others; pools that lie
    another way up are told by one, and turned for the others.
    """
    sound = footage.sound
    found, lying = geometry(sound), ways(sound)
    upright = not {"albedo", "normal", "depth"} & set(misoriented(lying))
    light = reoriented(sound, lying)
    return [
        finite(footage),
        positive(sound),
        motion(sound),
        depth(sound, found),
        normals(sound, found, upright),
        albedo(sound),
        orientation(lying),
        samples(light),
        neighbours(light),
        seeds(light),
        brightness(light),
        halves(light),
        ceiling(light),
        exposure(light),
    ]


def geometry(footage: ClipArrays) -> dict[str, Fit]:
    """Which kinds of depth fit the normals, over some frames from first to last; maybe none."""
    if not {"depth", "normal"} <= set(footage.gbuffer):
        return {}
    some = torch.linspace(0, len(footage) - 1, min(SHOTS, len(footage))).long()
    stored = footage.gbuffer["depth"][some].abs()
    return fits(stored.where(stored > 0, torch.inf), unit(footage.gbuffer["normal"][some]))
