"""Metallic-roughness materials of glTF as BSDFs and area lights of Mitsuba.

A material becomes `principled` (Burley 2012), without `metallic` and with a thin surface where it
transmits light and encloses no volume (`principledthin`). Factors are multiplied into the texels.
What has no counterpart is noted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.gltf.document import Document
from rlbench.apps.render.scene import MitsubaDict

WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
NEAREST = 9728
MAX_F0 = 0.9  # reflectance at normal incidence of the least transparent dielectric
LEVELS = np.arange(256) / 255
# IEC 61966-2-1
DECODED = np.where(LEVELS <= 0.04045, LEVELS / 12.92, ((LEVELS + 0.055) / 1.055) ** 2.4)
SPECULAR_LOSS = 0.78  # part of a dielectric's average reflectance that the diffuse lobe lacks
COLOR, ALPHA, UV = "vertex_color", "vertex_alpha", "vertex_uv{}"  # attributes of a mesh
READ = {  # extensions of materials and textures that are read here
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_texture_transform",
    "EXT_texture_webp",
}


@dataclass(frozen=True)
class Surface:
    """A material: what Mitsuba needs, and what its meshes have to provide."""

    bsdf: MitsubaDict
    emission: MitsubaDict | None = None
    is_double_sided: bool = False
    uv_sets: tuple[int, ...] = ()  # the first is the mesh's own, others are attributes of it
    has_normal_map: bool = False


@dataclass
class _Reader:
    """Reads one material."""

    document: Document
    has_colors: bool  # have the vertices colours?
    uv_sets: list[int] = field(default_factory=list)

    def texture(
        self, info: Any, channels: slice, factor: Float[Array, " c"], is_color: bool
    ) -> MitsubaDict | Float[Array, " c"]:
        """A texture times a factor per channel; the factor alone if there is no texture.

        `info` is a texture info, as an object or a dict. Colours are sRGB, all else is linear.
        """
        if info is None:
            return factor
        index, uv_set, more = _info(info)
        texture = self.document.tree.textures[index]
        webp = (texture.extensions or {}).get("EXT_texture_webp", {})
        source = webp.get("source", texture.source)
        if source is None:
            self.document.notes["textures without an image that can be read are left out"] += 1
            return factor
        texels = self.document.image(source)[..., channels]
        return self.place(_bitmap(texels, factor, is_color), texture, uv_set, more)

    def place(
        self, bitmap: MitsubaDict, texture: Any, uv_set: int, more: Mapping[str, Any]
    ) -> MitsubaDict:
        """A bitmap with the sampler, the coordinates and the transform of a texture."""
        sampler = None
        if texture.sampler is not None:
            sampler = self.document.tree.samplers[texture.sampler]
            wraps = [WRAP.get(wrap or 10497, "repeat") for wrap in (sampler.wrapS, sampler.wrapT)]
            if wraps[0] != wraps[1]:
                self.document.notes["textures that wrap otherwise along v do so as along u"] += 1
            bitmap = {**bitmap, "wrap_mode": wraps[0]}
        if sampler and sampler.magFilter == NEAREST:
            bitmap = {**bitmap, "filter_type": "nearest"}
        if more:
            uv_set = more.get("texCoord", uv_set)
            bitmap = {**bitmap, "to_uv": _uv_transform(more)}
        if uv_set not in self.uv_sets:
            self.uv_sets.append(uv_set)
        if uv_set == self.uv_sets[0]:
            return bitmap
        return {"type": "mesh_texture", "uv": UV.format(uv_set), "texture": bitmap}

    def tinted(self, color: Any, channels: int = 3) -> Any:
        """A colour or texture times the colours of the vertices, where these have any."""
        value = _constant(color) if channels == 3 else _value(color)
        if not self.has_colors:
            return value
        if not isinstance(value, Mapping):
            value = {"type": "uniform", "value": value}
        inner = value.get("texture", value)
        name = COLOR if channels == 3 else ALPHA
        return {"type": "mesh_texture", "uv": value.get("uv", ""), "color": name, "texture": inner}


def read_material(document: Document, index: int | None, has_colors: bool) -> Surface:
    """The material `index`, or glTF's default material, for vertices with or without colours."""
    from pygltflib import Material

    material = Material() if index is None else document.tree.materials[index]
    extensions = material.extensions or {}
    for name in sorted(set(extensions) - READ):
        document.notes[f"{name} is ignored"] += 1
    reader = _Reader(document, has_colors)
    emission = _emission(reader, material, extensions)  # first: lights need the mesh's own set
    pbr = material.pbrMetallicRoughness
    old = extensions.get("KHR_materials_pbrSpecularGlossiness")
    bsdf = _specular_glossiness(reader, old) if old else _metallic_roughness(reader, pbr)
    bsdf = {"type": "principled", **bsdf, **_dielectric(document, extensions)}
    info, factor = _base_color(pbr, old)
    base = reader.texture(info, slice(0, 3), factor[:3] * _energy(bsdf), is_color=True)
    bsdf |= {"base_color": reader.tinted(base), **_layers(reader, extensions)}
    if "KHR_materials_unlit" in extensions:
        document.notes["unlit materials are lit, as diffuse ones"] += 1
        bsdf = {"type": "diffuse", "reflectance": bsdf["base_color"]}
    bsdf, is_clear = _transmit(reader, extensions, bsdf)
    normal = material.normalTexture
    has_normal_map = normal is not None and normal.index is not None
    if has_normal_map:
        bsdf = _normal_map(reader, normal, bsdf)
    if not is_clear:  # glTF's back faces are culled, which a path tracer cannot do for bounces
        bsdf = {"type": "twosided", "bsdf": bsdf}
    bsdf = _cut_out(reader, material, info, factor[3], bsdf)
    return Surface(
        bsdf, emission, bool(material.doubleSided), tuple(reader.uv_sets), has_normal_map
    )


def _base_color(pbr: Any, old: Mapping[str, Any] | None) -> tuple[Any, Float[Array, "4"]]:
    """The texture info and the factor of the base colour, with alpha."""
    if old:
        return old.get("diffuseTexture"), _floats(old.get("diffuseFactor"), (1, 1, 1, 1))
    if pbr is None:
        return None, np.ones(4)
    return pbr.baseColorTexture, _floats(pbr.baseColorFactor, (1, 1, 1, 1))


def _energy(bsdf: Mapping[str, Any]) -> float:
    """A factor on the base colour with which a white surface reflects what it receives.

    `principled` adds the specular lobe to the diffuse one and reflects up to 1.08, or 1.2 with a
    high index; Cycles and glTF's own model take it away from the diffuse. The average reflectance
    of a dielectric is the fit of Kulla and Conty 2017, Revisiting Physically Based Shading at
    Imageworks; with SPECULAR_LOSS, white reflects 0.98 to 1.02 up to a roughness of 0.8.
    """
    eta = 1.0 if "specular" in bsdf else bsdf.get("eta", 1.5)
    metallic = bsdf.get("metallic", 0.0)
    if isinstance(metallic, Mapping):
        metallic = float(metallic.get("texture", metallic)["bitmap"].mean()) / 255
    return float(1 - SPECULAR_LOSS * (1 - metallic) * (eta - 1) / (4.08567 + 1.00071 * eta))


def _metallic_roughness(reader: _Reader, pbr: Any) -> dict[str, Any]:
    """The parameters of a metallic-roughness material but its base colour."""
    if pbr is None:
        return {"roughness": 1.0, "metallic": 1.0}
    values = {}
    for name, channel, given in (
        ("roughness", 1, pbr.roughnessFactor),
        ("metallic", 2, pbr.metallicFactor),
    ):
        texels = slice(channel, channel + 1)
        factors = _floats(None if given is None else [given], (1,))
        values[name] = _value(reader.texture(pbr.metallicRoughnessTexture, texels, factors, False))
    return values


def _specular_glossiness(reader: _Reader, found: Mapping[str, Any]) -> dict[str, Any]:
    """The same for the older specular-glossiness, whose specular colour becomes a grey one."""
    reader.document.notes["specular colours of specular-glossiness materials are made grey"] += 1
    gloss, info = found.get("glossinessFactor", 1.0), found.get("specularGlossinessTexture")
    f0 = float(_floats(found.get("specularFactor"), (1, 1, 1)).mean())
    roughness = reader.texture(info, slice(3, 4), np.array([gloss]), is_color=False)
    if isinstance(roughness, Mapping):
        inner = roughness.get("texture", roughness)
        inverse = {**inner, "bitmap": 255 - inner["bitmap"]}
        roughness = {**roughness, "texture": inverse} if inner is not roughness else inverse
        f0 *= _mean(reader, info)
    else:
        roughness = 1 - roughness
    return {"roughness": _value(roughness), **_fresnel(f0)}


def _dielectric(document: Document, extensions: Mapping[str, Any]) -> dict[str, Any]:
    """The reflectance at normal incidence of KHR_materials_ior and KHR_materials_specular."""
    if not {"KHR_materials_ior", "KHR_materials_specular"} & set(extensions):
        return {}
    ior = extensions.get("KHR_materials_ior", {}).get("ior", 1.5)
    f0 = ((ior - 1) / (ior + 1)) ** 2 if ior else 1.0
    specular = extensions.get("KHR_materials_specular", {})
    colour = _floats(specular.get("specularColorFactor"), (1, 1, 1))
    if colour.std() > 0.02 or "specularColorTexture" in specular:
        document.notes["specular colours and textures are replaced by their mean"] += 1
    reader = _Reader(document, False)
    tint = float(colour.mean()) * _mean(reader, specular.get("specularColorTexture"))
    weight = specular.get("specularFactor", 1.0)
    if "specularTexture" in specular:
        weight *= _mean(reader, specular["specularTexture"], slice(3, 4), is_color=False)
    return _fresnel(min(f0 * tint, 1.0) * weight)


def _fresnel(f0: float) -> dict[str, Any]:
    """The parameter of `principled` for a reflectance at normal incidence, at most MAX_F0."""
    root = min(f0, MAX_F0) ** 0.5
    return {"eta": (1 + root) / (1 - root)} if f0 > 1e-4 else {"specular": 0.0}


def _layers(reader: _Reader, extensions: Mapping[str, Any]) -> dict[str, Any]:
    """Clear coat and sheen."""
    layers = {}
    if coat := extensions.get("KHR_materials_clearcoat"):
        factor = np.array([coat.get("clearcoatFactor", 0.0)])
        layers["clearcoat"] = _value(
            reader.texture(coat.get("clearcoatTexture"), slice(0, 1), factor, is_color=False)
        )
        layers["clearcoat_gloss"] = 1 - coat.get("clearcoatRoughnessFactor", 0.0)
    if sheen := extensions.get("KHR_materials_sheen"):
        layers["sheen"] = float(_floats(sheen.get("sheenColorFactor"), (0, 0, 0)).mean())
    return layers


def _transmit(
    reader: _Reader, extensions: Mapping[str, Any], bsdf: dict[str, Any]
) -> tuple[dict[str, Any], bool]:
    """The BSDF with transmission, and whether it has any."""
    found = extensions.get("KHR_materials_transmission")
    if not found or bsdf["type"] != "principled":
        return bsdf, False
    factor = np.array([found.get("transmissionFactor", 0.0)])
    share = reader.texture(found.get("transmissionTexture"), slice(0, 1), factor, is_color=False)
    if not isinstance(share, Mapping) and not share[0]:
        return bsdf, False
    volume = extensions.get("KHR_materials_volume", {})
    if "attenuationColor" in volume:
        reader.document.notes["absorption inside of volumes is ignored"] += 1
    bsdf = {**bsdf, "spec_trans": _value(share)}
    if bsdf.pop("specular", None) is not None:  # no reflection is no refraction
        bsdf["eta"] = 1.0001
    if volume.get("thicknessFactor", 0.0) > 0:
        return bsdf, True
    thin = {"base_color", "roughness", "eta", "spec_trans", "sheen"}
    return {"type": "principledthin", **{k: v for k, v in bsdf.items() if k in thin}}, True


def _normal_map(reader: _Reader, normal: Any, bsdf: dict[str, Any]) -> dict[str, Any]:
    """`bsdf` behind a normal map whose slopes are scaled."""
    texture = reader.texture(normal, slice(0, 3), np.ones(3), is_color=False)
    scale = 1.0 if normal.scale is None else normal.scale
    if not isinstance(texture, Mapping):
        return bsdf
    inner = texture.get("texture", texture)
    if scale != 1.0:
        slopes = inner["bitmap"][..., :2].astype(np.float32) / 127.5 - 1
        packed = np.rint((slopes * scale).clip(-1, 1) * 127.5 + 127.5).astype(np.uint8)
        inner = {**inner, "bitmap": np.concatenate([packed, inner["bitmap"][..., 2:]], -1)}
    texture = {**texture, "texture": inner} if "texture" in texture else inner
    return {"type": "normalmap", "normalmap": texture, "bsdf": bsdf}


def _cut_out(
    reader: _Reader, material: Any, info: Any, alpha: float, bsdf: dict[str, Any]
) -> dict[str, Any]:
    """`bsdf` with the opacity of the base colour's alpha, where it is needed."""
    if material.alphaMode not in ("MASK", "BLEND"):
        return bsdf
    opacity: Any = reader.texture(info, slice(3, 4), np.array([alpha]), is_color=False)
    inner = opacity.get("texture", opacity) if isinstance(opacity, Mapping) else None
    cutoff = 0.5 if material.alphaCutoff is None else material.alphaCutoff
    if inner is None:
        if material.alphaMode == "MASK":
            opacity = np.array([float(alpha >= cutoff)])
    elif material.alphaMode == "MASK":
        mask = np.where(inner["bitmap"] >= 255 * cutoff, 255, 0).astype(np.uint8)
        inner = {**inner, "bitmap": mask}
        opacity = {**opacity, "texture": inner} if "texture" in opacity else inner
    least = inner["bitmap"].min() / 255 if inner is not None else float(opacity[0])
    if least == 1.0 and not reader.has_colors:
        return bsdf
    return {"type": "mask", "opacity": reader.tinted(opacity, channels=1), "bsdf": bsdf}


def _emission(
    reader: _Reader, material: Any, extensions: Mapping[str, Any]
) -> dict[str, Any] | None:
    """The area light of a material, in nits as radiance, or None."""
    strength = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    factor = _floats(material.emissiveFactor, (0, 0, 0)) * strength
    if not factor.any():
        return None
    texture = reader.texture(material.emissiveTexture, slice(0, 3), factor, is_color=True)
    inner = texture.get("texture", texture) if isinstance(texture, Mapping) else None
    if inner is not None and not inner.get("bitmap", inner.get("data")).any():
        return None
    return {"type": "area", "radiance": _constant(texture) if inner is None else texture}


def _bitmap(texels: Array, factor: Float[Array, " c"], is_color: bool) -> dict[str, Any]:
    """A bitmap of 8 bit texels times a factor."""
    if (factor == 1).all():
        return {"type": "bitmap", "bitmap": texels, "raw": not is_color}
    if factor.max() <= 1:  # 8 bits again, which keeps memory low
        levels = np.outer(factor, DECODED if is_color else LEVELS)  # c 256
        table = np.rint(255 * (_encode(levels) if is_color else levels)).astype(np.uint8)
        scaled = np.stack([row[texels[..., c]] for c, row in enumerate(table)], -1)
        return {"type": "bitmap", "bitmap": scaled, "raw": not is_color}
    linear = (DECODED if is_color else LEVELS).astype(np.float32)[texels]
    return {"type": "bitmap", "data": linear * factor.astype(np.float32), "raw": True}


def _encode(linear: Array) -> Array:
    """sRGB values of linear ones (IEC 61966-2-1), both in [0, 1]."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _mean(
    reader: _Reader, info: Any, channels: slice = slice(0, 3), is_color: bool = True
) -> float:
    """The mean of the texels of a texture; 1 without a texture."""
    bitmap = reader.texture(info, channels, np.ones(channels.stop - channels.start), is_color)
    if not isinstance(bitmap, Mapping):
        return 1.0
    texels = bitmap.get("texture", bitmap)["bitmap"]
    return float((DECODED if is_color else LEVELS)[texels].mean())


def _info(info: Any) -> tuple[int, int, Mapping[str, Any]]:
    """Index, set of texture coordinates, and transform of a texture info."""
    if not isinstance(info, Mapping):
        info = vars(info)
    transform = (info.get("extensions") or {}).get("KHR_texture_transform", {})
    return info["index"], info.get("texCoord") or 0, transform


def _uv_transform(found: Mapping[str, Any]) -> Float[Array, "3 3"]:
    """Translation times rotation times scale, as KHR_texture_transform multiplies them."""
    (x, y), (u, v) = found.get("offset", (0, 0)), found.get("scale", (1, 1))
    sine, cosine = np.sin(found.get("rotation", 0.0)), np.cos(found.get("rotation", 0.0))
    return np.array([[cosine * u, sine * v, x], [-sine * u, cosine * v, y], [0, 0, 1]])


def _floats(values: Any, default: tuple[float, ...]) -> Float[Array, " c"]:
    return np.array(default if values is None else values, np.float64)


def _constant(value: Any) -> Any:
    """A colour as a texture; a texture as it is."""
    if isinstance(value, Mapping):
        return value
    return {"type": "rgb", "value": [float(v) for v in value]}


def _value(value: Any) -> Any:
    """An array of one number as this number; a texture as it is."""
    return value if isinstance(value, Mapping) else float(np.ravel(value)[0])
