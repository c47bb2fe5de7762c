"""Code hashes change with the code that decides a number, and with no other code."""

from __future__ import annotations

import importlib
import subprocess
import sys
import types

import pytest

from rlbench import registry
from rlbench.system.code_hash import CORE, closure_of_file, code_hash, import_closure


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """An installed package of two files, `stranger`."""
    package = tmp_path / "stranger"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "net.py").write_text("WIDTH = 8\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    for module in [name for name in sys.modules if name.partition(".")[0] == "stranger"]:
        monkeypatch.delitem(sys.modules, module)  # of another test, and of another folder
    yield package
    sys.modules.pop("stranger", None)


@pytest.mark.parametrize("change", ["edit", "add", "rename"])
def test_every_change_to_the_files_of_a_package_changes_its_hash(plugin, change):
    before = code_hash(["stranger"])
    net = plugin / "net.py"
    if change == "edit":
        net.write_text("WIDTH = 9\n")
    elif change == "add":
        (plugin / "loss.py").write_text("")
    else:
        net.rename(plugin / "network.py")
    assert code_hash(["stranger"]) != before


@pytest.mark.parametrize(
    ("file", "same"),
    [
        ("net.py", '"""What it is."""\nWIDTH = 8\n'),
        ("net.py", "# narrower was worse\nWIDTH = 8  # channels\n"),
        ("net.py", "\n\nWIDTH = (\n    8\n)\n"),
        ("notes.md", "hello"),
    ],
)
def test_comments_docstrings_layout_and_other_files_do_not_change_the_hash(plugin, file, same):
    before = code_hash(["stranger"])
    (plugin / file).write_text(same)
    assert code_hash(["stranger"]) == before


def test_a_string_that_is_no_docstring_changes_the_hash(plugin):
    net, hashes = plugin / "net.py", set()
    for name in ("relu", "gelu"):
        net.write_text(f"def act():\n    'What it is.'\n    return '{name}'\n")
        hashes.add(code_hash(["stranger"]))
    assert len(hashes) == 2


def test_a_module_counts_with_its_own_file_only(plugin):
    before = code_hash(["stranger.net"])
    (plugin / "loss.py").write_text("")
    assert code_hash(["stranger.net"]) == before


def test_the_core_is_part_of_the_hash(plugin):
    assert code_hash(["stranger"]) != code_hash(["stranger"], core=())


def test_the_order_of_modules_does_not_change_the_hash():
    assert code_hash(["rlbench.run", "rlbench.method"]) == code_hash(
        ["rlbench.method", "rlbench.run"]
    )


def test_hashing_does_not_import_the_module(plugin):
    (plugin / "net.py").write_text("raise RuntimeError('imported')\n")
    assert len(code_hash(["stranger.net"])) == 16


def test_a_module_imported_from_a_file_is_hashed_by_that_file(tmp_path, monkeypatch):
    module = types.ModuleType("loose")
    (tmp_path / "loose.py").write_text("FAMILY = 1\n")
    module.__file__ = str(tmp_path / "loose.py")
    monkeypatch.setitem(sys.modules, "loose", module)
    assert code_hash(["loose"]) != code_hash([])


METHOD, NET, INIT = "stranger.method", "stranger.net", "stranger.__init__"
LAZY = "def __getattr__(name): ...\nif TYPE_CHECKING:\n    from .net import WIDTH"
FORMS = {  # the import of a method, the init file of its package, and what counts with the method
    **{
        line: (f"import os\nimport torch\n{line}", "", {NET})
        for line in (
            "from stranger.net import WIDTH",
            "from stranger import net",
            "import stranger.net",
            "from .net import WIDTH",
            "from . import net",
            "def later():\n    from stranger.net import WIDTH",
        )
    },
    **{
        init: ("from stranger import WIDTH", init, {NET})
        for init in (
            "from stranger.net import WIDTH\nfrom stranger.loss import L1",
            "from .net import WIDTH\nfrom .loss import L1",
            "from .net import SIZE as WIDTH\nfrom .loss import L1",
            LAZY,
        )
    },
    "import stranger": ("import stranger", "from .net import WIDTH", {NET, INIT}),
    "from stranger import *": ("from stranger import *", "from .net import WIDTH", {NET, INIT}),
}


@pytest.mark.parametrize("form", FORMS)
def test_imports_from_the_own_package_are_followed_in_every_form(plugin, form):
    line, init, expected = FORMS[form]
    (plugin / "__init__.py").write_text(f"{init}\n")
    (plugin / "method.py").write_text(f"{line}\n")
    (plugin / "loss.py").write_text("L1 = 1\n")
    importlib.invalidate_caches()
    assert import_closure(METHOD) == {METHOD} | expected


def test_indirect_imports_are_followed_and_a_cycle_ends(plugin):
    (plugin / "method.py").write_text("from stranger.net import WIDTH\n")
    (plugin / "net.py").write_text("import stranger.loss\nWIDTH = 8\n")
    (plugin / "loss.py").write_text("import stranger.method\n")
    importlib.invalidate_caches()  # a folder whose time has not changed is not listed again
    assert import_closure("stranger.method") >= {"stranger.net", "stranger.loss"}


def test_the_closure_of_metrics_has_their_formulas_and_does_not_import_torch():
    program = (
        "import sys; from rlbench.system.code_hash import import_closure;"
        "print(sorted(import_closure('metrics.catalog')), 'torch' in sys.modules)"
    )
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert process.stdout == (
        "['metrics.blotches', 'metrics.catalog', 'metrics.comparison', 'metrics.conventions', "
        "'metrics.display', 'metrics.effort', 'metrics.ground_truth', 'metrics.image', "
        "'metrics.metric', 'metrics.psnr', 'metrics.ssim', 'metrics.temporal'] False\n"
    )


def test_other_packages_are_followed_only_on_request(plugin):
    (plugin / "method.py").write_text("from metrics.display import srgb\nimport torch\n")
    importlib.invalidate_caches()
    assert "metrics.display" not in import_closure("stranger.method")
    assert "metrics.display" in import_closure("stranger.method", {"metrics"})


def test_every_core_module_that_makes_images_is_hashed():
    """The modules left out decide no number: names, errors, paths and reading of documents."""
    used = import_closure("rlbench.run") | import_closure("rlbench.clips.stored")
    left_out = {name for name in used - set(CORE) if not name.startswith("rlbench.system.")}
    assert left_out == {
        "rlbench.clips.digest",
        "rlbench.clips.exr_attributes",
        "rlbench.errors",
        "rlbench.family",
    }


def test_a_module_that_is_not_installed_is_an_error():
    with pytest.raises(LookupError, match="'no_such_plugin'"):
        code_hash(["no_such_plugin"])


def test_a_lazy_name_is_followed_through_the_stub_of_its_package(plugin):
    (plugin / "__init__.py").write_text("__getattr__ = attach_stub(__name__, __file__)\n")
    (plugin / "__init__.pyi").write_text("from .net import WIDTH as WIDTH\n")
    (plugin / "method.py").write_text("from stranger import WIDTH\n")
    importlib.invalidate_caches()
    assert import_closure("stranger.method") == {"stranger.method", "stranger.net"}


def test_a_name_that_a_package_defines_counts_with_its_init_file(plugin):
    (plugin / "__init__.py").write_text("WIDTH = 8\n")
    (plugin / "method.py").write_text("from stranger import WIDTH\n")
    importlib.invalidate_caches()
    closure = import_closure("stranger.method")
    assert closure == {"stranger.method", "stranger.__init__"}
    before = code_hash(closure)
    (plugin / "net.py").write_text("WIDTH = 9\n")
    assert code_hash(closure) == before
    (plugin / "__init__.py").write_text("WIDTH = 9\n")
    assert code_hash(closure) != before


@pytest.mark.parametrize("line", ["from helpers import net", "import helpers, helpers.net"])
def test_a_folder_without_an_init_file_is_followed(plugin, line):
    (plugin.parent / "helpers").mkdir()
    (plugin.parent / "helpers" / "net.py").write_text("")
    (plugin / "method.py").write_text(f"{line}\n")
    importlib.invalidate_caches()
    closure = import_closure("stranger.method", {"helpers"})
    assert closure == {"stranger.method", "helpers.net"}
    assert len(code_hash(closure)) == 16


def test_a_plugin_file_is_followed_into_rlbench_and_its_folder(plugin):
    file = plugin.parent / "my_method.py"
    file.write_text("import torch\nfrom stranger.net import WIDTH\nimport rlbench.errors\n")
    (plugin.parent / "unused.py").write_text("")
    importlib.invalidate_caches()
    assert closure_of_file(file, ()) == {"stranger.net", "rlbench.errors"}


def test_a_method_counts_with_the_operations_that_it_imports_and_with_no_others():
    """Else a change to one operation would invalidate the results of every method."""
    families = {name: registry.load_family(name) for name in registry.list_plugins("methods")}
    closures = {
        name: import_closure(family.build.partition(":")[0], {"baselines", "methods"})
        for name, family in families.items()
    }
    assert "rlbench.ops.stencils" in closures["svgf"]
    assert "rlbench.ops.stencils" not in closures["oidn"]
    assert not any(module.startswith("rlbench.ops") for module in closures["mean"])
    assert not any(package in CORE for package in ("rlbench", "rlbench.ops", "rlbench.clips"))
