"""What both kinds of card share: YAML between two lines of dashes, tables, and the hub's words."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["INSTALL", "REPOSITORY", "TAGS", "TASK", "front_matter", "hub_licence", "table"]

REPOSITORY = "https://github.com/rlbench/rlbench"
INSTALL = f"pip install git+{REPOSITORY}"
TAGS = ["path-tracing", "denoising", "adaptive-sampling", "monte-carlo", "rendering", "rlbench"]
TASK = "image-to-image"
HUB_LICENCES = {  # names of the hub, by SPDX identifier
    "Apache-2.0": "apache-2.0",
    "MIT": "mit",
    "CC-BY-4.0": "cc-by-4.0",
    "CC0-1.0": "cc0-1.0",
    "GPL-3.0-or-later": "gpl-3.0",
}


def hub_licence(names: set[str]) -> dict[str, str]:
    """One licence as the hub names it; `other` with its own name, where the hub has none."""
    name = " AND ".join(sorted(names - {""}))
    if name in HUB_LICENCES:
        return {"license": HUB_LICENCES[name]}
    return {"license": "other", "license_name": name.lower().replace(" ", "-") or "unknown"}


def front_matter(metadata: Mapping[str, Any]) -> str:
    """The metadata of a card; values are written as JSON, which is YAML."""
    lines = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in metadata.items()]
    return "---\n" + "\n".join(lines) + "\n---\n\n"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
