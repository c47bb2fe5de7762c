"""Code hashes change with the code that decides a number, and with no other code."""

from __future__ import annotations

import importlib
import sys
import types

import pytest

from rlbench import registry
from rlbench.system.code_hash import CORE, closure_of_file, code_hash, import_closure
from tests.cli.runner import python


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """An installed package of two files, `stranger`."""
    package = tmp_path / "stranger"
    package.mkdir()
    fill(package, __init__="", net="WIDTH = 8")
    monkeypatch.syspath_prepend(str(tmp_path))
    for module in [name for name in sys.modules if name.partition(".")[0] == "stranger"]:
        monkeypatch.delitem(sys.modules, module)  # of another test, and of another folder
    yield package
    sys.modules.pop("stranger", None)


def fill(folder, **sources):
    """Write modules by name."""
    for name, source in sources.items():
        (folder / f"{name}.py").write_text(f"{source}\n")
    importlib.invalidate_caches()  # a folder whose time has not changed is not listed again


@pytest.mark.parametrize("change", ["edit", "add", "rename"])
def test_every_change_to_the_files_of_a_package_changes_its_hash(plugin, change):
    before = code_hash(["stranger"])
    if change == "edit":
        fill(plugin, net="WIDTH = 9")
    elif change == "add":
        fill(plugin, loss="")
    else:
        (plugin / "net.py").rename(plugin / "network.py")
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
    hashes = set()
    for name in ("relu", "gelu"):
        fill(plugin, net=f"def act():\n    'What it is.'\n    return '{name}'")
        hashes.add(code_hash(["stranger"]))
    assert len(hashes) == 2


@pytest.mark.parametrize("module", ["stranger.net", "stranger.__init__"])
def test_a_module_counts_with_its_own_file_only_and_is_not_imported(plugin, module):
    fill(plugin, net="raise RuntimeError('imported')", __init__="raise RuntimeError('imported')")
    before = code_hash([module])
    fill(plugin, loss="")
    assert code_hash([module]) == before
    fill(plugin, **{module.rpartition(".")[2]: "WIDTH = 9"})
    assert code_hash([module]) != before


def test_the_core_is_part_of_the_hash_and_the_order_of_modules_is_not(plugin):
    assert code_hash(["stranger"]) != code_hash(["stranger"], core=())
    modules = ["stranger.net", "rlbench.method"]
    assert code_hash(modules) == code_hash(modules[::-1])


def test_a_module_imported_from_a_file_is_hashed_by_that_file(tmp_path, monkeypatch):
    module = types.ModuleType("loose")
    fill(tmp_path, loose="FAMILY = 1")
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
    "the init file defines the name": ("from stranger import WIDTH", "WIDTH = 8", {INIT}),
    "an import of an import": ("from .loss import L1", "", {"stranger.loss", NET}),
}


@pytest.mark.parametrize("form", FORMS)
def test_imports_from_the_own_package_are_followed_in_every_form(plugin, form):
    line, init, expected = FORMS[form]
    fill(plugin, __init__=init, method=line, net="import stranger.method\nWIDTH = 8")  # a cycle
    fill(plugin, loss="import stranger.net\nL1 = 1")
    assert import_closure(METHOD) == {METHOD} | expected


def test_a_lazy_name_is_followed_through_the_stub_of_its_package(plugin):
    (plugin / "__init__.pyi").write_text("from .net import WIDTH as WIDTH\n")
    fill(plugin, __init__="__getattr__ = attach_stub()", method="from stranger import WIDTH")
    assert import_closure(METHOD) == {METHOD, NET}


@pytest.mark.parametrize("line", ["from helpers import net", "import helpers, helpers.net"])
def test_a_folder_without_an_init_file_is_followed(plugin, line):
    (plugin.parent / "helpers").mkdir()
    fill(plugin.parent / "helpers", net="")
    fill(plugin, method=line)
    closure = import_closure(METHOD, {"helpers"})
    assert closure == {METHOD, "helpers.net"}
    assert len(code_hash(closure)) == 16


def test_other_packages_are_followed_only_on_request(plugin):
    fill(plugin, method="from metrics.display import srgb\nimport torch")
    assert "metrics.display" not in import_closure(METHOD)
    assert "metrics.display" in import_closure(METHOD, {"metrics"})


def test_a_plugin_file_is_followed_into_rlbench_and_its_folder(plugin):
    own = "import torch\nfrom stranger.net import WIDTH\nimport rlbench.errors"
    fill(plugin.parent, my_method=own, unused="")
    closure = closure_of_file(plugin.parent / "my_method.py", ())
    assert closure == {"stranger.net", "rlbench.errors"}


def test_a_module_that_is_not_installed_is_an_error():
    with pytest.raises(LookupError, match="'no_such_plugin'"):
        code_hash(["no_such_plugin"])


# The modules of rlbench


def test_the_closure_of_metrics_has_their_formulas_and_does_not_import_torch():
    program = (
        "import sys; from rlbench.system.code_hash import import_closure;"
        "print(*sorted(import_closure('metrics.catalog')), 'torch' in sys.modules)"
    )
    *closure, has_torch = python("-c", program).split()
    assert {"metrics.catalog", "metrics.display", "metrics.psnr", "metrics.ssim"} < set(closure)
    assert has_torch == "False"


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


def test_a_method_counts_with_the_operations_that_it_imports_and_with_no_others():
    """Else a change to one operation would invalidate the results of every method."""
    builds = {name: registry.load_family(name).build for name in ("svgf", "oidn", "mean")}
    svgf, oidn, mean = (
        import_closure(build.partition(":")[0], {"baselines", "methods"})
        for build in builds.values()
    )
    assert "rlbench.ops.stencils" in svgf - oidn
    assert not any(module.startswith("rlbench.ops") for module in mean)
    assert not any(package in CORE for package in ("rlbench", "rlbench.ops", "rlbench.clips"))
