"""A number's origin: code that changes changes the hash, code that does not matter does not."""

from __future__ import annotations

import importlib
import importlib.metadata
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from rlbench.system.code_hash import CORE, code_hash, import_closure
from rlbench.system.provenance import Machine, commit, machine, versions


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A package of two files on the path, named `stranger`."""
    package = tmp_path / "stranger"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "net.py").write_text("WIDTH = 8\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield package
    sys.modules.pop("stranger", None)


@pytest.mark.parametrize("change", ["edit", "add", "rename"])
def test_any_change_of_the_sources_changes_the_hash(plugin, change):
    before = code_hash(["stranger"])
    net = plugin / "net.py"
    if change == "edit":
        net.write_text("WIDTH = 9\n")
    elif change == "add":
        (plugin / "loss.py").write_text("")
    else:
        net.rename(plugin / "network.py")
    assert code_hash(["stranger"]) != before


def test_other_files_do_not_change_the_hash(plugin):
    before = code_hash(["stranger"])
    (plugin / "notes.md").write_text("hello")
    assert code_hash(["stranger"]) == before


def test_a_module_is_hashed_by_its_own_file(plugin):
    before = code_hash(["stranger.net"])
    (plugin / "loss.py").write_text("")
    assert code_hash(["stranger.net"]) == before


def test_the_core_counts(plugin):
    assert code_hash(["stranger"]) != code_hash(["stranger"], core=())


def test_the_order_of_modules_does_not_count():
    assert code_hash(["rlbench.run", "rlbench.method"]) == code_hash(
        ["rlbench.method", "rlbench.run"]
    )


def test_hashing_imports_no_plugin(plugin):
    (plugin / "net.py").write_text("raise RuntimeError('imported')\n")
    assert len(code_hash(["stranger.net"])) == 16


def test_a_module_from_a_loose_file_is_found(tmp_path, monkeypatch):
    import types

    loose = types.ModuleType("loose")
    (tmp_path / "loose.py").write_text("FAMILY = 1\n")
    loose.__file__ = str(tmp_path / "loose.py")
    monkeypatch.setitem(sys.modules, "loose", loose)
    assert code_hash(["loose"]) != code_hash([])


@pytest.mark.parametrize(
    "line",
    [
        "from stranger.net import WIDTH",
        "from stranger import net",
        "import stranger.net",
        "from .net import WIDTH",
        "from . import net",
        "def late():\n    from stranger.net import WIDTH",
    ],
)
def test_what_a_module_imports_of_its_package_is_found(plugin, line):
    (plugin / "method.py").write_text(f"import os\nimport torch\n{line}\n")
    (plugin / "unused.py").write_text("")
    importlib.invalidate_caches()
    found = import_closure("stranger.method")
    assert found - {"stranger"} == {"stranger.method", "stranger.net"}


def test_what_is_imported_in_turn_is_found_though_it_goes_round(plugin):
    (plugin / "method.py").write_text("from stranger.net import WIDTH\n")
    (plugin / "net.py").write_text("import stranger.loss\nWIDTH = 8\n")
    (plugin / "loss.py").write_text("import stranger.method\n")
    importlib.invalidate_caches()  # a folder whose time has not changed is not listed again
    assert import_closure("stranger.method") >= {"stranger.net", "stranger.loss"}


def test_the_formulas_of_metrics_are_found_and_torch_is_not_imported():
    code = (
        "import sys; from rlbench.system.code_hash import closure;"
        "print(sorted(closure('metrics.catalog')), 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "['metrics.catalog', 'metrics.display', 'metrics.image'] False\n"


def test_parts_of_other_packages_are_followed_where_that_is_asked_for(plugin):
    (plugin / "method.py").write_text("from metrics.display import srgb\nimport torch\n")
    importlib.invalidate_caches()
    assert "metrics.display" not in import_closure("stranger.method")
    assert "metrics.display" in import_closure("stranger.method", {"metrics"})


def test_all_of_the_core_that_makes_images_is_hashed():
    """What is left out decides no number: names, places on disk, errors."""
    used = import_closure("rlbench.run") | import_closure("rlbench.clips.stored")
    left = {
        "rlbench.clips.digest",
        "rlbench.errors",
        "rlbench.family",
        "rlbench.system",
        "rlbench.system.paths",
    }
    assert used - set(CORE) == left | {"rlbench.system.code_hash"}


def test_an_unknown_module_is_an_error():
    with pytest.raises(LookupError, match="'no_such_plugin'"):
        code_hash(["no_such_plugin"])


def _git(folder: Path, *words: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b")
    done = subprocess.run(["git", "-C", str(folder), *who, *words], capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path):
    _git(tmp_path, "init")
    (tmp_path / "code.py").write_text("1\n")
    _git(tmp_path, "add", ".")
    _git(tmp_path, "commit", "-m", "first")
    return tmp_path


def test_a_clean_checkout_is_its_commit(checkout):
    assert commit(checkout) == _git(checkout, "rev-parse", "HEAD")[:12]


def test_a_changed_checkout_has_a_plus(checkout):
    (checkout / "code.py").write_text("2\n")
    assert commit(checkout) == _git(checkout, "rev-parse", "HEAD")[:12] + "+"


def test_an_installed_package_in_somebody_elses_checkout_has_no_commit(checkout):
    installed = checkout / "site-packages" / "rlbench"
    installed.mkdir(parents=True)
    assert commit(installed) == ""


def test_outside_a_checkout_there_is_no_commit(tmp_path):
    assert commit(tmp_path) == ""


def test_versions_are_those_installed():
    assert versions() == {"python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in ("torch", "mitsuba", "rlbench")
    }


def test_the_machine_is_described():
    found = machine()
    assert isinstance(found, Machine)
    assert found.cores >= 1
    assert found.cpu
    assert platform.system() in found.os


def test_provenance_needs_no_torch():
    code = "import sys, rlbench.system.provenance, rlbench.pools; assert 'torch' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
