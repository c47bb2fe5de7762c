"""Build steps of the site: links to source files, and the reference of the command line.

Pages are also read in the repository, where a link to a source file is a relative path. On the site
such a link leads to the repository; a link to a file that does not exist fails the build.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)#\s]+)(#[^)\s]*)?\)")
CLI = "<!-- commands -->"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with links to source files made absolute, and with the commands filled in."""
    if CLI in markdown:
        markdown = markdown.replace(CLI, _commands())
    folder = (ROOT / "docs" / page.file.src_uri).parent

    def absolute(match: re.Match[str]) -> str:
        path = (folder / match[1]).resolve()
        if path.is_relative_to(ROOT / "docs"):
            return match[0]
        if not path.exists():
            raise PluginError(f"{page.file.src_uri} links to {match[1]}, which does not exist")
        return f"]({config.repo_url}/blob/main/{path.relative_to(ROOT)}{match[2] or ''})"

    return LINK.sub(absolute, markdown)


def _commands() -> str:
    """The help of every command, in the order of `rlbench --help`."""
    import typer.main

    from rlbench.cli.app import app

    group: Any = typer.main.get_command(app)
    context = group.make_context("rlbench", [], resilient_parsing=True)
    context.max_content_width = 100
    pages = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        with command.make_context(name, [], parent=context, resilient_parsing=True) as inner:
            inner.max_content_width = 100
            pages.append(f"## rlbench {name}\n\n```text\n{command.full_help(inner)}\n```\n")
    return "\n".join(pages)
