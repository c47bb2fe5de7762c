"""Materials of the test scenes as Mitsuba plugins: matte, glossy, metal and polished."""

from __future__ import annotations

from typing import Any


def rgb(red: float, green: float, blue: float) -> dict[str, Any]:
    """A constant linear RGB colour."""
    return {"type": "rgb", "value": [red, green, blue]}


def diffuse_bsdf(reflectance: dict[str, Any]) -> dict[str, Any]:
    """A matte surface on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def glossy_bsdf(reflectance: dict[str, Any], alpha: float) -> dict[str, Any]:
    """A coloured base under a clear coat of roughness `alpha`, on both sides."""
    coat = {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": alpha}
    return {"type": "twosided", "bsdf": coat}


def metal_bsdf(reflectance: dict[str, Any], alpha: float) -> dict[str, Any]:
    """A conductor tinted by `reflectance`, with roughness `alpha`, on both sides."""
    plain = {"type": "roughconductor", "specular_reflectance": reflectance, "alpha": alpha}
    return {"type": "twosided", "bsdf": plain}


def polished_bsdf(reflectance: dict[str, Any]) -> dict[str, Any]:
    """A coloured base under a perfectly smooth clear coat, on both sides."""
    return {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": reflectance}}
