"""Repairs of Mitsuba XML files: old versions, plugins that are gone, files that are missing.

Mitsuba upgrades names of older files by itself. It does not read their colours in hexadecimal,
knows neither the index of the medium outside of a metal nor the BSDFs `ward` and `phong`, and turns
a sky with y up on its side. Each repair that may change the image adds a note.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rlbench.render.mitsuba.xml_nodes import file_resolver, location

__all__ = ["repair_nodes", "repair_text", "replace_missing_files"]

HEX_COLOR = re.compile(r'<s?rgb\b([^<>]*?)\bvalue\s*=\s*"\s*#([0-9a-fA-F]{6})\s*"')
SRGB_COLOR = re.compile(r'<srgb\b([^<>]*?)\bvalue\s*=\s*"([^"#]*)"')
SKIES = ("sky", "sun", "sunsky")
GREY = 0.5  # reflectance of a texture whose file is missing
METAL_BELOW = 0.01  # diffuse reflectance up to which a Ward BSDF is a metal


def repair_text(text: str) -> tuple[str, list[str]]:
    """The text of a scene file with colours as linear numbers, and a note on what changed.

    `#ffff6a` and the element `srgb` hold sRGB values (IEC 61966-2-1); Mitsuba 3 reads neither.

    >>> repair_text('<rgb name="reflectance" value="#ff0080"/>')[0]
    '<rgb name="reflectance" value="1 0 0.215861"/>'
    """

    def from_hex(match: re.Match[str]) -> str:
        return _linear_rgb(match[1], [int(match[2][i : i + 2], 16) / 255 for i in (0, 2, 4)])

    def from_srgb(match: re.Match[str]) -> str:
        return _linear_rgb(match[1], [float(v) for v in match[2].replace(",", " ").split()])

    repaired, count = HEX_COLOR.subn(from_hex, text)
    repaired, more = SRGB_COLOR.subn(from_srgb, repaired)
    total = count + more
    return repaired, [f"{total} sRGB colours are converted to linear numbers"] * (total > 0)


def repair_nodes(state: Any, version: int) -> list[str]:
    """Replace what Mitsuba 3 lacks in parsed nodes, before their upgrade; returns notes.

    `version` is the major version of the file; below 3, y is up for skies, names are in camelCase.
    """
    notes: dict[str, None] = {}
    for node in state.nodes:
        plugin, props = node.props.plugin_name(), node.props
        if plugin in ("conductor", "roughconductor"):
            _divide_by_exterior(props, notes)
        elif plugin in ("ward", "phong"):
            where = location(state, node)
            notes[f"{where}: BSDF {plugin} is rendered as {_replace_glossy(props, plugin)}"] = None
        elif plugin == "bitmap":
            _filter_bilinearly(props)
        elif plugin in SKIES:
            _turn_upright(props, plugin, version, notes)
    return list(notes)


def replace_missing_files(state: Any) -> list[str]:
    """Leave out shapes whose file is missing, and make missing textures grey; returns the files.

    A texture becomes grey of reflectance 0.5, an environment map a uniform light of radiance 1.
    """
    import mitsuba as mi

    missing, gone = [], set()
    for index, node in enumerate(state.nodes):
        names = [k for k, v in node.props.items() if k == "filename" and isinstance(v, str)]
        for key in names:
            name = str(node.props[key])
            if Path(str(file_resolver().resolve(name))).is_file():
                continue
            missing.append(name)
            del node.props[key]
            if node.type == mi.ObjectType.Shape:
                gone.add(index)
            elif node.props.plugin_name() == "envmap":
                node.props.set_plugin_name("constant")
            else:
                grey = np.full((1, 1, 3), GREY, np.float32)
                node.props["bitmap"], node.props["raw"] = mi.Bitmap(grey), True
    _remove_references(state, gone)
    return sorted(set(missing))


def _remove_references(state: Any, gone: set[int]) -> None:
    import mitsuba as mi

    for node in state.nodes:
        for key, value in list(node.props.items()):
            if isinstance(value, mi.Properties.ResolvedReference) and value.index() in gone:
                del node.props[key]


def _linear_rgb(attributes: str, values: Sequence[float]) -> str:
    linear = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values)
    return f'<rgb{attributes}value="{" ".join(f"{v:.6g}" for v in linear)}"'


def _divide_by_exterior(props: Any, notes: dict[str, None]) -> None:
    """Eta and k of a metal relative to the medium outside, as Mitsuba 3 lacks `ext_eta`."""
    key = _find_key(props, "ext_eta")
    if key is None:
        return
    outside = props[key]
    del props[key]
    if outside == 1.0:
        return
    divisible = [k for k in ("eta", "k") if isinstance(props.get(k, None), float)]
    for name in divisible if isinstance(outside, float) else ():
        props[name] = props[name] / outside
    if not (divisible and isinstance(outside, float)):
        notes["ext_eta of a conductor is ignored: air is outside"] = None


def _replace_glossy(props: Any, plugin: str) -> str:
    """Turn a Ward (1992) or Phong (Lafortune and Willems 1994) BSDF into a microfacet BSDF.

    Its roughness is the one of Walter et al. 2007, section 5.2, for a Phong exponent.
    """
    if plugin == "phong":
        across = along = math.sqrt(2 / (_take(props, "exponent", 30.0) + 2))
    else:
        across, along = _take(props, "alpha_u", 0.1), _take(props, "alpha_v", 0.1)
        _take(props, "variant", "")
    diffuse = props.get(_find_key(props, "diffuse_reflectance") or "", None)
    is_metal = diffuse is not None and np.ndim(diffuse) == 1 and np.max(diffuse) <= METAL_BELOW
    if is_metal:
        _take(props, "diffuse_reflectance", None)
        props["alpha_u"], props["alpha_v"], props["material"] = across, along, "none"
        kind = "roughconductor"
    else:
        _take(props, "specular_reflectance", None)  # Fresnel's equations decide
        props["alpha"] = math.sqrt(across * along)
        kind = "roughplastic"
    props.set_plugin_name(kind)
    return kind


def _filter_bilinearly(props: Any) -> None:
    """The filters `trilinear` and `ewa` of older versions become `bilinear`."""
    key = _find_key(props, "filter_type")
    if key and props[key] not in ("nearest", "bilinear"):
        props[key] = "bilinear"


def _turn_upright(props: Any, plugin: str, version: int, notes: dict[str, None]) -> None:
    """Skies had y up before version 3 and have z up now; the sun's direction is in world space."""
    import mitsuba as mi

    if version < 3:
        key = _find_key(props, "to_world") or "to_world"
        turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
        props[key] = props[key] @ turn if key in props else turn
    direction = props.get(_find_key(props, "sun_direction") or "", None)
    up = 1 if version < 3 else 2
    if direction is not None and _find_key(props, "to_world") and float(direction[up]) < 0:
        notes[f"the sun of {plugin} is below the horizon"] = None


def _find_key(props: Any, name: str) -> str | None:
    """The key of a property by its name today, which older files write in camelCase."""
    words = name.split("_")
    camel_case = words[0] + "".join(word.capitalize() for word in words[1:])
    return next((key for key in (name, camel_case) if key in props), None)


def _take(props: Any, name: str, default: Any) -> Any:
    """Remove a property and return its value."""
    key = _find_key(props, name)
    if key is None:
        return default
    value = props.get(key, default)
    del props[key]
    return value
