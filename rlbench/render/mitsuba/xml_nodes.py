"""Access to the nodes of Mitsuba's XML parser.

Mitsuba refuses properties that no plugin has read, which finds misspelt ones. Nodes are therefore
read by `peek`, which does not count.
"""

from __future__ import annotations

import re
from typing import Any


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
