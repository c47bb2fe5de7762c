"""Checks that depth is linear along the view axis, and normals are unit vectors in world space.

A kind of depth and a focal length place every pixel in camera space; differences between
neighbours there give normals. For the right kind and focal length, one rotation maps them to the
stored normals: the camera's rotation if these are in world space, the identity if not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, absent
from rlbench.checks.result import CheckResult, failed, passed, warning
from rlbench.ops.reprojection import reproject

VIEW_DEPTH = "distance along the view axis"
FOCAL_LENGTHS = tuple(0.35 * 1.4**i for i in range(7))  # in image widths: 110 to 22 degrees
REFINEMENTS = (0.76, 0.87, 1.15, 1.32)  # times the best of them; then a second, finer round
MAX_PIXELS = 4000  # pixels of a frame that suffice to fit a rotation
MAX_ANGLE = math.radians(20)  # larger angles count as this one
ToViewDepth = Callable[[Tensor, Tensor], Tensor]  # from stored depth and ray length
DEPTH_KINDS: dict[str, ToViewDepth] = {
    VIEW_DEPTH: lambda d, ray: d,
    "distance to the camera": lambda d, ray: d / ray,
    "inverse depth 1 / z": lambda d, ray: 1 / d,
    "logarithmic depth ln(1 + 1 / distance)": lambda d, ray: 1 / torch.expm1(d) / ray,
    "z-buffer (0 near, 1 far)": lambda d, ray: 1 / (1 - d).clamp_min(1e-7),
}
UNIT_TOLERANCE = 0.02  # deviation of a length from 1; half precision causes 0.001
MIN_UNIT_SHARE = 0.995  # of surface pixels with unit length
ALIGNED = math.radians(1.5)  # to the axes: accuracy of a fit to rendered depth
MIN_TURN = math.radians(0.15)  # of a camera between two frames, that differs measurably from none
MAX_RESIDUAL = math.radians(8)  # of the best fit, above which normals do not follow from depth
MARGIN = 0.8  # a kind fits clearly better if its residual is below this share of the other's
FAR = 1e9  # what renderers write for background if not infinity


@dataclass(frozen=True)
class DepthFit:
    """How well the stored normals follow from depth of one kind."""

    kind: str
    focal: float  # in image widths
    residual: float  # mean angle between normals after rotation, at most MAX_ANGLE, radians
    rotations: Float[Tensor, "t 3 3"]  # from (right, down, forward) to the stored normals' space


def fit_depth_kinds(
    depth: Float[Tensor, "t 1 h w"], normal: Float[Tensor, "t 3 h w"]
) -> dict[str, DepthFit]:
    """For each kind of depth the fit with the best focal length; empty if no surface is smooth.

    `depth` is > 0, and not finite in the background; `normal` has unit length.
    """
    smooth = _smooth_surface_mask(depth, normal)
    fits = {}
    for kind, to_view_depth in DEPTH_KINDS.items():
        best = None
        for factors in (FOCAL_LENGTHS, REFINEMENTS, [f ** (1 / 3) for f in REFINEMENTS]):
            start = best.focal if best else 1.0
            tried = [_fit(kind, to_view_depth, start * f, depth, normal, smooth) for f in factors]
            usable = [fit for fit in (best, *tried) if fit]
            best = min(usable, key=lambda fit: fit.residual, default=None)
        if best:
            fits[kind] = best
    return fits


def _fit(
    kind: str, to_view_depth: ToViewDepth, focal: float, depth: Tensor, normal: Tensor, mask: Tensor
) -> DepthFit | None:
    if kind.startswith("z-buffer") and bool((depth[depth.isfinite()] > 1).any()):
        return None
    reconstructed = normals_from_depth(depth, to_view_depth, focal)
    rotations, residuals = [], []
    for index in range(len(depth)):
        usable = mask[index, 0] & reconstructed[index].isfinite().all(0)
        if int(usable.sum()) < 64:
            continue
        subset = slice(None, None, -(-int(usable.sum()) // MAX_PIXELS))
        rotation, residual = fit_rotation(
            reconstructed[index][:, usable].T[subset], normal[index][:, usable].T[subset]
        )
        rotations.append(rotation)
        residuals.append(residual)
    if not rotations:
        return None
    return DepthFit(kind, focal, sum(residuals) / len(residuals), torch.stack(rotations))


def normals_from_depth(
    depth: Tensor, to_view_depth: ToViewDepth, focal: float
) -> Float[Tensor, "t 3 h w"]:
    """Unit normals towards the camera by central differences; NaN at the border."""
    points = unproject(depth, to_view_depth, focal)
    across = torch.full_like(points, torch.nan)
    down = torch.full_like(points, torch.nan)
    across[..., 1:-1] = points[..., 2:] - points[..., :-2]
    down[..., 1:-1, :] = points[..., 2:, :] - points[..., :-2, :]
    normal = torch.linalg.cross(across, down, dim=1)
    normal = normal * -(normal * points).sum(1, keepdim=True).sign()
    return torch.nn.functional.normalize(normal, dim=1, eps=1e-30)


def unproject(depth: Tensor, to_view_depth: ToViewDepth, focal: float) -> Float[Tensor, "t 3 h w"]:
    """Each pixel's point in camera space: right, down, forward."""
    h, w = depth.shape[-2:]
    x = ((torch.arange(w) + 0.5 - w / 2) / (focal * w)).to(depth).expand(h, w)
    y = ((torch.arange(h) + 0.5 - h / 2) / (focal * w)).to(depth)[:, None].expand(h, w)
    ray = torch.stack((x, y, torch.ones_like(x)))
    return ray * to_view_depth(depth, ray.norm(dim=0))


def fit_rotation(
    source: Float[Tensor, "p 3"], target: Float[Tensor, "p 3"]
) -> tuple[Float[Tensor, "3 3"], float]:
    """The orthogonal matrix from source to target unit vectors, and the mean remaining angle.

    Kabsch 1976 with iterative reweighting, so that bumps and edges have little influence. A
    reflection is allowed, because a flipped axis looks like one. Angles are capped at MAX_ANGLE.
    """
    source, target = source.double(), target.double()
    weight = torch.ones_like(source[:, 0])
    matrix = torch.eye(3).double()
    angle = weight
    for _ in range(6):
        u, _, v = torch.linalg.svd((target * weight[:, None]).T @ source)
        matrix = u @ v
        angle = (target - source @ matrix.T).norm(dim=1)
        weight = 1 / (1 + (angle / 0.05).square())
    return matrix.float(), float(angle.clamp_max(MAX_ANGLE).mean())


def _smooth_surface_mask(depth: Tensor, normal: Tensor) -> Bool[Tensor, "t 1 h w"]:
    """Where all four neighbours lie on the same smooth surface: depth and normal vary little."""
    mask = torch.zeros_like(depth, dtype=torch.bool)
    centre = depth[..., 1:-1, 1:-1]
    smooth = centre.isfinite() & (centre != 0)
    centre_normal = normal[..., 1:-1, 1:-1]
    for dy, dx in ((0, 1), (1, 0)):
        h, w = depth.shape[-2:]
        before = (slice(1 - dy, h - 1 - dy), slice(1 - dx, w - 1 - dx))
        after = (slice(1 + dy, h - 1 + dy), slice(1 + dx, w - 1 + dx))
        one, two = depth[..., *before], depth[..., *after]
        smooth = smooth & ((one + two - 2 * centre).abs() < 0.02 * centre.abs())
        for region in (before, after):
            cosine = (normal[..., *region] * centre_normal).sum(1, keepdim=True)
            smooth = smooth & (cosine > 0.98)
    mask[..., 1:-1, 1:-1] = smooth
    return mask


def normalize(normal: Float[Tensor, "t 3 h w"]) -> Float[Tensor, "t 3 h w"]:
    """Normals of unit length, decoded if encoded, 0 where there is no normal."""
    decoded = 2 * normal - 1 if is_encoded(normal) else normal
    length = decoded.norm(dim=1, keepdim=True)
    return torch.where(length > 0.1, decoded / length.clamp_min(1e-6), 0.0)


def is_encoded(normal: Float[Tensor, "t 3 h w"]) -> bool:
    """True if the normals lie in [0, 1], with unit length after 2 n - 1."""
    return float(normal.min()) >= 0 and _unit_share(2 * normal - 1) > 0.9


def check_normals(
    arrays: ClipArrays, fits: dict[str, DepthFit], is_upright: bool = True
) -> CheckResult:
    """Passes if normals are in world space, of unit length, and 0 in the background.

    `fits` is the result of `rlbench.apps.dumps.lint.checks.fit_depth` for these arrays. Where the
    G-buffer is flipped (`is_upright` is False), world-space normals look mirrored and are accepted.
    """
    if "normal" not in arrays.gbuffer:
        return absent("normal")
    normal = arrays.gbuffer["normal"]
    if is_encoded(normal):
        found = "encoded in [0, 1]: 2 n - 1 has unit length"
        return failed("normal", found, "store 2 n - 1")
    if (share := _unit_share(normal)) < MIN_UNIT_SHARE:
        found = f"expected unit length, found another in {1 - share:.1%} of the normals"
        return failed("normal", found, "normalise them; do not filter them over pixels")
    if not fits:
        found = "unit length; no smooth surface to determine their space"
        return warning("normal", found, "compare with the renderer's documentation")
    fit = min(fits.values(), key=lambda each: each.residual)
    if fit.residual > MAX_RESIDUAL:
        angle = f"{math.degrees(fit.residual):.1f} degrees"
        found = f"unit length, but they deviate by {angle} from normals computed from depth"
        return warning("normal", found, "check that normal and depth show the same surface")
    if is_upright and _is_curved(normal) and float(torch.linalg.det(fit.rotations).min()) < 0:
        found = "mirrored: they follow from depth only with one axis flipped"
        return failed("normal", found, "negate the flipped axis; world space is right-handed")
    return _check_space(arrays, fit)


def _is_curved(normal: Tensor) -> bool:
    """True if normals have at least two directions; a single wall also fits a mirrored rotation."""
    vectors = normal.movedim(1, -1).reshape(-1, 3).double()
    largest, second, _ = torch.linalg.eigvalsh(vectors.T @ vectors).flip(0).tolist()
    return bool(second > 1e-4 * largest)


def _check_space(arrays: ClipArrays, fit: DepthFit) -> CheckResult:
    if not all(_angle_to_axes(rotation) < ALIGNED for rotation in fit.rotations):
        return passed("normal", "unit length, in world space: rotated relative to the camera")
    turn = _max_camera_turn(arrays, fit)
    if turn is None or turn < MIN_TURN:
        found = "along the camera's axes, which may be the world's, because the camera never turns"
        remedy = "ignore this if the camera looks straight along a world axis"
        return warning("normal", found, remedy)
    found = (
        "in camera space: they stay along the camera's axes while it turns by "
        f"{math.degrees(turn):.2f} degrees per frame"
    )
    return failed("normal", found, "rotate them to world space by the camera's matrix")


def _angle_to_axes(rotation: Tensor) -> float:
    """Angle to the nearest rotation that maps axes to axes."""
    nearest = torch.zeros_like(rotation)
    largest = rotation.abs().argmax(1)
    nearest[torch.arange(3), largest] = rotation[torch.arange(3), largest].sign()
    cosine = ((nearest * rotation).sum() - 1) / 2
    return math.acos(max(-1.0, min(1.0, float(cosine))))


def _max_camera_turn(arrays: ClipArrays, fit: DepthFit) -> float | None:
    """Largest rotation of the camera between two frames, in radians, from depth and motion."""
    if "motion" not in arrays.gbuffer or len(arrays) < 2:
        return None
    depth = arrays.gbuffer["depth"]
    points = unproject(depth.where(depth.isfinite(), 0.0), DEPTH_KINDS[fit.kind], fit.focal)
    turns = []
    for index in range(1, len(arrays)):
        motion = arrays.gbuffer["motion"][index, None]
        previous, inside = reproject(points[index - 1, None], motion)
        mask = (inside & arrays.surface_mask[index, None])[0, 0]
        current, before = points[index][:, mask].T, previous[0][:, mask].T
        if len(current) < 64:
            continue
        turns.append(_rotation_angle(current, before))
    return max(turns, default=None)


def _rotation_angle(source: Tensor, target: Tensor) -> float:
    """Angle of the rotation between two point clouds, most of which move rigidly."""
    weight = torch.ones_like(source[:, :1])
    matrix = torch.eye(3)
    for _ in range(10):
        centre, target_centre = ((p * weight).sum(0) / weight.sum() for p in (source, target))
        u, _, v = torch.linalg.svd((target - target_centre).T @ ((source - centre) * weight))
        matrix = u @ v
        residual = (target - target_centre) - (source - centre) @ matrix.T
        distance = residual.norm(dim=1, keepdim=True)
        weight = 1 / (1 + (distance / distance.median().clamp_min(1e-6)).square())
    return math.acos(max(-1.0, min(1.0, (float(matrix.trace()) - 1) / 2)))


def _unit_share(normal: Tensor) -> float:
    """Share of the normals, where there is one, that have unit length."""
    length = normal.norm(dim=1)
    has_normal = length > 1e-3
    if not has_normal.any():
        return 0.0
    return float(((length - 1).abs() < UNIT_TOLERANCE)[has_normal].float().mean())


def check_depth(arrays: ClipArrays, fits: dict[str, DepthFit]) -> CheckResult:
    """Passes if depth is linear, along the view axis, and +inf in the background.

    `fits` is the result of `rlbench.apps.dumps.lint.checks.fit_depth` for these arrays.
    """
    if "depth" not in arrays.gbuffer:
        return absent("depth")
    depth = arrays.gbuffer["depth"]
    finite = depth[depth.isfinite()]
    if not len(finite) or float(finite.max()) <= 0:
        return failed(
            "depth", "no pixel has a depth above 0", "write distance along the view axis, > 0"
        )
    if (share := float((finite < 0).float().mean())) > 0:
        remedy = "negate it if the camera looks along -z; nothing lies behind the camera"
        return failed("depth", f"expected values > 0, found {share:.1%} of pixels negative", remedy)
    if fault := _find_background_fault(arrays):
        return failed("depth", fault, "write +inf where no surface is visible, and only there")
    maxima = torch.stack([d[d.isfinite()].amax() for d in depth if d.isfinite().any()])
    if bool(((maxima - 1).abs() < 2e-3).all()):
        found = "the largest depth of every frame is 1, so it is normalised"
        return failed("depth", found, "store it in scene units, linear")
    return _check_kind(fits, f"{float(finite.min()):.3g} to {float(finite.max()):.3g}")


def _check_kind(fits: dict[str, DepthFit], span: str) -> CheckResult:
    if VIEW_DEPTH not in fits:
        found = f"{span}; no smooth surface to determine the kind of depth"
        return warning("depth", found, "compare with the renderer's documentation")
    stored = fits[VIEW_DEPTH]
    rival = min(
        (fit for kind, fit in fits.items() if kind != VIEW_DEPTH), key=lambda fit: fit.residual
    )
    found = (
        f"deviates from the normals by {_degrees(stored.residual)} as {VIEW_DEPTH}, "
        f"by {_degrees(rival.residual)} as {rival.kind}"
    )
    if rival.residual < MARGIN * stored.residual:
        return failed("depth", found, f"convert it from {rival.kind} to {VIEW_DEPTH}")
    if stored.residual > MARGIN * rival.residual:
        remedy = "compare with the renderer's documentation"
        return warning("depth", f"{found}; too similar to decide", remedy)
    field_of_view = 2 * math.degrees(math.atan(0.5 / stored.focal))
    return passed("depth", f"{span}; {found}; field of view about {field_of_view:.0f} degrees")


def _find_background_fault(arrays: ClipArrays) -> str:
    """The fault of the background, or an empty string."""
    depth = arrays.gbuffer["depth"]
    if share := float((depth == 0).float().mean()):
        return f"depth is 0 in {share:.1%} of pixels"
    if share := float((depth.isfinite() & (depth > FAR)).float().mean()):
        return f"depth is {float(depth[depth.isfinite()].max()):.3g} in {share:.1%} of pixels"
    if "normal" in arrays.gbuffer:
        empty = normalize(arrays.gbuffer["normal"]).norm(dim=1, keepdim=True) < 0.5
        share = float((empty != depth.isposinf()).float().mean())
        if share > 1e-3:
            return f"depth and normal disagree on what is background in {share:.1%} of pixels"
    return ""


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):.1f} degrees"
