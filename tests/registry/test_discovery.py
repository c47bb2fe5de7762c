"""Plugins are found by entry points and in files; none replaces another, and errors say why."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

from rlbench import registry
from rlbench.registry import PluginError
from tests.cli.runner import python
from tests.conftest import install_plugin, write_plugin


@pytest.mark.parametrize("group", registry.GROUPS)
def test_every_group_has_plugins_of_our_own(group):
    assert registry.list_plugins(group)


@pytest.mark.parametrize(
    ("look_up", "name", "message"),
    [
        (registry.list_plugins, "denoisers", "there are: methods, metrics, reports, image_reports"),
        (registry.load_method, "foo", "'foo' is not a method; there are: accumulate, bmfr"),
        (registry.load_method, "mean/A9", "'mean' has no variant 'A9'; it has: mean"),
        (registry.load_method, "mean/", "'mean' has no variant ''; it has: mean"),
        (registry.use_plugin, "nowhere.py", "no plugin file at .*nowhere.py"),
    ],
)
def test_an_unknown_name_is_an_error_that_says_what_there_is(look_up, name, message):
    with pytest.raises(PluginError, match=message):
        look_up(name)


def test_families_and_metrics_are_read_without_torch():
    code = """
        import sys
        from rlbench import registry
        for name in registry.list_plugins("methods"):
            registry.load_family(name)
        for name in registry.list_plugins("metrics"):
            registry.load_plugin("metrics", name)
        print("torch" in sys.modules)
    """
    assert python("-c", textwrap.dedent(code)) == "False\n"


def test_the_error_for_a_metric_that_cannot_be_imported_names_it(monkeypatch):
    def torn():
        raise ImportError("no such codec")

    plugins = {"flip": registry.PluginEntry("flip", "flip:FLIP", "flip-metric 1.0", torn)}
    monkeypatch.setattr("rlbench.registry.lookup.list_entries", lambda group: plugins)
    message = r"metric 'flip' from flip-metric 1.0 cannot be imported: ImportError: no such codec"
    with pytest.raises(PluginError, match=message):
        registry.load_metrics()


# Installed packages


def test_an_object_that_is_not_a_family_is_refused(tmp_path, monkeypatch):
    (tmp_path / "no_family.py").write_text("FAMILY = 3")
    install_plugin(tmp_path, monkeypatch, "methods", "mine = no_family:FAMILY")
    message = "no_family:FAMILY is an object of type int, not a Family"
    with pytest.raises(PluginError, match=message):
        registry.load_family("mine")


@pytest.mark.slow
def test_an_installed_package_is_found_by_its_entry_point(tmp_path):
    package = tmp_path / "package"
    package.mkdir()
    write_plugin(package / "stranger.py", "stranger")
    (package / "pyproject.toml").write_text(
        textwrap.dedent("""
            [build-system]
            requires = ["setuptools"]
            build-backend = "setuptools.build_meta"
            [project]
            name = "a-strangers-package"
            version = "1"
            [project.entry-points."rlbench.methods"]
            stranger = "stranger:FAMILY"
            [tool.setuptools]
            py-modules = ["stranger"]
        """)
    )
    target = tmp_path / "installed"
    install = ("install", "--no-deps", "--no-build-isolation", "--no-index", "-q", "--target")
    subprocess.run([sys.executable, "-m", "pip", *install, target, package], check=True)
    code = f"""
        import sys
        sys.path.insert(0, {str(target)!r})
        from rlbench import registry
        origin = registry.list_entries("methods")["stranger"].origin
        print(origin, registry.load_method("stranger").traits.pool)
    """
    assert python("-c", textwrap.dedent(code)) == "a-strangers-package path\n"


# Plugin files


def test_a_plugin_cannot_replace_a_built_in_method(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mean"))
    message = "two plugins are called 'mean': .* from rlbench, and .* from --plugin"
    with pytest.raises(PluginError, match=message):
        registry.list_plugins("methods")


def test_a_plugin_file_may_add_several_families(tmp_path):
    file = write_plugin(tmp_path / "loose.py", "mine")
    more = "\nfrom dataclasses import replace\nMETHODS = [FAMILY, replace(FAMILY, name='yours')]\n"
    file.write_text(file.read_text() + more)
    registry.use_plugin(file)
    assert {"mine", "yours"} <= set(registry.list_plugins("methods"))
    assert registry.load_method("yours").traits == registry.get_variant("yours").traits


def test_a_plugin_file_may_have_the_name_of_an_installed_module(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "json.py", "mine"))
    assert type(registry.load_method("mine/B1")).__name__ == "Scaled"
    assert "loads" in vars(sys.modules["json"])


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
