"""Plugins are listed by name, loaded on first use, and refused with a reason."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from rlbench import registry
from rlbench.family import Family
from rlbench.registry import PluginError
from tests.conftest import write_plugin


@pytest.mark.parametrize("group", registry.GROUPS)
def test_every_group_has_plugins_of_our_own(group):
    assert registry.names(group)


def test_the_error_for_an_unknown_group_lists_the_groups():
    with pytest.raises(PluginError, match="there are: methods, metrics, reports, pools, scenes"):
        registry.names("denoisers")


def test_the_error_for_an_unknown_method_lists_the_methods():
    with pytest.raises(PluginError, match="'foo' is not a method; there are: dasr, eaw, imcd"):
        registry.method("foo")


@pytest.mark.parametrize("name", ["mean/A9", "mean/"])
def test_the_error_for_an_unknown_variant_lists_the_variants(name):
    with pytest.raises(PluginError, match="'mean' has no variant 'A?9?'; it has: mean"):
        registry.method(name)


def test_a_plugin_file_adds_its_family_and_builds_it(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    assert "mine" in registry.names("methods")
    assert type(registry.method("mine/B1")).__name__ == "Scaled"


def test_a_plugin_file_may_add_several_families(tmp_path):
    file = write_plugin(tmp_path / "loose.py", "mine")
    more = "\nfrom dataclasses import replace\nMETHODS = [FAMILY, replace(FAMILY, name='yours')]\n"
    file.write_text(file.read_text() + more)
    registry.use_plugin(file)
    assert {"mine", "yours"} <= set(registry.names("methods"))
    assert registry.method("yours").traits == registry.variant("yours").traits


def test_a_plugin_file_may_have_the_name_of_an_installed_module(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "json.py", "mine"))
    assert type(registry.method("mine")).__name__ == "Scaled"
    assert "loads" in vars(sys.modules["json"])


def test_a_missing_plugin_file_is_an_error_with_its_path():
    with pytest.raises(PluginError, match="no plugin file at .*nowhere.py"):
        registry.use_plugin("nowhere.py")


def test_the_variable_adds_families(tmp_path, monkeypatch):
    write_plugin(tmp_path / "by_variable.py", "mine")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(registry.VARIABLE, "mine=by_variable:FAMILY")
    assert registry.family("mine").title == "A title"


@pytest.mark.parametrize("text", ["mine", "mine=module", "=module:FAMILY"])
def test_the_error_for_a_malformed_variable_states_the_format(text, monkeypatch):
    monkeypatch.setenv(registry.VARIABLE, text)
    with pytest.raises(PluginError, match="an item is written name=module:FAMILY"):
        registry.names("methods")


def test_a_plugin_cannot_replace_a_built_in_method(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mean"))
    with pytest.raises(
        PluginError, match=r"two plugins are called 'mean': .* from rlbench, and .* from --plugin"
    ):
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


def test_the_error_for_a_metric_that_cannot_be_imported_names_it(monkeypatch):
    def torn():
        raise ImportError("no such codec")

    plugins = {"flip": registry.PluginEntry("flip", "flip:FLIP", "flip-metric 1.0", torn)}
    monkeypatch.setattr("rlbench.registry.lookup.entries", lambda group: plugins)
    message = r"metric 'flip' from flip-metric 1.0 cannot be imported: ImportError: no such codec"
    with pytest.raises(PluginError, match=message):
        registry.metrics()


def test_a_plugin_file_without_a_family_cannot_be_loaded(tmp_path):
    (tmp_path / "three.py").write_text("METHODS = [3]")
    registry.use_plugin(tmp_path / "three.py")
    error = registry.import_error("methods", "three")
    assert "three.py defines an object of type int as a method; a Family is expected" in error


def test_an_object_that_is_not_a_family_is_refused(tmp_path, monkeypatch):
    (tmp_path / "no_family.py").write_text("FAMILY = 3")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(registry.VARIABLE, "mine=no_family:FAMILY")
    with pytest.raises(
        PluginError, match="no_family:FAMILY is an object of type int, not a Family"
    ):
        registry.family("mine")


def test_a_method_whose_traits_differ_from_the_declared_ones_is_refused(tmp_path):
    build = "return Scaled(Traits(min_samples=1))"
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "liar", build=build))
    with pytest.raises(
        PluginError, match="'liar' is declared with .*, but .* returned .*min_samples=1"
    ):
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
def test_a_pattern_leaves_out_variants_without_pretrained_weights(patterns, trained, expected):
    assert ("ours/denoiser-large" in registry.expand(patterns, trained)) == expected


def test_all_selects_every_family_once():
    assert registry.expand(["all"]) == registry.names("methods")


def test_a_method_without_weights_has_no_training_task():
    with pytest.raises(PluginError, match="'mean' has nothing to train"):
        registry.training_task("mean")


def test_all_skips_a_family_that_cannot_be_imported_and_says_so(tmp_path):
    (tmp_path / "torn.py").write_text("1 / 0")
    registry.use_plugin(tmp_path / "torn.py")
    messages = []
    names = registry.expand(["all"], tell=messages.append)
    assert names == [name for name in registry.names("methods") if name != "torn"]
    assert messages == [
        "'all' skips torn, which cannot be imported: ZeroDivisionError: division by zero"
    ]


def test_a_method_whose_package_is_missing_says_what_to_install(tmp_path):
    file = write_plugin(tmp_path / "odd.py", "odd")
    requires = "learned=False, requires=('nowhere-at-all',)"
    file.write_text(file.read_text().replace("learned=False", requires))
    registry.use_plugin(file)
    message = "'odd' needs nowhere-at-all, which is not installed: pip install nowhere-at-all"
    with pytest.raises(PluginError, match=message):
        registry.method("odd")


def test_the_shipped_weights_of_every_pretrained_method_exist():
    names = [name for name in registry.expand(["all/*"]) if registry.variant(name).learned]
    assert names
    assert [name for name in names if not registry.shipped_weights(name).is_file()] == []


def test_shipped_weights_lie_beside_the_module_that_builds_the_method(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "my_method.py", "mine"))
    assert registry.shipped_weights("mine/B1") == tmp_path / "cards" / "B1.safetensors"


def test_two_plugin_files_of_one_name_are_refused(tmp_path):
    (tmp_path / "other").mkdir()
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    other = write_plugin(tmp_path / "other" / "loose.py", "yours")
    with pytest.raises(PluginError, match=r"two plugin files are called loose\.py"):
        registry.use_plugin(other)


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
        origin = registry.entries("methods")["stranger"].origin
        print(origin, registry.method("stranger").traits.pool)
    """
    assert _python(code).stdout == "a-strangers-package path\n"


def test_an_entry_point_of_a_package_on_the_path_is_found(tmp_path, monkeypatch):
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
