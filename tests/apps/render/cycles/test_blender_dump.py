"""A dump by Blender itself, made as the how-to says, is imported and passes the linter."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from rlbench.clips.header import read_header
from tests.cli.runner import rlbench

SCRIPT = Path(__file__).parent / "write_dump.py"


@pytest.mark.slow
def test_a_dump_by_blender_is_imported_and_passes_lint(blender, tmp_path):
    dump, clips = tmp_path / "dump", tmp_path / "clips"
    subprocess.run([blender, str(SCRIPT), str(dump)], check=True, capture_output=True)
    assert "left out, " not in rlbench("import", dump, "--layout", "blender", "--out", clips)
    (folder,) = (file.parent for file in clips.rglob("clip.toml"))
    header = read_header(folder)
    assert (header.frames, header.pool_spp, header.height, header.width) == (3, 2, 72, 96)
    rlbench("lint", clips)  # ends with 0
