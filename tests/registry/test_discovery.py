"""Plugins are found by entry points and in files; none replaces another."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

from rlbench import registry
from rlbench.family import Family
from rlbench.registry import PluginError
from tests.conftest import install_plugin, write_plugin
from tests.registry.subprocesses import run_python


@pytest.mark.parametrize("group", registry.GROUPS)
def test_every_group_has_plugins_of_our_own(group):
    assert registry.list_plugins(group)


def test_the_error_for_an_unknown_group_lists_the_groups():
    with pytest.raises(PluginError, match="there are: methods, metrics, reports, image_reports"):
        registry.list_plugins("denoisers")


def test_a_plugin_cannot_replace_a_built_in_method(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mean"))
    with pytest.raises(
        PluginError, match=r"two plugins are called 'mean': .* from rlbench, and .* from --plugin"
    ):
        registry.list_plugins("methods")


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
    assert run_python(code) == "a-strangers-package path\n"


def test_an_entry_point_of_a_package_on_the_path_is_found(tmp_path, monkeypatch):
    write_plugin(tmp_path / "stranger.py", "stranger")
    install_plugin(tmp_path, monkeypatch, "methods", "stranger = stranger:FAMILY")
    assert isinstance(registry.load_family("stranger"), Family)
