"""Motion of the sky, which some renderers leave at 0: judged, and computed where it can be.

A point at infinity moves by the camera's rotation alone. A static point with inverse depth a moves
by a homography of the image plus a parallax that is proportional to a, so the surfaces show
whether the camera turns, if their depths differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from rlbench.apps.dumps.importers.conversions import OUTSIDE, parse_axis
from rlbench.apps.dumps.importers.dump_frame import read_rotation
from rlbench.apps.dumps.importers.layout import Layout, Motion
from rlbench.apps.dumps.importers.sequence import ImportedFrame, ImportedSequence

LIMITATION = "sky motion"
MAX_FRAMES = 16  # of a clip that are judged
MIN_SHARE = 1e-3  # of an image that counts as a sky
STILL = 1e-3  # pixels
MAX_MOVING = 0.05  # of a sky whose motion is not written: its edges have that of surfaces
MIN_TURN = 0.5  # pixels: a camera that turns moves the sky by more; moving objects cost 0.2
MAX_POINTS = (3000, 200)  # of surfaces and of the sky, for the fit
SIGMAS = 5.0
REWEIGHTINGS = 12
Judgement = Literal["stored", "unwritten", "unclear"]


def add_sky_motion(sequence: ImportedSequence, layout: Layout, source: Path) -> ImportedSequence:
    """The sequence with motion of the sky from the camera; without a camera it points outside.

    Sky is where depth is infinite; without depth, where there is no normal. Motion that is stored
    stays, unless it is 0 while surfaces move and the camera may turn. Raises SourceError.
    """
    motion = layout.motion
    has_none = {"no motion", "flow"} & set(sequence.limitations)
    if motion is None or has_none or motion.sky == "stored":
        return sequence
    camera = motion.camera or (layout.normal.camera if layout.normal else "")
    fov = motion.fov or (layout.depth.fov if layout.depth else None)
    is_known = camera and fov and not sequence.window  # whose width the field of view belongs to
    sky = _Sky(sequence, motion, source / camera if is_known else None, fov or 0)
    count = len(sequence.numbers)
    chosen = {round(index) for index in np.linspace(0, count - 1, min(MAX_FRAMES, count))}
    frames = (sequence.read(sequence.numbers[index], 1) for index in sorted(chosen))
    if not any(map(sky.is_unknown, frames)):
        return sequence
    if sky.camera:
        return replace(sequence, read=sky.read, files=(*sequence.files, sky.camera))
    limitations = (*sequence.limitations, LIMITATION)
    return replace(sequence, read=sky.read, limitations=limitations)


@dataclass(frozen=True)
class _Sky:
    """Reads the frames of a sequence whose sky has no motion."""

    sequence: ImportedSequence
    motion: Motion
    camera: Path | None  # a file of poses
    fov: float  # horizontal, degrees

    def read(self, number: int, samples: int) -> ImportedFrame:
        """A frame with motion of its sky. Raises SourceError."""
        frame = self.sequence.read(number, samples)
        if not self.is_unknown(frame):
            return frame
        stored = frame.gbuffer["motion"]
        replaced = self._find(frame)[..., None]
        if self.motion.sky == "auto":
            replaced &= (np.abs(stored) <= STILL).all(-1, keepdims=True)
        known = np.where(replaced, self._from_camera(number, stored.shape[:2]), stored)
        return frame._replace(gbuffer={**frame.gbuffer, "motion": known.astype(np.float32)})

    def is_unknown(self, frame: ImportedFrame) -> bool:
        """Whether the motion that is stored is not that of the sky."""
        depth = frame.gbuffer["depth"] if self._has_depth else None
        judgement = judge_sky(frame.gbuffer["motion"], self._find(frame), depth)
        return self.motion.sky == "unknown" or judgement != "stored"

    @property
    def _has_depth(self) -> bool:
        return "no depth" not in self.sequence.limitations

    def _find(self, frame: ImportedFrame) -> Bool[Array, "h w"]:
        """Where no surface is visible, without what lies outside the data window of motion."""
        depth, normal = frame.gbuffer["depth"], frame.gbuffer["normal"]
        sky = np.isinf(depth[..., 0]) if self._has_depth else ~np.any(normal, axis=-1)
        return np.asarray(sky & ~frame.empty["motion"][..., 0])

    def _from_camera(self, number: int, size: tuple[int, ...]) -> Float[Array, "*hw 2"]:
        """Motion of the sky in a frame; outside where there is no camera, or none before it."""
        if self.camera is None or number == self.sequence.first_number:
            return np.multiply(OUTSIDE, size[::-1])
        pose, previous = (self._pose(self.camera, each) for each in (number, number - 1))
        return motion_at_infinity(pose, previous, self.fov, size)

    def _pose(self, camera: Path, number: int) -> Float[Array, "3 3"]:
        rotation = read_rotation(camera, number - self.sequence.first_number)
        axes = (parse_axis(word, "[motion] camera_axes") for word in self.motion.camera_axes)
        return np.stack([sign * rotation[:, index] for index, sign in axes], 1)


def judge_sky(
    motion: Float[Array, "h w 2"], sky: Bool[Array, "h w"], depth: Float[Array, "h w 1"] | None
) -> Judgement:
    """Whether motion of the sky is stored, or 0 although the camera turns, or that is unclear.

    Motion is in pixels to the previous frame. Motion of 0 counts as stored where most surfaces
    stand still, and where their motion shows that the camera does not turn.
    """
    inside = np.abs(motion).max(-1) < max(motion.shape[:2])
    surface = ~sky & inside
    moves = np.abs(motion).max(-1) > STILL
    if sky.mean() < MIN_SHARE or moves[sky].mean() > MAX_MOVING:
        return "stored"
    if not surface.any() or moves[surface].mean() <= 0.5:
        return "stored"
    if depth is None:
        return "unclear"
    turn, error = _predict_turn(motion, surface & np.isfinite(depth[..., 0]), sky, depth[..., 0])
    if turn > max(MIN_TURN, SIGMAS * error):
        return "unwritten"
    return "stored" if turn + SIGMAS * error < MIN_TURN else "unclear"


def motion_at_infinity(
    pose: Float[Array, "3 3"],
    previous: Float[Array, "3 3"],
    fov: float,
    size: Sequence[int],
) -> Float[Array, "h w 2"]:
    """Motion of infinitely distant points to the previous frame, pixels, x right, y down.

    The columns of both poses are the camera's axes to the right, down and forward, in world space;
    `fov` is horizontal, in degrees. Points behind the previous camera point outside.
    """
    h, w = size
    focal = w / 2 / np.tan(np.radians(fov) / 2)
    film = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), -1)
    centre = np.array([w / 2, h / 2])
    rays = np.concatenate([(film - centre) / focal, np.ones((h, w, 1))], -1)
    x, y, z = np.moveaxis(rays @ pose.T @ previous, -1, 0)
    ahead = z > 1e-6
    projected = np.stack([x, y], -1) / np.where(ahead, z, 1)[..., None] * focal + centre
    return np.where(ahead[..., None], projected - film, np.multiply(OUTSIDE, (w, h)))


def _predict_turn(
    motion: Float[Array, "h w 2"],
    surface: Bool[Array, "h w"],
    sky: Bool[Array, "h w"],
    depth: Float[Array, "h w"],
) -> tuple[float, float]:
    """Median motion of the sky as surfaces predict it, and its standard error; pixels.

    Twice eleven coefficients of a plane-plus-parallax model, by least squares with Cauchy weights.
    """
    scale = motion.shape[1] / 2
    chosen = [_choose(mask, most) for mask, most in zip((surface, sky), MAX_POINTS, strict=True)]
    points = [
        np.stack([columns / scale - 1, (rows - len(motion) / 2) / scale], 1)
        for rows, columns in chosen
    ]
    inverse = 1 / np.maximum(np.abs(depth[chosen[0]].astype(np.float64)), 1e-12)
    targets = points[0] + motion[chosen[0]] / scale
    terms = _rows(points[0], inverse / inverse.mean(), targets)
    flat = targets.T.ravel()
    weights = np.ones(len(flat))
    floor = STILL / scale
    for _ in range(REWEIGHTINGS):
        gram = (terms * weights[:, None]).T @ terms
        covariance = np.linalg.pinv(gram, rcond=1e-15, hermitian=True)
        coefficients = covariance @ (terms.T @ (weights * flat))
        residual = np.abs(terms @ coefficients - flat)
        spread = max(float(np.median(residual)), floor)
        weights = 1 / (1 + (residual / spread) ** 2)
    x, y = points[1].T
    h = coefficients
    weight = np.where(np.abs(w := 1 + h[8] * x + h[9] * y) > 1e-3, w, 1)
    at = np.stack([h[0] * x + h[1] * y + h[2], h[4] * x + h[5] * y + h[6]], 1) / weight[:, None]
    at_sky = _rows(points[1], np.zeros(len(x)), at)
    ridge = np.linalg.inv(gram + np.eye(len(gram)) * 1e-13 * np.trace(gram))
    variance = np.einsum("ij,jk,ik->i", at_sky, ridge, at_sky) * (1.5 * spread) ** 2
    turn = np.median(np.linalg.norm(at - points[1], axis=1))
    return float(turn * scale), float(np.sqrt(np.median(variance)) * scale)


def _choose(mask: Bool[Array, "h w"], most: int) -> tuple[Array, Array]:
    """Rows and columns of at most so many pixels, evenly spaced."""
    rows, columns = np.nonzero(mask)
    step = -(-len(rows) // most)
    return rows[::step], columns[::step]


def _rows(
    points: Float[Array, "p 2"], inverse: Float[Array, " p"], targets: Float[Array, "p 2"]
) -> Float[Array, "2p 11"]:
    """Linear equations of the targets: first all of x, then all of y."""
    basis = np.column_stack([points, np.ones(len(points)), inverse])
    rows = np.zeros((2, len(points), 11))
    for axis in (0, 1):
        rows[axis, :, 4 * axis : 4 * axis + 4] = basis
        rows[axis, :, 8:] = -targets[:, axis : axis + 1] * basis[:, [0, 1, 3]]
    return rows.reshape(-1, 11)
