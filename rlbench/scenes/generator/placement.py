"""Free spots on the floor: clear of occupied discs and of the camera path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlbench.scenes.generator.camera import CameraTrack
from rlbench.scenes.generator.places import Disc
from rlbench.scenes.parts.shape import Float64Array, Shape


def is_blocked(
    spot: Float64Array,
    radius: float,
    occupied: Sequence[Disc],
    track: CameraTrack,
    clearance: float,
) -> bool:
    """Would a disc about a spot overlap an occupied one, or come too near to the camera path?

    Lengths are metres; `clearance` is the smallest distance allowed between disc and camera.
    """
    overlaps = any(np.hypot(spot[0] - x, spot[1] - y) < radius + r for x, y, r in occupied)
    distance = np.hypot(*(track.positions[:, :2] - spot).T).min() - radius
    return bool(overlaps or distance < clearance)


def footprint_radius(shape: Shape) -> float:
    """Radius of the disc about the origin that holds the shape seen from above, in metres."""
    return float(np.hypot(*shape.vertices[:, :2].T).max())
