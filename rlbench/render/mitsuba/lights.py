"""Lights that change: factors on what the emitters of a loaded scene give, without loading again.

Mitsuba rebuilds its tables for sampling a bitmap, an environment or sun and sky by itself. How
often a light is sampled stays as it is: one that is out costs samples, and makes nothing wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rlbench.render.mitsuba.load import LightError, upload

STRENGTH_PARAMETERS = (
    "radiance.value",
    "radiance.data",
    "irradiance.value",
    "intensity.value",
    "scale",  # of an environment map
    "sky_scale",
    "sun_scale",
)  # parameters to which Mitsuba's emitters are proportional
MIN_BITMAP_FACTOR = 1e-20  # factor on a bitmap that is out: tables of zeros give NaN


class EmitterScaler:
    """The lights of a loaded scene, each by the name of its mesh, or `sky0`, `sky1`, ..."""

    def __init__(self, parameters: Any) -> None:
        """Take over `parameters`, which `mi.traverse` has found; all lights are at their full."""
        self._parameters = parameters
        self._full: dict[str, Any] = {}  # what a parameter was before it was first changed
        self._factors: Mapping[str, float] = {}

    def set_factors(self, factors: Mapping[str, float]) -> None:
        """Let each light give `factors` times what it was made with; those not named give all.

        New values are new input to old kernels, but for the scales of sun and sky, which Mitsuba
        compiles in: one compilation for each factor. Raises LightError for a factor that is not
        finite or below 0, and for a name that no light has.
        """
        if factors == self._factors:
            return
        steady = dict.fromkeys(self._factors, 1.0)
        for name, factor in (steady | dict(factors)).items():
            if not 0 <= factor < np.inf:
                raise LightError(f"light '{name}' is to give {factor} times its light; from 0 on")
            for key in self._keys(name):
                self._scale(key, factor)
        self._parameters.update()
        self._factors = dict(factors)

    def _keys(self, name: str) -> list[str]:
        """The parameters that say how strong a light is."""
        wanted = [f"{name}.{middle}{s}" for middle in ("emitter.", "") for s in STRENGTH_PARAMETERS]
        if found := [key for key in wanted if key in self._parameters]:
            return found
        lit = [(key, s) for key in list(self._parameters.keys()) for s in STRENGTH_PARAMETERS]
        names = {
            key.removesuffix(f".{s}").removesuffix(".emitter") for key, s in lit if key.endswith(s)
        }
        have = ", ".join(sorted(n for n in names if ".bsdf" not in n)) or "none"
        raise LightError(f"no light '{name}' whose strength can change; there are: {have}")

    def _scale(self, key: str, factor: float) -> None:
        now = self._parameters[key]
        full = self._full.setdefault(key, now if isinstance(now, float) else np.array(now))
        self._parameters[key] = _like(now, full, factor)


def _like(now: Any, full: Any, factor: float) -> Any:
    """`full` times `factor` as a value of the type of `now`, opaque to the compiler."""
    import drjit as dr
    import mitsuba as mi

    if isinstance(now, float):
        return full * factor
    if isinstance(now, mi.TensorXf):
        return mi.TensorXf(
            upload(type(now.array), full * max(factor, MIN_BITMAP_FACTOR)), full.shape
        )
    values = [dr.opaque(mi.Float, float(v)) for v in np.reshape(full * factor, -1)]
    return values[0] if type(now) is mi.Float else type(now)(values)
