"""README and docs agree with the code: the method runs, commands parse, links and figures hold."""

from __future__ import annotations

import re
import shlex
from functools import cache
from itertools import chain, takewhile
from pathlib import Path
from typing import Any

import pytest

from docs.tables import fill_tables
from rlbench import registry
from rlbench.checks.conformance import MethodUnderTest, Verdict, run_checks
from rlbench.cli.command import load_command
from rlbench.cli.commands import list_commands
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").rglob("*.md"))
GUIDES = [README, *(page for page in DOCS if page.parent.name in ("start", "how-to", "concepts"))]
PROGRAM_OPTIONS = ("--help", "--help-all", "--version", "--install-completion", "--show-completion")
PACKAGES = "rlbench|baselines|methods|metrics|reports|tests|docs"
TEXTS = {page: page.read_text() for page in (README, *DOCS)}


@cache
def click_commands() -> dict[str, Any]:
    """The commands of `rlbench`, by name."""
    return {name: load_command(entry) for name, entry in list_commands().items()}


def check_command(line: str) -> None:
    """Assert that every `rlbench` command in a shell line exists and has the options it is given.

    Nothing is run.
    """
    words = shlex.split(line.replace("…", ""), comments=True)
    for index, word in enumerate(words):
        if word == "rlbench" and index + 1 < len(words):
            _check_arguments(words[index + 1 :], line)


def _check_arguments(words: list[str], line: str) -> None:
    own = takewhile(lambda word: word not in ("&&", "||", "|", ";"), words)
    name, *rest = (word.rstrip(";") for word in own)
    if name in ("COMMAND", "-h", *PROGRAM_OPTIONS):
        return
    assert name in click_commands(), f"no command {name}: {line}"
    parameters = click_commands()[name].params
    known = {option for each in parameters for option in (*each.opts, *each.secondary_opts)}
    known |= {"-h", "--help", "--help-all", "-v", "--verbose", "-q", "--quiet"}
    unknown = [word for word in rest if re.match(r"--?[a-zA-Z]", word)]
    unknown = [word for word in unknown if word.partition("=")[0] not in known]
    assert not unknown, f"rlbench {name} has no option {unknown}: {line}"


def shell_commands(page: Path) -> list[str]:
    """Lines of the page's shell blocks, and code in its text, that begin with `rlbench`."""
    text = TEXTS[page]
    blocks = re.findall(r"```(?:bash|sh)\n(.*?)```", text, re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    inline = [re.sub(r"\s+", " ", code) for code in re.findall(r"`([^`]+)`", prose)]
    inline = [code for code in inline if code.startswith("rlbench ")]
    return [line for line in lines if re.search(r"\brlbench [a-z-]", line)] + inline


@pytest.fixture
def bright(tmp_path):
    """The method of the README, as a plugin file."""
    snippets = re.findall(r"```python\n(.*?)```", TEXTS[README], re.DOTALL)
    (method,) = (snippet for snippet in snippets if "FAMILY = " in snippet)
    (tmp_path / "bright.py").write_text(method)
    registry.use_plugin(tmp_path / "bright.py")
    return "bright"


def test_the_method_of_the_readme_runs_and_samples_bright_pixels(bright):
    clip = procedural_clip(seed=1, size=Size(1, 32, 40), frames=3)
    *_, last = run_clip(registry.load_method(bright), clip, 2.0)
    counts = last.samples.counts
    assert int(counts.sum()) == 2 * 32 * 40
    luminance = list(clip)[1].reference.mean.mean(1, keepdim=True)
    is_bright = luminance > luminance.median()
    assert counts[is_bright].float().mean() > counts[~is_bright].float().mean()


def test_the_method_of_the_readme_keeps_the_contract(bright):
    verdicts = {check.name: result.verdict for check, result in run_checks(MethodUnderTest(bright))}
    assert {name: verdict for name, verdict in verdicts.items() if verdict != Verdict.PASSED} == {
        name: Verdict.SKIPPED for name in ("uniform", "temporal", "receptive_field")
    }


def test_every_file_that_a_page_names_exists():
    pattern = rf"`((?:{PACKAGES})/[\w/.+-]*)`"
    named = [(page, name) for page, text in TEXTS.items() for name in re.findall(pattern, text)]
    assert [(page, name) for page, name in named if not (ROOT / name).exists()] == []


def test_every_relative_link_of_a_page_leads_to_a_file():
    pattern = r"\]\((?!https?:|mailto:|#)([^)#\s]+)(?:#[^)\s]*)?\)"
    links = [(page, link) for page, text in TEXTS.items() for link in re.findall(pattern, text)]
    assert [(page, link) for page, link in links if not (page.parent / link).exists()] == []


def test_every_command_of_a_page_parses():
    lines = {page: shell_commands(page) for page in GUIDES}
    assert len(lines[README]) > 8
    assert sum(map(len, lines.values())) > 80
    for line in chain(*lines.values()):
        check_command(line)


@pytest.mark.parametrize(
    "line", ["rlbench paint", "cd x && rlbench list --json; rlbench train --fresh; done"]
)
def test_a_command_that_does_not_exist_is_noticed(line):
    with pytest.raises(AssertionError):
        check_command(line)


def test_the_generated_tables_of_a_page_are_those_of_its_sources():
    stale = [page for page, text in TEXTS.items() if fill_tables(text) != text]
    assert stale == [], "run make tables"
