"""Plugin files add families, and are refused with a reason."""

from __future__ import annotations

import sys

import pytest

from rlbench import registry
from rlbench.registry import PluginError
from tests.conftest import write_plugin


def test_a_plugin_file_adds_its_family_and_builds_it(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    assert "mine" in registry.list_plugins("methods")
    assert type(registry.load_method("mine/B1")).__name__ == "Scaled"


def test_a_plugin_file_may_add_several_families(tmp_path):
    file = write_plugin(tmp_path / "loose.py", "mine")
    more = "\nfrom dataclasses import replace\nMETHODS = [FAMILY, replace(FAMILY, name='yours')]\n"
    file.write_text(file.read_text() + more)
    registry.use_plugin(file)
    assert {"mine", "yours"} <= set(registry.list_plugins("methods"))
    assert registry.load_method("yours").traits == registry.get_variant("yours").traits


def test_a_plugin_file_may_have_the_name_of_an_installed_module(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "json.py", "mine"))
    assert type(registry.load_method("mine")).__name__ == "Scaled"
    assert "loads" in vars(sys.modules["json"])


def test_a_missing_plugin_file_is_an_error_with_its_path():
    with pytest.raises(PluginError, match="no plugin file at .*nowhere.py"):
        registry.use_plugin("nowhere.py")


@pytest.mark.parametrize(
    ("content", "error"),
    [("1 / 0", ZeroDivisionError), ("import nothing_like_it", ModuleNotFoundError)],
)
def test_a_broken_file_is_listed_and_raises_its_own_error(tmp_path, content, error):
    (tmp_path / "torn.py").write_text(content)
    registry.use_plugin(tmp_path / "torn.py")
    assert "torn" in registry.list_plugins("methods")
    assert str(registry.import_error("methods", "torn")).startswith(error.__name__)
    with pytest.raises(error):
        registry.load_method("torn")


def test_a_plugin_file_without_a_family_cannot_be_loaded(tmp_path):
    (tmp_path / "three.py").write_text("METHODS = [3]")
    registry.use_plugin(tmp_path / "three.py")
    error = registry.import_error("methods", "three")
    assert "three.py defines an object of type int as a method; a Family is expected" in error


def test_two_plugin_files_of_one_name_are_refused(tmp_path):
    (tmp_path / "other").mkdir()
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    other = write_plugin(tmp_path / "other" / "loose.py", "yours")
    with pytest.raises(PluginError, match=r"two plugin files are called loose\.py"):
        registry.use_plugin(other)
