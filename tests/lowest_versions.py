"""The lowest versions that pyproject.toml states, as constraints of pip."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def list_lowest(project: Path = PROJECT) -> list[str]:
    """A line NAME==VERSION for each dependency with a lowest version."""
    dependencies = tomllib.loads(project.read_text())["project"]["dependencies"]
    found = (re.match(r"([\w.-]+)>=([\w.]+)", each) for each in dependencies)
    return [f"{match[1]}=={match[2]}" for match in found if match]


if __name__ == "__main__":
    print("\n".join(list_lowest()))  # noqa: T201
