"""Methods are built, trained and selected by name."""

from __future__ import annotations

import pytest

from rlbench import registry
from rlbench.registry import PluginError
from tests.conftest import write_plugin


def test_a_method_whose_traits_differ_from_the_declared_ones_is_refused(tmp_path):
    build = "return Scaled(Traits(min_samples=1))"
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "liar", build=build))
    message = "'liar' is declared with .*, but .* returned .*min_samples=1"
    with pytest.raises(PluginError, match=message):
        registry.load_method("liar")


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        (["mine/*"], ["mine", "mine/B1"]),
        (["mine/B1", "mean", "mine/*"], ["mine/B1", "mean", "mine"]),
        (["ours/fast", "nppd/large"], ["ours/fast", "nppd/large"]),  # names, without weights
    ],
)
def test_patterns_are_expanded_without_repeats(tmp_path, patterns, expected):
    registry.use_plugin(write_plugin(tmp_path / "loose.py", "mine"))
    assert registry.expand(patterns) == expected


def test_a_pattern_leaves_out_variants_without_pretrained_weights_unless_it_may_have_them():
    assert "ours/fast" not in registry.expand(["ours/*"])
    assert "ours/fast" in registry.expand(["ours/*"], pretrained_only=False)


def test_all_selects_every_family_with_weights_once():
    families = registry.list_plugins("methods")
    expected = [name for name in families if registry.get_variant(name).pretrained]
    assert registry.expand(["all"]) == expected
    assert registry.expand(["all"], pretrained_only=False) == families


def test_all_skips_a_family_that_cannot_be_imported_and_says_so(tmp_path):
    (tmp_path / "torn.py").write_text("1 / 0")
    registry.use_plugin(tmp_path / "torn.py")
    messages = []
    names = registry.expand(["all"], pretrained_only=False, on_skip=messages.append)
    assert names == [name for name in registry.list_plugins("methods") if name != "torn"]
    reason = "ZeroDivisionError: division by zero (torn.py:1)"
    assert messages == [f"'all' skips torn, which cannot be imported: {reason}"]


def test_a_method_whose_package_is_missing_says_what_to_install(tmp_path):
    file = write_plugin(tmp_path / "odd.py", "odd")
    requires = "learned=False, requires=('nowhere-at-all',)"
    file.write_text(file.read_text().replace("learned=False", requires))
    registry.use_plugin(file)
    message = "'odd' needs nowhere-at-all, which is not installed: pip install nowhere-at-all"
    with pytest.raises(PluginError, match=message):
        registry.load_method("odd")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("oidn/tuned", None),
        ("mean", "has nothing to train"),
        ("ours/flat", "has the weights of ours: train that one"),
        ("ours/latent-flat", "has the weights of ours/latent: train that one"),
        ("oidn", "has weights that Intel trained and published"),
    ],
)
def test_a_method_that_cannot_be_trained_has_a_reason(name, reason):
    assert registry.is_trainable(name) == (reason is None)
    assert (registry.untrainable_reason(name) or "").startswith(reason or "")
    if reason:
        with pytest.raises(PluginError, match=f"'{name}' {reason}"):
            registry.training_task(name)


def test_the_shipped_weights_of_every_pretrained_method_exist():
    names = [name for name in registry.expand(["all/*"]) if registry.get_variant(name).learned]
    assert names
    assert [name for name in names if not registry.shipped_weights(name).is_file()] == []


def test_shipped_weights_lie_beside_the_module_that_builds_the_method(tmp_path):
    registry.use_plugin(write_plugin(tmp_path / "my_method.py", "mine"))
    assert registry.shipped_weights("mine/B1") == tmp_path / "cards" / "B1.safetensors"
