"""The commands of docs/how-to/import-frames.md, one after the other, in a fresh folder."""

from __future__ import annotations

import dataclasses
import re
import shlex
from pathlib import Path

import pytest

from rlbench.benchmark import results
from tests.apps.dumps.importers.dumps import write_falcor
from tests.apps.dumps.lint.broken_fixtures import correct_clip
from tests.cli.runner import rlbench

PAGES = Path(__file__).parents[3] / "docs" / "how-to"
METHODS = ("ours", "oidn", "mean")


def commands() -> list[list[str]]:
    """The words of each command in the first block of the page, without `rlbench`."""
    block = re.search(r"```bash\n(.*?)```", (PAGES / "import-frames.md").read_text(), re.DOTALL)[1]
    return [shlex.split(line, comments=True)[1:] for line in block.splitlines()]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A fresh folder in which the commands are given, with the cost profile of another page."""
    page = (PAGES / "charge-your-renderer.md").read_text()
    profile = re.search(r"```toml\n(# mine.toml.*?)```", page, re.DOTALL)[1]
    (tmp_path / "mine.toml").write_text(profile)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1], ids=["ready layout", "own layout"])
def test_the_commands_of_the_page_lead_from_a_dump_to_a_decision(folder, sign):
    clip = correct_clip(height=48, width=64, frames=3, half=32)
    gbuffer = {**clip.gbuffer, "motion": sign * clip.gbuffer["motion"]}
    write_falcor(dataclasses.replace(clip, gbuffer=gbuffer), folder / "dump")
    outputs = {words[0]: rlbench(*words) for words in commands()}
    assert list(outputs) == ["lint", "import", "run", "decide"]
    rows = results.read(folder / "results" / "own")
    assert set(rows.loc[rows["metric"] == "psnr", "method"]) == set(METHODS)
    assert any(name in outputs["decide"] for name in METHODS)


def test_a_guess_that_is_a_ready_layout_is_written_as_a_file_that_imports(folder, monkeypatch):
    monkeypatch.setattr("rlbench.apps.dumps.lint.guess.recognize_layout", lambda source: "falcor")
    write_falcor(correct_clip(height=24, width=32, frames=2, half=32), folder / "dump")
    (guess, imports, *_) = commands()
    output = rlbench(*guess)
    assert "the ready layout 'falcor' reads it" in output
    assert output.endswith("Next: rlbench import dump --layout engine.toml --out clips/")
    assert "2 frames of 32 x 24 pixels" in rlbench(*imports)


def test_a_guess_never_overwrites_a_layout_and_says_so_before_it_reads_the_dump(folder):
    write_falcor(correct_clip(height=24, width=32, frames=2, half=32), folder / "dump")
    (folder / "engine.toml").write_text("mine")
    assert "engine.toml exists; name another file" in rlbench(*commands()[0], code=2)
    rlbench("lint", "--guess", "dump", "--layout", "mine.toml/engine.toml", code=2)
    assert (folder / "engine.toml").read_text() == "mine"
