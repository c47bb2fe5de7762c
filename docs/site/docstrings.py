"""A griffe extension: examples in docstrings are shown as code on the site.

Docstrings hold doctests as plain paragraphs that begin with `>>>`, which Markdown would read as
quotations. This puts each of them into a fenced block.
"""

from __future__ import annotations

from typing import Any

import griffe


class FenceExamples(griffe.Extension):  # type: ignore[misc]
    """Puts each paragraph that begins with `>>>` into a fenced code block."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Change the docstring of an object in place."""
        if obj.docstring and ">>>" in obj.docstring.value:
            paragraphs = obj.docstring.value.split("\n\n")
            obj.docstring.value = "\n\n".join(map(fence, paragraphs))


def fence(paragraph: str) -> str:
    """The paragraph, or a fenced block of it where it is a doctest."""
    if not paragraph.lstrip().startswith(">>>"):
        return paragraph
    return f"```python\n{paragraph}\n```"
