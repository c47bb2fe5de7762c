"""A user's Mitsuba XML: read and upgraded by Mitsuba's own parser, checked, made into objects."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rlbench.render.scene import Mesh, SceneError, XmlFile

DEPTH = 8  # longest light path where the file names no integrator, in edges
PATHS = ("path", "direct")  # integrators whose light paths are those of rlbench's
PINHOLES = ("perspective", "thinlens")
FILM = {"width": 768, "height": 576}  # pixels, Mitsuba's own default


@dataclass(frozen=True, eq=False)
class XmlSettings:
    """What an XML file says that decides how it is rendered."""

    digest: str  # of the file as parsed, and of the bytes of all files that it names
    depth: int  # longest light path, in edges; -1 is without limit
    matrix: np.ndarray | None  # camera-to-world of the first sensor; None where there is none
    fov: float  # horizontal, degrees
    aspect: float  # width of the sensor's film over its height
    notes: list[str] = field(default_factory=list)  # what is rendered otherwise than it says


def read_settings(document: XmlFile) -> XmlSettings:
    """Parse an XML file and check that this renderer can do what it asks for.

    All spellings that Mitsuba upgrades are understood, and relative paths start at the file. The
    integrator gives the longest path only; sampler and film filter are replaced by rlbench's own.
    Raises SceneError for XML errors, missing files, participating media, lights that Mitsuba would
    leave dark, and sensors that are no pinhole.
    """
    with _parsed(document, merge=False) as (_, state):
        notes: list[str] = []
        files = _files(state)
        _refuse_media(state)
        _refuse_dark_lights(state)
        matrix, fov, aspect = _sensor(state, document.path, notes)
        depth = _depth(state, notes)
        from mitsuba import parser

        words = hashlib.blake2b(parser.write_string(state).encode(), digest_size=16)
        for file in files:
            words.update(hashlib.blake2b(file.read_bytes()).digest())
    return XmlSettings(words.hexdigest(), depth, matrix, fov, aspect, notes)


def build_scene(document: XmlFile, merge: bool) -> Any:
    """The Mitsuba scene of an XML file, without its sensors and integrator.

    With `merge`, meshes of one material become one, which is faster but forgets their names.
    """
    import mitsuba as mi
    from mitsuba import parser

    with _parsed(document, merge) as (config, state):
        # of no other nodes, as properties count as used once they have been looked at
        for node in (n for n in state.nodes if n.props.plugin_name() in ("scene", "merge")):
            for name, child in _children(state, node):
                if child.type in (mi.ObjectType.Sensor, mi.ObjectType.Integrator):
                    del node.props[name]
        made = parser.instantiate(config, state)
        return made[0] if isinstance(made, list) else made


def named_meshes(document: XmlFile) -> dict[str, Mesh]:
    """The shapes of an XML file that can move, by id: meshes that were given one."""
    import mitsuba as mi

    scene = build_scene(document, merge=False)
    held = mi.traverse(scene)
    found = {}
    for name in sorted(shape.id() for shape in scene.shapes()):
        if f"{name}.vertex_positions" not in held:
            continue
        parts = (np.array(held[f"{name}.{k}"]) for k in ("vertex_positions", "faces"))
        vertices, faces = (part.reshape(-1, 3) for part in parts)
        smooth = len(held[f"{name}.vertex_normals"]) > 0
        found[name] = Mesh(
            name, vertices.astype(np.float32), faces.astype(np.uint32), {}, smooth=smooth
        )
    return found


@contextmanager
def _parsed(document: XmlFile, merge: bool) -> Iterator[tuple[Any, Any]]:
    """The parser's settings and nodes, while relative paths start at the file's folder.

    Whatever Mitsuba finds wrong rises as SceneError, with its words.
    """
    import mitsuba as mi
    from mitsuba import parser

    if not document.path.is_file():
        raise SceneError(
            f"no scene file {document.path}; --scene takes a Mitsuba XML or a .py file"
        )
    resolver = _resolver()
    before = [str(path) for path in resolver]
    resolver.prepend(str(document.path.resolve().parent))
    config = parser.ParserConfig(str(mi.variant()))
    config.merge_equivalent = config.merge_meshes = merge
    try:
        state = parser.parse_file(config, str(document.path), **dict(document.parameters))
        parser.transform_all(config, state)
        yield config, state
    except RuntimeError as error:
        raise SceneError(f"Mitsuba cannot use {document.path}: {error}") from error
    finally:
        resolver.clear()
        for path in before:
            resolver.append(path)


def _children(state: Any, node: Any) -> list[tuple[str, Any]]:
    """The names and nodes of what a node refers to."""
    import mitsuba as mi

    kind = mi.Properties.ResolvedReference
    return [(k, state.nodes[v.index()]) for k, v in node.props.items() if isinstance(v, kind)]


def _files(state: Any) -> list[Path]:
    """The files that the nodes name. Raises SceneError that lists all of those that are missing."""
    from mitsuba import parser

    found, missing = [], []
    for node in state.nodes:
        named = [v for k, v in node.props.items() if k.endswith("filename") and isinstance(v, str)]
        for name in named:
            path = Path(str(_resolver().resolve(name)))
            if path.is_file():
                found.append(path)
            else:
                missing.append(
                    f"{name}, of a {node.props.plugin_name()} at "
                    f"{parser.file_location(state, node)}"
                )
    if missing:
        raise SceneError(
            "the scene names files that are not there:\n  " + "\n  ".join(missing) + "\n"
            "relative paths start at the folder of the XML file"
        )
    return found


def _resolver() -> Any:
    """Where Mitsuba looks for files."""
    import mitsuba as mi

    find: Any = mi.file_resolver
    return find()


def _refuse_media(state: Any) -> None:
    import mitsuba as mi
    from mitsuba import parser

    for node in state.nodes:
        if node.type in (mi.ObjectType.Medium, mi.ObjectType.Volume):
            raise SceneError(
                f"{parser.file_location(state, node)}: the scene has a participating medium "
                f"({node.props.plugin_name()}), which rlbench's path tracer would leave out; "
                "remove it"
            )


def _refuse_dark_lights(state: Any) -> None:
    """Radiance by mesh attribute is what next-event estimation takes for 0, without a word."""
    import mitsuba as mi
    from mitsuba import parser

    for node in (n for n in state.nodes if n.type == mi.ObjectType.Emitter):
        if any(c.props.plugin_name() == "mesh_attribute" for _, c in _children(state, node)):
            raise SceneError(
                f"{parser.file_location(state, node)}: the light's radiance is a mesh attribute, "
                "of which Mitsuba's path tracer loses a good part; give it one radiance, or a "
                "bitmap with a texel for each light"
            )


def _depth(state: Any, notes: list[str]) -> int:
    """The longest path of the integrator, or of that within it."""
    import mitsuba as mi

    found = [node for node in state.nodes if node.type == mi.ObjectType.Integrator]
    if not found:
        return DEPTH
    node = next((n for n in found if n.props.plugin_name() in PATHS), found[0])
    kind = node.props.plugin_name()
    if kind not in PATHS:
        notes.append(f"integrator {kind} is replaced by path")
    if node.props.get("hide_emitters", False):
        notes.append("hide_emitters is ignored: lights and sky are seen")
    return 2 if kind == "direct" else int(node.props.get("max_depth", -1))


def _sensor(state: Any, file: Path, notes: list[str]) -> tuple[np.ndarray | None, float, float]:
    """Camera-to-world matrix, horizontal field of view, and aspect of the first sensor."""
    import mitsuba as mi
    from mitsuba import parser

    sensors = [n for n in state.nodes if n.type == mi.ObjectType.Sensor]
    if not sensors:
        return None, 60.0, 1.0
    node = sensors[0]
    props, kind = node.props, node.props.plugin_name()
    if len(sensors) > 1:
        notes.append(f"the first of {len(sensors)} sensors is used")
    if kind not in PINHOLES:
        raise SceneError(
            f"{parser.file_location(state, node)}: sensor {kind} is not supported, as motion "
            f"vectors need a pinhole; make it a perspective sensor"
        )
    if kind == "thinlens":
        notes.append("thinlens is rendered as a pinhole: everything is sharp")
    if any(props.get(f"principal_point_offset_{axis}", 0.0) for axis in "xy"):
        raise SceneError(
            f"{parser.file_location(state, node)}: the sensor's principal point is not in the "
            "middle of the picture, which is not supported; remove principal_point_offset_x and _y"
        )
    film = next((n for _, n in _children(state, node) if n.type == mi.ObjectType.Film), None)
    width, height = (int(film.props.get(k, d)) if film else d for k, d in FILM.items())
    lens = {k: props[k] for k in ("fov", "fov_axis", "focal_length") if k in props}
    same = mi.load_dict(
        {
            "type": "perspective",
            **lens,
            "film": {"type": "hdrfilm", "width": width, "height": height},
        }
    )
    fov = float(np.array(mi.traverse(same)["x_fov"]).reshape(-1)[0])
    place = props.get("to_world", None)
    matrix = np.eye(4) if place is None else np.array(place.matrix, np.float64)
    return matrix, fov, width / height
