"""Plugins are looked up by name, and loaded without torch."""

from __future__ import annotations

import pytest

from rlbench import registry
from rlbench.registry import PluginError
from tests.conftest import install_plugin
from tests.registry.subprocesses import run_python


def test_the_error_for_an_unknown_method_lists_the_methods():
    with pytest.raises(PluginError, match="'foo' is not a method; there are: accumulate, bmfr"):
        registry.load_method("foo")


@pytest.mark.parametrize("name", ["mean/A9", "mean/"])
def test_the_error_for_an_unknown_variant_lists_the_variants(name):
    with pytest.raises(PluginError, match="'mean' has no variant 'A?9?'; it has: mean"):
        registry.load_method(name)


def test_the_error_for_a_metric_that_cannot_be_imported_names_it(monkeypatch):
    def torn():
        raise ImportError("no such codec")

    plugins = {"flip": registry.PluginEntry("flip", "flip:FLIP", "flip-metric 1.0", torn)}
    monkeypatch.setattr("rlbench.registry.lookup.list_entries", lambda group: plugins)
    message = r"metric 'flip' from flip-metric 1.0 cannot be imported: ImportError: no such codec"
    with pytest.raises(PluginError, match=message):
        registry.load_metrics()


def test_an_object_that_is_not_a_family_is_refused(tmp_path, monkeypatch):
    (tmp_path / "no_family.py").write_text("FAMILY = 3")
    install_plugin(tmp_path, monkeypatch, "methods", "mine = no_family:FAMILY")
    with pytest.raises(
        PluginError, match="no_family:FAMILY is an object of type int, not a Family"
    ):
        registry.load_family("mine")


def test_families_are_read_without_torch():
    code = """
        import sys
        from rlbench import registry
        for name in registry.list_plugins("methods"):
            registry.load_family(name)
        for name in registry.list_plugins("metrics"):
            registry.load_plugin("metrics", name)
        print("torch" in sys.modules)
    """
    assert run_python(code) == "False\n"
