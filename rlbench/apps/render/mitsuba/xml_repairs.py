"""Repairs of Mitsuba XML files of old versions: colours, plugins and properties that are gone.

Mitsuba upgrades names of older files by itself. It does not read their colours in hexadecimal,
knows neither the index of the medium outside of a metal nor the BSDFs `ward` and `phong`, and turns
a sky with y up on its side. Each repair that may change the image adds a note.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.mitsuba.xml_files import SURFACE_MAPS, add_node, line, peek

COLOR = re.compile(r"<(s?rgb)\b([^<>]*?)\bvalue\s*=\s*([\"'])\s*([^\"']*?)\s*\3")
OUTSIDE = {"vacuum": 1.0, "air": 1.0, "water": 1.333}  # index of refraction, by Mitsuba 0.6's names
Y_UP = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]  # turns z up into it
UNUSED = ("max_anisotropy", "cache", "resolution")  # of Mitsuba 0.6, and without effect here
IGNORED = {  # properties of Mitsuba 0.6 that remain after repairs, and change the image
    "bitmap": ("gamma", "wrap_mode_u", "wrap_mode_v"),
    "envmap": ("gamma",),
    # a sun of 19 times the radius has as much light, and four times the variance in Mitsuba 3
    "sunsky": ("sun_radius_scale", "stretch", "extend"),
    **dict.fromkeys(("conductor", "roughconductor"), ("ext_eta",)),
    **dict.fromkeys(("obj", "ply", "serialized"), ("max_smooth_angle",)),
}
SHOWN = 4  # lines of the file in a note

Notes = dict[str, list[str]]  # lines of the file, by what happened there


def repair_text(text: str) -> tuple[str, list[str]]:
    """The text of a scene file with colours as linear numbers, and a note on what changed.

    `#ffff6a` and the element `srgb` hold sRGB values (IEC 61966-2-1); Mitsuba 3 reads neither.

    >>> repair_text('<rgb name="reflectance" value="#ff0080"/>')[0]
    '<rgb name="reflectance" value="1 0 0.215861"/>'
    """
    count = 0

    def to_linear(match: re.Match[str]) -> str:
        element, attributes, quote, value = match.groups()
        if re.fullmatch("#[0-9a-fA-F]{6}", value):
            colour = [byte / 255 for byte in bytes.fromhex(value[1:])]
        elif element == "srgb" and "$" not in value:
            colour = [float(v) for v in value.replace(",", " ").split()]
        else:
            return match[0]
        nonlocal count
        count += 1
        return f"<rgb{attributes}value={quote}{_decode_srgb(colour)}{quote}"

    repaired = COLOR.sub(to_linear, text)
    return repaired, [f"{count} sRGB colours are converted to linear numbers"] if count else []


def repair_nodes(state: Any) -> Notes:
    """Replace plugins and properties that Mitsuba 3 lacks, in place.

    The nodes must have been upgraded, and their references resolved.
    """
    notes: Notes = {}
    for index in range(len(state.nodes)):  # nodes that repairs append need none
        node = state.nodes[index]
        plugin, where = node.props.plugin_name(), line(state, node)
        if plugin in ("sky", "sun", "sunsky"):
            is_y_up = int(str(state.versions[node.file_index]).split(".")[0]) < 3
            found = _repair_sky(node, is_y_up)
        elif plugin in ("ward", "phong"):
            found = [f"BSDF {plugin} is rendered as {_split_lobes(state, index)}"]
        elif plugin == "bitmap":
            found = _repair_bitmap(node)
        elif plugin in SURFACE_MAPS and "filename" in node.props:
            found = _move_file(state, index)
        elif plugin in ("conductor", "roughconductor"):
            found = _divide_by_outside(node)
        else:
            found = []
        for note in [*found, *_drop_properties(state.nodes[index])]:
            notes.setdefault(note, []).append(where)
    return notes


def is_night(node: Any) -> bool:
    """True if the sun of a `sunsky` with a direction is below the horizon."""
    found = peek(node)
    if node.props.plugin_name() != "sunsky" or "sun_direction" not in found:
        return False
    rotation = np.array(found["to_world"].matrix)[:3, :3] if "to_world" in found else np.eye(3)
    return bool((np.linalg.inv(rotation) @ np.array(found["sun_direction"]))[2] < 0)


def describe_repairs(notes: Notes) -> list[str]:
    """One sentence for each kind of repair, with the first lines."""
    return [
        f"{what} (line {', '.join(lines[:SHOWN])}{', ...' * (len(lines) > SHOWN)})"
        for what, lines in notes.items()
    ]


def _decode_srgb(display: Sequence[float]) -> str:
    linear = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in display)
    return " ".join(f"{v:.6g}" for v in linear)


def _drop_properties(node: Any) -> list[str]:
    """Remove what Mitsuba 3 does not have, with a note where that may change the image."""
    plugin, props = node.props.plugin_name(), node.props
    ignored = [name for name in IGNORED.get(plugin, ()) if name in props]
    unused = [name for name in UNUSED if name in props and plugin in IGNORED]
    for name in (*ignored, *unused):
        del props[name]
    return [f"{name} of {plugin} is ignored" for name in ignored]


def _repair_sky(node: Any, is_y_up: bool) -> list[str]:
    """Make `sky`, `sun` and `sunsky` a `sunsky` with z up, which Mitsuba 3 has."""
    import mitsuba as mi

    props, found, plugin = node.props, peek(node), node.props.plugin_name()
    if is_y_up:
        to_world = np.array(found["to_world"].matrix) if "to_world" in found else np.eye(4)
        props["to_world"] = mi.ScalarTransform4d(to_world @ Y_UP)
    if plugin != "sunsky":
        dark = {"sky": "sun", "sun": "sky"}[plugin]
        props[f"{plugin}_scale"], props[f"{dark}_scale"] = found.get("scale", 1.0), 0.0
        props.set_plugin_name("sunsky")
        if "scale" in found:
            del props["scale"]
    if "sun_direction" in found:
        return ["the sun is below the horizon"] * is_night(node)
    return ["the azimuth of the sun may differ"] * is_y_up


def _repair_bitmap(node: Any) -> list[str]:
    """Filter bilinearly; take one wrap mode for both axes, and `raw` for a gamma of 1."""
    props, found = node.props, peek(node)
    if found.get("filter_type", "bilinear") not in ("nearest", "bilinear"):
        props["filter_type"] = "bilinear"  # rays have no footprint
    if "wrap_mode_u" in found and found["wrap_mode_u"] == found.get("wrap_mode_v"):
        props["wrap_mode"] = found["wrap_mode_u"]
        del props["wrap_mode_u"], props["wrap_mode_v"]
    if found.get("gamma") == 1.0:
        props["raw"] = True
        del props["gamma"]
    return []


def _move_file(state: Any, index: int) -> list[str]:
    """Make the file of a bump or normal map that of a texture within."""
    import mitsuba as mi

    plugin, name = state.nodes[index].props.plugin_name(), peek(state.nodes[index])["filename"]
    texture = mi.Properties("bitmap")
    texture["filename"], texture["raw"] = name, True
    reference = add_node(state, index, texture)
    state.nodes[reference.index()].type = mi.ObjectType.Texture
    del state.nodes[index].props["filename"]
    state.nodes[index].props["normalmap" if plugin == "normalmap" else "texture"] = reference
    return []


def _divide_by_outside(node: Any) -> list[str]:
    """Eta and k of a metal relative to the medium outside, as Mitsuba 3 lacks `ext_eta`."""
    props, found = node.props, peek(node)
    outside = found.get("ext_eta")
    index = OUTSIDE.get(outside) if isinstance(outside, str) else outside
    constants = {n: c for n in ("eta", "k") if (c := _constant(found.get(n))) is not None}
    if index and len(constants) == 2:
        for name, colour in constants.items():
            props[name] = _rgb(colour / index)
    if index and (index == 1.0 or len(constants) == 2):
        del props["ext_eta"]
    return []


def _split_lobes(state: Any, index: int) -> str:
    """Make a Ward (1992) or Phong (Lafortune and Willems 1994) BSDF a blend of two; names them.

    Its lobes become a diffuse BSDF and a microfacet BSDF without a Fresnel term. The reflectance
    of each is divided by its weight in the blend, so the sum is kept, unless it is a texture. The
    roughness of a Phong exponent is that of Walter et al. 2007, section 5.2.
    """
    import mitsuba as mi

    node = state.nodes[index]
    plugin, found = node.props.plugin_name(), peek(node)
    base, coat = found.get("diffuse_reflectance", 0.5), found.get("specular_reflectance", 0.2)
    diffuse, glossy = (0.5 if (c := _constant(v)) is None else c.max() for v in (base, coat))
    weight = float(glossy / max(1.0, diffuse + glossy)) if diffuse else 1.0
    exponent = found.get("exponent", 30.0)
    phong = math.sqrt(2 / (2 + (exponent if isinstance(exponent, float) else 30.0)))

    metal = mi.Properties("roughconductor")
    metal["material"] = "none"  # reflects everything
    metal["specular_reflectance"] = _divide(coat, weight)
    for name in ("alpha_u", "alpha_v"):
        metal[name] = found.get(name, 0.1) if plugin == "ward" else phong
    metal.set_id(node.props.id())
    if weight == 1.0:
        node.props = metal
        return "roughconductor"
    matte = mi.Properties("diffuse")
    matte["reflectance"] = _divide(base, 1 - weight)
    blend = mi.Properties("blendbsdf")
    blend.set_id(node.props.id())
    blend["weight"] = weight
    for name, props in (("matte", matte), ("metal", metal)):  # weight 0 is the first
        props.set_id("")
        blend[name] = add_node(state, index, props)
    state.nodes[index].props = blend
    return "a blend of diffuse and roughconductor"


def _divide(reflectance: Any, weight: float) -> Any:
    """A reflectance divided by a weight, at most 1; a texture is unchanged."""
    constant = _constant(reflectance)
    return reflectance if constant is None else _rgb((constant / max(weight, 1e-6)).clip(0, 1))


def _constant(value: Any) -> Float[Array, "3"] | None:
    """A number, colour or uniform spectrum as RGB; None for a texture or anything else."""
    import mitsuba as mi

    if len(getattr(value, "wavelengths", [0])) == 0 and len(value.values) == 1:
        return np.full(3, value.values[0])
    is_constant = isinstance(value, float | mi.ScalarColor3d)
    return np.broadcast_to(np.array(value, np.float64), 3) if is_constant else None


def _rgb(colour: Float[Array, "3"]) -> Any:
    import mitsuba as mi

    return mi.ScalarColor3d(*colour.tolist())
