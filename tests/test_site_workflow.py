"""The workflow that publishes the site: valid, least permissions, official actions."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
SITE = yaml.safe_load((ROOT / ".github" / "workflows" / "site.yml").read_text())


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.name)
def test_a_workflow_is_valid_by_the_published_schema(file):
    words = ("--builtin-schema", "vendor.github-workflows", file)
    checked = subprocess.run(
        [sys.executable, "-m", "check_jsonschema", *words], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout


def test_what_is_built_is_what_is_published():
    steps = SITE["jobs"]["build"]["steps"]
    assert {"run": "make site"} in steps
    (upload,) = (step for step in steps if "upload-pages-artifact" in step.get("uses", ""))
    assert upload["with"]["path"] == "site"  # the folder of mkdocs
    assert SITE["jobs"]["deploy"]["needs"] == "build"


def test_only_the_deployment_may_write():
    assert SITE["permissions"] == {"contents": "read"}
    assert "permissions" not in SITE["jobs"]["build"]
    assert SITE["jobs"]["deploy"]["permissions"] == {"pages": "write", "id-token": "write"}


def test_only_official_actions_run():
    used = [
        step["uses"] for job in SITE["jobs"].values() for step in job["steps"] if "uses" in step
    ]
    assert all(name.startswith("actions/") for name in used)
