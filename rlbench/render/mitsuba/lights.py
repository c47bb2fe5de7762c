"""Animated lights: scales the emitters of a loaded scene without loading it again.

Mitsuba updates its sampling tables of bitmaps, environment maps, sun and sky by itself. How often
an emitter is sampled does not change: an emitter scaled to 0 costs samples but causes no bias.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rlbench.render.mitsuba.load import LightError, upload

__all__ = ["EmitterScaler"]

STRENGTH_PARAMETERS = (
    "radiance.value",
    "radiance.data",
    "irradiance.value",
    "intensity.value",
    "scale",  # of an environment map
    "sky_scale",
    "sun_scale",
)  # emitter parameters to which the emitted light is proportional
MIN_BITMAP_FACTOR = 1e-20  # a sampling table of zeros gives NaN


class EmitterScaler:
    """The emitters of a loaded scene, by the name of their mesh, or `sky0`, `sky1`, ..."""

    def __init__(self, parameters: Any) -> None:
        """Take the `parameters` from `mi.traverse`; all emitters are at full strength."""
        self._parameters = parameters
        self._full: dict[str, Any] = {}  # parameter values before the first change
        self._factors: Mapping[str, float] = {}

    def set_factors(self, factors: Mapping[str, float]) -> None:
        """Scale emitters by factors of their full strength; those not named get the factor 1.

        Kernels are not compiled again, except for the scales of sun and sky, which Mitsuba compiles
        in: one compilation per factor. Raises LightError for a factor that is negative or not
        finite, and for a name that no emitter has.
        """
        if factors == self._factors:
            return
        reset = dict.fromkeys(self._factors, 1.0)
        for name, factor in (reset | dict(factors)).items():
            if not 0 <= factor < np.inf:
                raise LightError(
                    f"light '{name}' is scaled by {factor}; factors must be finite and at least 0"
                )
            for key in self._strength_keys(name):
                self._scale(key, factor)
        self._parameters.update()
        self._factors = dict(factors)

    def _strength_keys(self, name: str) -> list[str]:
        """The parameters that hold the strength of an emitter."""
        candidates = [
            f"{name}.{middle}{parameter}"
            for middle in ("emitter.", "")
            for parameter in STRENGTH_PARAMETERS
        ]
        if keys := [key for key in candidates if key in self._parameters]:
            return keys
        names = ", ".join(self._emitter_names()) or "none"
        raise LightError(f"no light '{name}' whose strength can change; available: {names}")

    def _emitter_names(self) -> list[str]:
        """The names of the emitters that can be scaled."""
        names = {
            key.removesuffix(f".{parameter}").removesuffix(".emitter")
            for key in list(self._parameters.keys())
            for parameter in STRENGTH_PARAMETERS
            if key.endswith(parameter)
        }
        return sorted(name for name in names if ".bsdf" not in name)

    def _scale(self, key: str, factor: float) -> None:
        current = self._parameters[key]
        value = current if isinstance(current, float) else np.array(current)
        full = self._full.setdefault(key, value)
        self._parameters[key] = _scaled(current, full, factor)


def _scaled(current: Any, full: Any, factor: float) -> Any:
    """`full * factor` as a value of the type of `current`, opaque to Dr.Jit's compiler."""
    import drjit as dr
    import mitsuba as mi

    if isinstance(current, float):
        return full * factor
    if isinstance(current, mi.TensorXf):
        values = full * max(factor, MIN_BITMAP_FACTOR)
        return mi.TensorXf(upload(type(current.array), values), full.shape)
    channels = [dr.opaque(mi.Float, float(v)) for v in np.reshape(full * factor, -1)]
    return channels[0] if type(current) is mi.Float else type(current)(channels)
