"""Sections are found by name: those of the core that exist, then those of plugins."""

from __future__ import annotations

import sys

import pytest

from rlbench.checks.stress import sections
from rlbench.checks.stress.sections import list_sections, load_section, select_sections
from rlbench.errors import OptionError, PluginError

MODULE = """
from rlbench.checks.stress.section import SuiteSection
SECTION = SuiteSection("{name}", "Is it there?", lambda is_quick: iter(()))
"""


def install(folder, monkeypatch, name, content=MODULE):
    """A package that registers the stress section `name`."""
    (folder / "extra_section.py").write_text(content.format(name=name))
    info = folder / "extra-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: extra\nVersion: 1\n")
    (info / "entry_points.txt").write_text(f"[rlbench.stress]\n{name} = extra_section:SECTION\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "extra_section", raising=False)  # that of another test


@pytest.mark.parametrize("name", list_sections())
def test_every_section_can_be_loaded_and_asks_a_question(name):
    section = load_section(name)
    assert section.name == name
    assert section.title.endswith("?")


def test_a_section_without_a_module_is_not_listed(monkeypatch):
    target = "rlbench.checks.stress.not_written:SECTION"
    monkeypatch.setitem(sections.CORE_SECTIONS, "not-written", target)
    assert "not-written" not in list_sections()


def test_a_section_of_a_plugin_is_listed_last(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "zebra")
    assert list(list_sections())[-1] == "zebra"
    assert load_section("zebra").title == "Is it there?"


def test_a_plugin_cannot_replace_a_section_of_the_core(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "budgets")
    with pytest.raises(PluginError, match="'budgets' of extra_section:SECTION has the name of"):
        list_sections()


def test_an_object_that_is_no_section_is_refused(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "zebra", "SECTION = '{name}'")
    with pytest.raises(PluginError, match="an object of type str; a stress section is"):
        load_section("zebra")


def test_a_section_with_another_name_is_refused(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "zebra", MODULE.format(name="horse"))
    with pytest.raises(PluginError, match="has the name 'horse', but is registered as 'zebra'"):
        load_section("zebra")


def test_selected_sections_keep_the_order_of_the_suite():
    assert select_sections(["metrics", "budgets"]) == ["budgets", "metrics"]
    assert select_sections() == list(list_sections())


def test_an_unknown_section_is_an_error_with_the_nearest_one():
    with pytest.raises(OptionError, match="--only budget: no such section. Did you mean 'budgets'"):
        select_sections(["budget"])
