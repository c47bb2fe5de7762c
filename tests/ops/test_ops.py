"""The public names of rlbench.ops: imported lazily, without clashes, all documented."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import rlbench.ops

STUB = ast.parse(Path(rlbench.ops.__file__).with_suffix(".pyi").read_text())


def test_importing_the_package_does_not_import_torch():
    code = "import sys, rlbench.ops; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_stub_lists_every_imported_name():
    (listed,) = (ast.literal_eval(n.value) for n in STUB.body if isinstance(n, ast.Assign))
    assert sorted(listed) == sorted(rlbench.ops.__all__)


@pytest.mark.parametrize("name", rlbench.ops.__all__)
def test_a_public_name_can_be_imported(name):
    value = getattr(rlbench.ops, name)
    assert not inspect.ismodule(value)
    assert not callable(value) or inspect.getdoc(value)


def test_no_name_clashes_with_a_submodule():
    """Importing a submodule sets it as an attribute of the package and would hide the name."""
    modules = {module.name for module in pkgutil.iter_modules(rlbench.ops.__path__)}
    assert modules.isdisjoint(rlbench.ops.__all__)


@pytest.mark.parametrize("module", [m.name for m in pkgutil.iter_modules(rlbench.ops.__path__)])
def test_names_come_from_the_public_names_of_their_modules(module):
    public = importlib.import_module(f"rlbench.ops.{module}").__all__
    imports = [n for n in STUB.body if isinstance(n, ast.ImportFrom) and n.module == module]
    assert {alias.name for n in imports for alias in n.names} <= set(public)
