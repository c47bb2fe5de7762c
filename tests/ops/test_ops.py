"""The public names of rlbench.ops: imported lazily, without clashes, all documented."""

from __future__ import annotations

import ast
import importlib
import pkgutil
from pathlib import Path

import rlbench.ops

STUB = ast.parse(Path(rlbench.ops.__file__).with_suffix(".pyi").read_text())


def test_the_stub_lists_every_imported_name():
    (listed,) = (ast.literal_eval(n.value) for n in STUB.body if isinstance(n, ast.Assign))
    assert sorted(listed) == sorted(rlbench.ops.__all__)


def test_no_name_clashes_with_a_submodule():
    """Importing a submodule sets it as an attribute of the package and would hide the name."""
    modules = {module.name for module in pkgutil.iter_modules(rlbench.ops.__path__)}
    assert modules.isdisjoint(rlbench.ops.__all__)


def test_names_come_from_the_public_names_of_their_modules():
    for imported in (node for node in STUB.body if isinstance(node, ast.ImportFrom)):
        public = importlib.import_module(f"rlbench.ops.{imported.module}").__all__
        assert {alias.name for alias in imported.names} <= set(public)
