"""Sections are found by name: those of the core that exist, then those of plugins."""

from __future__ import annotations

import sys

import pytest

from rlbench.checks.stress.section import list_sections, load_section, select_sections
from rlbench.errors import PluginError
from tests.conftest import install_plugin

MODULE = """
from rlbench.checks.stress.section import SuiteSection
SECTION = SuiteSection(lambda is_quick: iter(()))
"""


def install(folder, monkeypatch, name, content=MODULE):
    """A package that registers the stress section `name`."""
    (folder / "extra_section.py").write_text(content)
    install_plugin(folder, monkeypatch, "stress", f"{name} = extra_section:SECTION")
    monkeypatch.delitem(sys.modules, "extra_section", raising=False)  # that of another test


@pytest.mark.parametrize("name", list_sections())
def test_every_section_can_be_loaded(name):
    assert callable(load_section(name).run)


def test_a_section_of_a_plugin_is_listed_last(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "zebra")
    assert list(list_sections())[-1] == "zebra"
    assert list(load_section("zebra").run(True)) == []


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("budgets", MODULE, "has the name of a section of rlbench"),
        ("zebra", "SECTION = 'zebra'", "an object of type str"),
    ],
)
def test_a_plugin_that_is_no_section_of_its_own_is_refused(
    tmp_path, monkeypatch, name, content, problem
):
    install(tmp_path, monkeypatch, name, content)
    with pytest.raises(PluginError, match=problem):
        load_section(name)


def test_selected_sections_keep_the_order_of_the_suite():
    assert select_sections(["metrics", "budgets"]) == ["budgets", "metrics"]
    assert select_sections() == list(list_sections())
