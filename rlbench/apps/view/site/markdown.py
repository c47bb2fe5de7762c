"""Parts of the site's pages in Markdown: tables, links and front matter."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence

from reports.layout.tables import pipe_table

SPECIAL = str.maketrans({c: f"\\{c}" for c in "\\`*_[]<>|"})


def escape(text: str) -> str:
    """Text that Markdown shows as it is, on one line.

    >>> escape("a|b_c")
    'a\\\\|b\\\\_c'
    """
    return " ".join(text.split()).translate(SPECIAL)


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """A table of names and texts, the first as its head; pairs without a text are left out."""
    head, *rows = [pair for pair in pairs if pair[1]]
    return pipe_table(head, rows, numbers=False)


def link(text: str, target: str, page: str) -> str:
    """A link from one page of the site to another; both are paths in the folder of documents.

    >>> link("ours", "methods/ours/index.md", "leaderboard/mini.md")
    '[ours](../methods/ours/index.md)'
    """
    path = os.path.relpath(target, os.path.dirname(page) or ".")
    return f"[{text}]({path})"


def unbroken(text: str) -> str:
    """Numbers that stay on one line, with a minus that is one.

    >>> unbroken("-0.3 [-0.5, +0.1]").count(" ")
    0
    """
    return text.replace("-", "\u2212").replace(" ", "\u00a0")


def method_path(name: str) -> str:
    """The page of a method, family or family/variant.

    >>> method_path("ours"), method_path("ours/A2")
    ('methods/ours/index.md', 'methods/ours/A2.md')
    """
    family, _, variant = name.partition("/")
    return f"methods/{family}/{variant or 'index'}.md"


def front_matter(title: str, hide: Sequence[str] = ()) -> str:
    """The head of a page: its title, and the parts of the theme that it hides."""
    hidden = "".join(f"  - {part}\n" for part in hide)
    return f"---\ntitle: {json.dumps(title)}\n{'hide:' + chr(10) + hidden if hide else ''}---\n\n"
