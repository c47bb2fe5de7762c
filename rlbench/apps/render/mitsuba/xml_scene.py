"""A user's Mitsuba XML file: parsed and upgraded by Mitsuba, checked, and built as a scene."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from rlbench.apps.render.mitsuba import xml_files, xml_repairs, xml_text
from rlbench.apps.render.mitsuba.xml_files import children, file_resolver
from rlbench.apps.render.scene import Mesh, SceneError, XmlFile

MAX_DEPTH = 8  # longest light path, in edges, if the file has no integrator
MAX_SIDE = 2**16  # pixels of a film
PATH_INTEGRATORS = ("path", "direct")  # integrators that trace the same light paths as rlbench
FILM = {"width": 768, "height": 576}  # pixels, Mitsuba's default
REPAIRS_VERSION = 1  # raised whenever `xml_repairs` changes what is rendered


@dataclass(frozen=True, eq=False)
class XmlSettings:
    """What an XML file specifies beyond shapes, BSDFs and emitters."""

    digest: str  # of the parsed file and of the bytes of all files it refers to
    max_depth: int  # longest light path, in edges; -1: unlimited
    camera_to_world: np.ndarray | None  # of the first sensor; None if there is no sensor
    fov: float  # horizontal, degrees
    aspect: float  # width of the sensor's film divided by its height
    notes: list[str] = field(default_factory=list)  # differences between the file and the rendering
    missing_files: tuple[str, ...] = ()  # that are left out


class _ParsedFile(NamedTuple):
    """A file as Mitsuba's parser sees it, after repairs."""

    config: Any
    state: Any
    notes: list[str]
    missing_files: list[str]


def read_settings(xml_file: XmlFile) -> XmlSettings:
    """Parse an XML file and check that it can be rendered.

    Every version that Mitsuba upgrades is accepted; relative paths start at the folder of the file.
    Of the integrator only the maximum depth is used; rlbench's own sampler and box filter replace
    those of the file. What Mitsuba 3 does not read is repaired (`xml_repairs`), and missing files
    are replaced if the XmlFile skips them (`xml_files`), each with a note. Raises SceneError for
    XML errors, missing files, participating media, emitters that Mitsuba renders too dark, and
    sensors that are not a pinhole.
    """
    with _parse(xml_file, merge=False) as (_, state, repairs, missing_files):
        notes = [*repairs]
        files, _ = xml_files.find_files(state)
        xml_files.refuse_media(state)
        xml_files.refuse_attribute_emitters(state)
        camera_to_world, fov, aspect = _read_sensor(state, notes)
        max_depth = _read_max_depth(state, notes)
        content = f"{xml_file.parameters} {missing_files} {REPAIRS_VERSION}{xml_file.sky}"
        digest = hashlib.blake2b(content.encode(), digest_size=16)
        for file in (xml_file.path, *files):
            digest.update(hashlib.blake2b(file.read_bytes()).digest())
    return XmlSettings(
        digest.hexdigest(), max_depth, camera_to_world, fov, aspect, notes, tuple(missing_files)
    )


def build_scene(xml_file: XmlFile, merge: bool) -> Any:
    """The Mitsuba scene of an XML file, without its sensors and integrator.

    With `merge`, meshes that share a BSDF become one, which is faster but loses their ids.
    """
    import mitsuba as mi

    kinds = ("Sensor", "Integrator", "Sampler", "Film", "ReconstructionFilter")
    replaced = [getattr(mi.ObjectType, kind) for kind in kinds]
    with _parse(xml_file, merge) as (config, state, *_):
        for node in (n for n in state.nodes if n.props.plugin_name() in ("scene", "merge")):
            for name, child in children(state, node):
                if child.type in replaced:
                    del node.props[name]
        level = mi.log_level()
        if any(map(xml_repairs.is_night, state.nodes)):  # a note says so, once
            mi.set_log_level(mi.LogLevel.Error)
        try:
            scene = _instantiate(config, state, xml_file.skip_missing)
        finally:
            mi.set_log_level(level)
        return scene[0] if isinstance(scene, list) else scene


def _instantiate(config: Any, state: Any, skip_broken: bool) -> Any:
    """The scene of parsed nodes; with `skip_broken`, without meshes that cannot be read."""
    import mitsuba as mi
    from mitsuba import parser

    while True:
        try:
            return parser.instantiate(config, state)
        except RuntimeError as error:
            index = xml_files.find_broken_shape(state, str(error)) if skip_broken else None
            if index is None:
                raise
            log: Any = mi.Log
            log(mi.LogLevel.Warn, f"a shape is left out, because it cannot be read: {error}")
            xml_files.remove_node(state, index)


def named_meshes(xml_file: XmlFile) -> dict[str, Mesh]:
    """The meshes of an XML file that have an id, and can therefore be animated, by id."""
    import mitsuba as mi

    scene = build_scene(xml_file, merge=False)
    parameters = mi.traverse(scene)
    meshes = {}
    for name in sorted(shape.id() for shape in scene.shapes()):
        if f"{name}.vertex_positions" not in parameters:
            continue
        buffers = (np.array(parameters[f"{name}.{k}"]) for k in ("vertex_positions", "faces"))
        vertices, faces = (buffer.reshape(-1, 3) for buffer in buffers)
        smooth = len(parameters[f"{name}.vertex_normals"]) > 0
        meshes[name] = Mesh(
            name, vertices.astype(np.float32), faces.astype(np.uint32), {}, smooth=smooth
        )
    return meshes


@contextmanager
def _parse(xml_file: XmlFile, merge: bool) -> Iterator[_ParsedFile]:
    """A parsed and repaired file; inside, relative paths start at the file's folder.

    Raises Mitsuba's errors as SceneError, with their message.
    """
    import mitsuba as mi
    from mitsuba import parser

    path = xml_file.path
    if not path.is_file():
        raise SceneError(
            f"scene file {path} does not exist; render takes a Mitsuba XML or .py file"
        )
    resolver = file_resolver()
    saved = [str(folder) for folder in resolver]
    resolver.prepend(str(path.resolve().parent))
    config = parser.ParserConfig(str(mi.variant()))
    config.merge_equivalent = config.merge_meshes = merge
    config.unused_properties = mi.LogLevel.Warn  # properties that no plugin reads, by name and line
    try:
        original = path.read_text("utf-8", errors="replace")
        text, parameters, notes = _repair_text(original, xml_file)
        if text == original:
            state = parser.parse_file(config, str(path), **parameters)
        else:
            state = parser.parse_string(config, text, **parameters)
            state.files = [str(path), *state.files[1:]]
        parser.transform_upgrade(config, state)
        parser.transform_resolve(config, state)
        notes += xml_repairs.describe_repairs(xml_repairs.repair_nodes(state))
        notes += xml_files.find_other_case(state)
        missing: xml_files.MissingFiles = {}
        if xml_file.skip_missing:
            missing = xml_files.replace_missing_files(state)
            notes += xml_files.describe_missing_files(missing)
        else:
            xml_files.refuse_missing_files(state)
        parser.transform_all(config, state)
        yield _ParsedFile(
            config, state, notes, sorted({n for names in missing.values() for n in names})
        )
    except RuntimeError as error:
        hint = ". -D NAME=VALUE defines it" if "undefined parameter" in str(error) else ""
        raise SceneError(f"Mitsuba cannot use {path}: {error}{hint}") from error
    finally:
        resolver.clear()
        for folder in saved:
            resolver.append(folder)


def _repair_text(original: str, xml_file: XmlFile) -> tuple[str, dict[str, str], list[str]]:
    """The text of a file with its added sky, after repairs; its parameters; and notes."""
    given = dict(xml_file.parameters)
    head, end, rest = original.rpartition("</scene>")
    text = f"{head}{xml_file.sky}{end}{rest}" if xml_file.sky else original
    text, notes = xml_text.repair_syntax(text)
    text, more = xml_repairs.repair_text(text)
    replaced, unset = xml_text.find_replaced(text, given)
    return text, replaced | given, [*notes, *more, *unset]


def _read_max_depth(state: Any, notes: list[str]) -> int:
    """The maximum depth of the path integrator, or of the first integrator."""
    import mitsuba as mi

    integrators = [node for node in state.nodes if node.type == mi.ObjectType.Integrator]
    if not integrators:
        return MAX_DEPTH
    paths = (n for n in integrators if n.props.plugin_name() in PATH_INTEGRATORS)
    node = next(paths, integrators[0])
    plugin = node.props.plugin_name()
    if plugin not in PATH_INTEGRATORS:
        notes.append(f"integrator {plugin} is replaced by path")
    if node.props.get("hide_emitters", False):
        notes.append("hide_emitters is ignored: emitters are visible")
    return 2 if plugin == "direct" else _read_integer(node, "max_depth", -1, (-1, 2**31 - 1))


def _read_integer(node: Any, name: str, default: int, limits: tuple[int, int]) -> int:
    """A whole number of a plugin, within limits. Raises SceneError."""
    value = node.props.get(name, default) if node else default
    if type(value) is not int or not limits[0] <= value <= limits[1]:
        raise SceneError(
            f"{name} of {node.props.plugin_name()} is {value!r:.40}, expected an integer from "
            f"{limits[0]} to {limits[1]}"
        )
    return value


def _read_to_world(node: Any) -> np.ndarray:
    """The matrix of a sensor. Raises SceneError for anything else than a transform."""
    to_world = node.props.get("to_world", None)
    if to_world is None:
        return np.eye(4)
    matrix = np.array(getattr(to_world, "matrix", np.nan), np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise SceneError(f"to_world of the sensor is {to_world!r:.80}, expected a transform")
    return matrix


def _read_sensor(state: Any, notes: list[str]) -> tuple[np.ndarray | None, float, float]:
    """Camera-to-world matrix, horizontal field of view, and aspect ratio of the first sensor."""
    import mitsuba as mi

    sensors = [n for n in state.nodes if n.type == mi.ObjectType.Sensor]
    if not sensors:
        return None, 60.0, 1.0
    node = sensors[0]
    if len(sensors) > 1:
        notes.append(f"the first of {len(sensors)} sensors is used")
    xml_files.refuse_other_sensors(state, node)
    if node.props.plugin_name() == "thinlens":
        notes.append("thinlens is rendered as a pinhole, without depth of field")
    film = next((n for _, n in children(state, node) if n.type == mi.ObjectType.Film), None)
    width, height = (_read_integer(film, name, size, (1, MAX_SIDE)) for name, size in FILM.items())
    lens = {k: node.props[k] for k in ("fov", "fov_axis", "focal_length") if k in node.props}
    size = {"type": "hdrfilm", "width": width, "height": height}
    try:
        sensor = mi.load_dict({"type": "perspective", **lens, "film": size})  # converts to x_fov
    except (RuntimeError, TypeError, ValueError) as error:
        raise SceneError(f"the sensor cannot be read: {error}") from error
    fov = float(np.array(mi.traverse(sensor)["x_fov"]).reshape(-1)[0])
    return _read_to_world(node), fov, width / height
