"""Files that the nodes of an XML scene refer to, and what stands for those that are missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rlbench.render.mitsuba.xml_nodes import children, file_resolver, location, parents, peek
from rlbench.render.scene import SceneError

__all__ = [
    "MissingFiles",
    "describe_missing_files",
    "find_files",
    "refuse_missing_files",
    "replace_missing_files",
]

GREY = 0.5  # reflectance of a texture or BSDF whose file is missing
SURFACE_MAPS = ("bumpmap", "normalmap")
SHOWN = 3  # names of files in a note

MissingFiles = dict[str, list[str]]  # names in the XML file, by what stands for them


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
            for parent, key in parents(state, index):
                del state.nodes[parent].props[key]
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
