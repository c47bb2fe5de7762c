"""Plugins: found, named, refused, and loaded only when asked for."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.family import Family
from rlbench.registry.lookup import PluginError
from tests.conftest import write_plugin


@pytest.mark.parametrize("group", registry.GROUPS)
def test_every_group_has_plugins_of_our_own(group):
    assert registry.names(group)


def test_an_unknown_group_lists_those_that_exist():
    with pytest.raises(PluginError, match="there are: methods, metrics, reports, pools, scenes"):
        registry.names("denoisers")


def test_an_unknown_method_lists_those_that_exist():
    with pytest.raises(PluginError, match="'foo' is not a method; there are: dasr, eaw, imcd"):
        registry.method("foo")


@pytest.mark.parametrize("name", ["mean/A9", "mean/"])
def test_an_unknown_variant_lists_those_that_exist(name):
    with pytest.raises(PluginError, match="'mean' has no variant 'A?9?'; it has: mean"):
        registry.method(name)


def test_a_loose_file_brings_its_family_and_builds_it(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    assert "mine" in registry.names("methods")
    assert type(registry.method("mine/B1")).__name__ == "Scaled"


def test_a_loose_file_may_bring_several_families(tmp_path):
    file = write_plugin(tmp_path / "loose.py", "mine")
    more = "\nfrom dataclasses import replace\nMETHODS = [FAMILY, replace(FAMILY, name='yours')]\n"
    file.write_text(file.read_text() + more)
    registry.use_plugin(file)
    assert {"mine", "yours"} <= set(registry.names("methods"))
    assert registry.method("yours").traits == registry.variant("yours").traits


def test_a_loose_file_may_be_called_as_something_that_is_installed(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "json.py", "mine"))
    assert type(registry.method("mine")).__name__ == "Scaled"
    assert "loads" in vars(sys.modules["json"])


def test_a_missing_file_is_told():
    with pytest.raises(PluginError, match="no plugin file at .*nowhere.py"):
        registry.use_plugin("nowhere.py")


def test_the_variable_brings_families(tmp_path, monkeypatch):
    write_plugin(tmp_path / "by_variable.py", "mine")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(registry.VARIABLE, "mine=by_variable:FAMILY")
    assert registry.family("mine").title == "A title"


@pytest.mark.parametrize("text", ["mine", "mine=module", "=module:FAMILY"])
def test_a_variable_that_cannot_be_read_says_what_an_item_is(text, monkeypatch):
    monkeypatch.setenv(registry.VARIABLE, text)
    with pytest.raises(PluginError, match="an item is name=module:FAMILY"):
        registry.names("methods")


def test_nothing_overwrites_what_is_built_in(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mean"))
    with pytest.raises(PluginError, match=r"'mean' is given twice: by rlbench .* by --plugin"):
        registry.names("methods")


@pytest.mark.parametrize(
    ("content", "error"),
    [("1 / 0", ZeroDivisionError), ("import nothing_like_it", ModuleNotFoundError)],
)
def test_a_broken_file_is_listed_and_raises_its_own_error(tmp_path, content, error):
    (tmp_path / "torn.py").write_text(content)
    registry.use_plugin(tmp_path / "torn.py")
    assert "torn" in registry.names("methods")
    assert str(registry.import_error("methods", "torn")).startswith(error.__name__)
    with pytest.raises(error):
        registry.method("torn")


def test_a_metric_that_cannot_be_imported_is_named(monkeypatch):
    def torn():
        raise ImportError("no such codec")

    found = {"flip": registry.PluginEntry("flip", "flip:FLIP", "flip-metric 1.0", torn)}
    monkeypatch.setattr(registry, "entries", lambda group: found)
    with pytest.raises(PluginError, match=r"metric 'flip' of flip-metric 1.0 is broken: Import"):
        registry.metrics()


def test_a_loose_file_that_holds_no_family_is_broken(tmp_path):
    (tmp_path / "three.py").write_text("METHODS = [3]")
    registry.use_plugin(tmp_path / "three.py")
    assert "holds a int where a Family is wanted" in registry.import_error("methods", "three")


def test_what_is_not_a_family_is_refused(tmp_path, monkeypatch):
    (tmp_path / "no_family.py").write_text("FAMILY = 3")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(registry.VARIABLE, "mine=no_family:FAMILY")
    with pytest.raises(PluginError, match="is a int, not a Family"):
        registry.family("mine")


def test_a_method_that_is_not_what_its_family_declared_is_refused(tmp_path):
    build = "return Scaled(Traits(min_samples=1))"
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "liar", build=build))
    with pytest.raises(PluginError, match="'liar' declares .* but was built as .*floor=1"):
        registry.method("liar")


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        (["mine"], ["mine"]),
        (["mine/*"], ["mine", "mine/B1"]),
        (["mine/B1", "mean", "mine/*"], ["mine/B1", "mean", "mine"]),
    ],
)
def test_patterns_are_expanded_without_repeats(tmp_path, patterns, expected):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    assert registry.expand(patterns) == expected


@pytest.mark.parametrize(
    ("patterns", "trained", "expected"),
    [
        (["ours/*"], True, False),
        (["ours/*"], False, True),
        (["ours/denoiser-large"], True, True),
    ],
)
def test_what_has_no_weights_yet_has_to_be_named(patterns, trained, expected):
    assert ("ours/denoiser-large" in registry.expand(patterns, trained)) == expected


def test_all_is_every_family_once():
    assert registry.expand(["all"]) == registry.names("methods")


def test_what_learns_nothing_has_no_trainer():
    with pytest.raises(PluginError, match="'mean' has nothing to train"):
        registry.training_task("mean")


def test_families_are_read_without_torch():
    code = """
        import sys
        from rlbench import registry
        for name in registry.names("methods"):
            registry.family(name)
        for name in registry.names("metrics"):
            registry.load("metrics", name)
        print("torch" in sys.modules)
    """
    assert _python(code).stdout == "False\n"


@pytest.mark.slow
def test_a_package_of_its_own_is_found_by_its_entry_point(tmp_path):
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
    place = tmp_path / "installed"
    words = ("install", "--no-deps", "--no-build-isolation", "--no-index", "-q", "--target")
    subprocess.run([sys.executable, "-m", "pip", *words, place, package], check=True)
    code = f"""
        import sys
        sys.path.insert(0, {str(place)!r})
        from rlbench import registry
        origin = registry.entries("methods")["stranger"].origin
        print(origin, registry.method("stranger").traits.pool)
    """
    assert _python(code).stdout == "a-strangers-package path\n"


def test_an_entry_point_beside_the_path_is_found(tmp_path, monkeypatch):
    write_plugin(tmp_path / "stranger.py", "stranger")
    info = tmp_path / "strange-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: strange\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[rlbench.methods]\nstranger = stranger:FAMILY\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert isinstance(registry.family("stranger"), Family)


def _python(code: str) -> subprocess.CompletedProcess[str]:
    checkout = Path(__file__).parents[2]
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=checkout,
        check=True,
        capture_output=True,
        text=True,
    )
