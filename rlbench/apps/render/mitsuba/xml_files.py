"""What the nodes of an XML scene refer to: other nodes, and files, of which some may be missing.

Also refuses what Mitsuba would render wrong. Mitsuba refuses properties that no plugin has read,
which finds misspelt ones; nodes are therefore read by `peek`, which does not count.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from rlbench.apps.render.scene import SceneError

GREY = 0.5  # reflectance of a texture or BSDF whose file is missing
SURFACE_MAPS = ("bumpmap", "normalmap")
SHOWN = 3  # names of files in a note

MissingFiles = dict[str, list[str]]  # names in the XML file, by what stands for them
PINHOLES = ("perspective", "thinlens")


def peek(node: Any) -> dict[str, Any]:
    """The properties of a node by name; for Mitsuba, those that are unread stay so."""
    unread = node.props.unqueried()
    values = dict(node.props.items())
    for name in unread:
        node.props.mark_queried(name, False)
    return values


def references(node: Any) -> list[tuple[str, int]]:
    """Names by which a node refers to others, and the positions of these."""
    import mitsuba as mi

    kind = mi.Properties.ResolvedReference
    return [(k, v.index()) for k, v in peek(node).items() if isinstance(v, kind)]


def children(state: Any, node: Any) -> list[tuple[str, Any]]:
    """Names and nodes of the objects that a node refers to."""
    return [(name, state.nodes[index]) for name, index in references(node)]


def parents(state: Any, index: int) -> list[tuple[int, str]]:
    """Positions of the nodes that refer to the node at `index`, and the names by which they do."""
    return [
        (position, name)
        for position, node in enumerate(state.nodes)
        for name, child in references(node)
        if child == index
    ]


def add_node(state: Any, origin: int, props: Any) -> Any:
    """Append a node of the type and place in the file of the node at `origin`; a reference to it.

    Nodes fetched before are invalid afterwards, because the list may have moved.
    """
    import mitsuba as mi
    from mitsuba import parser

    node = parser.SceneNode(state.nodes[origin])
    node.props = props
    state.nodes.append(node)
    return mi.Properties.ResolvedReference(len(state.nodes) - 1)


def location(state: Any, node: Any) -> str:
    """File and line of a node."""
    from mitsuba import parser

    place = str(parser.file_location(state, node))
    is_text = place.startswith("string (")  # repaired in memory
    return place.replace("string", str(state.files[node.file_index]), 1) if is_text else place


def line(state: Any, node: Any) -> str:
    """The number of the line in which a node begins."""
    found = re.search(r"\(line (\d+)", location(state, node))
    return found[1] if found else "?"


def file_resolver() -> Any:
    """Mitsuba's list of folders in which it looks for files."""
    import mitsuba as mi

    find: Any = mi.file_resolver
    return find()


def find_files(state: Any) -> tuple[list[Path], list[tuple[int, str]]]:
    """The files that the nodes refer to; and node and name of each that does not exist."""
    files, missing = [], []
    for index, node in enumerate(state.nodes):
        for key, name in peek(node).items():
            if not (key.endswith("filename") and isinstance(name, str)):
                continue
            path = Path(str(file_resolver().resolve(name)))
            if path.is_file():
                files.append(path)
            else:
                missing.append((index, name))
    return files, missing


def find_other_case(state: Any) -> list[str]:
    """Correct names of files whose case or slashes differ from those on the disk; a note."""
    corrected = []
    for index, name in find_files(state)[1]:
        folders = [Path(str(folder)) for folder in file_resolver()]
        found = next(filter(None, (_near_file(folder, name) for folder in folders)), None)
        if found:
            props = state.nodes[index].props
            key = next(k for k, v in peek(state.nodes[index]).items() if v == name)
            props[key] = str(found)
            corrected.append(name)
    names = ", ".join(corrected[:SHOWN]) + ", ..." * (len(corrected) > SHOWN)
    return [f"files are found by names of other case or slashes: {names}"] if corrected else []


def _near_file(folder: Path, name: str) -> Path | None:
    """The file below a folder whose path differs in case and slashes alone, or None."""
    path = folder
    for part in name.replace("\\", "/").split("/"):
        if part in ("", ".", ".."):
            path = path / part
            continue
        if not path.is_dir():
            return None
        fitting = (entry for entry in sorted(path.iterdir()) if entry.name.lower() == part.lower())
        path = path / part if (path / part).exists() else next(fitting, path / part)
    return path if path.is_file() else None


def find_broken_shape(state: Any, message: str) -> int | None:
    """The position of the shape that Mitsuba's error is about, or None."""
    import mitsuba as mi

    if "shape plugin" not in message:
        return None
    places = [
        (position, place)
        for position, node in enumerate(state.nodes)
        if node.type == mi.ObjectType.Shape
        and (place := re.search(r"\(line \d+, col \d+\)", location(state, node)))
    ]
    return next((position for position, place in places if place[0] in message), None)


def remove_node(state: Any, index: int) -> None:
    """Take all references to a node away."""
    for parent, key in parents(state, index):
        del state.nodes[parent].props[key]


def refuse_missing_files(state: Any) -> None:
    """Raise SceneError, which lists all missing files, if there are any."""
    missing = [(name, state.nodes[index]) for index, name in find_files(state)[1]]
    if missing:
        lines = [f"{f}, in {n.props.plugin_name()} at {location(state, n)}" for f, n in missing]
        raise SceneError(
            "the scene refers to files that do not exist:\n  " + "\n  ".join(lines) + "\n"
            "Relative paths start at the folder of the XML file. --skip-missing renders the scene "
            "without these files"
        )


def replace_missing_files(state: Any) -> MissingFiles:
    """Do without the missing files, in place, and list them.

    Shapes are left out, with their lights. Textures become grey of 0.5, bump and normal maps a
    smooth surface, an environment map an equal radiance of 1 times its scale, and other BSDFs
    diffuse with reflectance 0.5. Raises SceneError for anything else that lacks its file.
    """
    import mitsuba as mi

    replaced: MissingFiles = {}
    for index, name in find_files(state)[1]:
        node = state.nodes[index]
        if node.type == mi.ObjectType.Shape:
            is_lamp = any(n.type == mi.ObjectType.Emitter for _, n in children(state, node))
            kind = "lights left out" if is_lamp else "shapes left out"
            remove_node(state, index)
            del node.props["filename"]
        elif node.type == mi.ObjectType.Texture:
            kind = _replace_texture(state, index)
        elif node.props.plugin_name() == "envmap":
            kind = "environment maps replaced by radiance 1"
            _become(node, "constant", "radiance", float(peek(node).get("scale", 1.0)))
        elif node.type == mi.ObjectType.BSDF:
            kind = "BSDFs made grey"
            _become(node, "diffuse", "reflectance", GREY)
        else:
            raise SceneError(
                f"{location(state, node)}: the file {name} of {node.props.plugin_name()} does not "
                "exist, and nothing can stand for it. Add the file, or remove the element"
            )
        replaced.setdefault(kind, []).append(name)
    return replaced


def describe_missing_files(missing: MissingFiles) -> list[str]:
    """A note for each kind: how many, and the first names."""
    notes = []
    for kind, names in missing.items():
        unique = list(dict.fromkeys(names))
        listed = ", ".join(unique[:SHOWN]) + ", ..." * (len(unique) > SHOWN)
        notes.append(f"{kind}, because files are missing: {len(names)} ({listed})")
    return notes


def _replace_texture(state: Any, index: int) -> str:
    """Make a texture grey, and take away a bump or normal map that it is for; says which."""
    import mitsuba as mi

    _become(state.nodes[index], "uniform", "value", GREY)
    users = [user for user, _ in parents(state, index)]
    maps = [user for user in users if state.nodes[user].props.plugin_name() in SURFACE_MAPS]
    for surface in maps:
        below = (
            k for k, n in children(state, state.nodes[surface]) if n.type == mi.ObjectType.BSDF
        )
        inner = state.nodes[surface].props[next(below)]
        for parent, key in parents(state, surface):
            state.nodes[parent].props[key] = inner
    return "surfaces made smooth" if maps else "textures made grey"


def _become(node: Any, plugin: str, name: str, value: float) -> None:
    """Make a node an object of another plugin, with one property and its old id."""
    import mitsuba as mi

    props = mi.Properties(plugin)
    props.set_id(node.props.id())
    props[name] = value
    node.props = props


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
