"""What the README shows works as it is shown."""

from __future__ import annotations

import re
from pathlib import Path

from rlbench import registry
from rlbench.checks.conformance import MethodUnderTest, Verdict, run_checks
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip

README = Path(__file__).parent.parent / "README.md"


def test_the_method_of_the_readme_runs_and_samples_the_bright(tmp_path):
    (snippet,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    (tmp_path / "bright.py").write_text(snippet)
    registry.use_plugin(tmp_path / "bright.py")
    clip = procedural_clip(seed=1, size=Size(1, 32, 40), frames=3)
    *_, last = run_clip(registry.load_method("bright"), clip, 2.0)
    counts = last.samples.counts
    assert int(counts.sum()) == 2 * 32 * 40
    light = list(clip)[1].reference.mean.mean(1, keepdim=True)
    bright = light > light.median()
    assert counts[bright].float().mean() > counts[~bright].float().mean()


def test_the_method_of_the_readme_is_sound(tmp_path):
    (snippet,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    (tmp_path / "bright.py").write_text(snippet)
    registry.use_plugin(tmp_path / "bright.py")
    found = {check.name: result.verdict for check, result in run_checks(MethodUnderTest("bright"))}
    assert {name for name in found if found[name] is not Verdict.PASSED} == {"uniform", "temporal"}
    assert Verdict.FAILED not in found.values()


def test_every_file_that_the_readme_names_is_there():
    named = re.findall(
        r"`((?:rlbench|baselines|methods|metrics|reports)/[\w/.-]*)`", README.read_text()
    )
    assert named
    assert [name for name in named if not (README.parent / name).exists()] == []


def test_the_scores_of_the_readme_are_those_of_the_summary():
    shown = _scores(README.read_text())
    assert shown
    assert shown == _scores((README.parent / "docs" / "summary.md").read_text())


def _scores(page: str) -> list[list[str]]:
    """The first table of methods by budgets, without intervals and emphasis."""
    lines = page[page.index("| method | 0.5 spp |") :].split("\n\n")[0].splitlines()[2:]
    cells = [[cell.split("[")[0].strip(" *") for cell in line.split("|")[1:-1]] for line in lines]
    return [[cell.removesuffix(" tie") for cell in line] for line in cells]
