"""The texture `mesh_texture`: another one by further texture coordinates, times vertex colours.

Mitsuba's bitmaps know one set of coordinates, and nothing multiplies two textures. `uv` and `color`
name vertex attributes of the mesh, of three channels; those for `eval_1`, such as opacity, of one.
Either may be left out. It is not radiance: next-event estimation takes attributes of a mesh for 0.
"""

from __future__ import annotations

from functools import cache
from typing import Any


def register() -> None:
    """Make `mesh_texture` known to the Mitsuba variant in use."""
    import mitsuba as mi

    _register(mi.variant())


@cache
def _register(variant: str) -> None:
    import mitsuba as mi  # the class can be defined only after a variant is set

    class MeshTexture(mi.Texture):
        """The texture, with its nested one."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.uv, self.color = props.get("uv", ""), props.get("color", "")
            self.texture = props["texture"]

        def eval(self, si: Any, active: Any = True) -> Any:
            return _evaluate(self, "", si, active)

        def eval_1(self, si: Any, active: Any = True) -> Any:
            return _evaluate(self, "_1", si, active)

        def eval_3(self, si: Any, active: Any = True) -> Any:
            return _evaluate(self, "_3", si, active)

        def is_spatially_varying(self) -> bool:
            return True

        def traverse(self, callback: Any) -> None:
            callback.put("texture", self.texture, mi.ParamFlags.Differentiable)

    mi.register_texture("mesh_texture", MeshTexture)


def _evaluate(texture: Any, channels: str, si: Any, active: Any) -> Any:
    """The nested texture at a surface; `channels` ends the names of Mitsuba's functions."""
    import mitsuba as mi

    place = si
    if texture.uv:
        place = mi.SurfaceInteraction3f(si)
        coordinates = si.shape.eval_attribute_3(texture.uv, si, active)
        place.uv = mi.Point2f(coordinates.x, coordinates.y)
    value = getattr(texture.texture, f"eval{channels}")(place, active)
    if texture.color:
        value *= getattr(si.shape, f"eval_attribute{channels}")(texture.color, si, active)
    return value
