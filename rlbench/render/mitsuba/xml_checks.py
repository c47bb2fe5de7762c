"""Refuses XML scenes that Mitsuba would render wrong, or that rlbench cannot render."""

from __future__ import annotations

from typing import Any

from rlbench.render.mitsuba.xml_nodes import children, location
from rlbench.render.scene import SceneError

__all__ = ["refuse_attribute_emitters", "refuse_media", "refuse_other_sensors"]

PINHOLES = ("perspective", "thinlens")


def refuse_media(state: Any) -> None:
    """Raise SceneError for a participating medium."""
    import mitsuba as mi

    for node in state.nodes:
        if node.type in (mi.ObjectType.Medium, mi.ObjectType.Volume):
            raise SceneError(
                f"{location(state, node)}: the scene has a participating medium "
                f"({node.props.plugin_name()}), which rlbench's path tracer ignores. Remove it"
            )


def refuse_attribute_emitters(state: Any) -> None:
    """Raise SceneError for a mesh attribute as radiance; next-event estimation takes it for 0."""
    import mitsuba as mi

    for node in (n for n in state.nodes if n.type == mi.ObjectType.Emitter):
        if any(c.props.plugin_name() == "mesh_attribute" for _, c in children(state, node)):
            raise SceneError(
                f"{location(state, node)}: the emitter's radiance is a mesh attribute, of which "
                "Mitsuba's path tracer loses a large part. Give it one radiance, or a bitmap "
                "with a texel per light"
            )


def refuse_other_sensors(state: Any, node: Any) -> None:
    """Raise SceneError for a sensor that is not a centred pinhole."""
    props = node.props
    if props.plugin_name() not in PINHOLES:
        raise SceneError(
            f"{location(state, node)}: sensor {props.plugin_name()} is not supported, because "
            "motion vectors need a pinhole. Make it a perspective sensor"
        )
    if any(props.get(f"principal_point_offset_{axis}", 0.0) for axis in "xy"):
        raise SceneError(
            f"{location(state, node)}: the sensor's principal point is not in the middle of the "
            "film, which is not supported. Remove principal_point_offset_x and _y"
        )
