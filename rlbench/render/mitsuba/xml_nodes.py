"""Access to the nodes of Mitsuba's XML parser."""

from __future__ import annotations

from typing import Any


def children(state: Any, node: Any) -> list[tuple[str, Any]]:
    """Names and nodes of the objects that a node refers to."""
    import mitsuba as mi

    kind = mi.Properties.ResolvedReference
    return [(k, state.nodes[v.index()]) for k, v in node.props.items() if isinstance(v, kind)]


def location(state: Any, node: Any) -> str:
    """File and line of a node."""
    from mitsuba import parser

    return str(parser.file_location(state, node))


def file_resolver() -> Any:
    """Mitsuba's list of folders in which it looks for files."""
    import mitsuba as mi

    find: Any = mi.file_resolver
    return find()
