"""Vertex normals of meshes, computed here so that they are bit-identical in every run."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

__all__ = ["smooth_normals"]


def smooth_normals(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Float[Array, "v 3"]:
    """Unit vertex normals: face normals weighted by the angle of each face at the vertex.

    Thuermer and Wuethrich 1998, Computing Vertex Normals from Polygonal Facets. The normal of a
    vertex without faces is z.
    """
    corners = vertices.astype(np.float64)[faces]  # f 3 3
    to_next, to_last = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    normal = _normalize(np.cross(to_next[:, 0], to_last[:, 0]))
    angle = np.arccos(np.clip((_normalize(to_next) * _normalize(to_last)).sum(-1), -1, 1))  # f 3
    weighted = (normal[:, None] * angle[..., None]).reshape(-1, 3)
    total = np.stack(
        [np.bincount(faces.ravel(), weighted[:, axis], len(vertices)) for axis in range(3)], 1
    )
    return np.where(np.any(total, 1, keepdims=True), _normalize(total), [0.0, 0.0, 1.0])


def _normalize(vectors: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """Vectors scaled to length 1; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))
