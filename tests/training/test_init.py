"""The public names of rlbench.training: imported on first use, and their examples are right."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import subprocess
import sys

import pytest

from rlbench import training

MODULES = [module.name for module in pkgutil.iter_modules(training.__path__)]


def test_importing_the_package_and_its_config_does_not_import_torch():
    code = (
        "import sys; import rlbench.training; from rlbench.training import TrainingConfig; "
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", training.__all__)
def test_every_public_name_can_be_imported(name):
    assert getattr(training, name) is not None


@pytest.mark.parametrize("module", MODULES)
def test_examples_in_docstrings_are_right(module):
    result = doctest.testmod(importlib.import_module(f"rlbench.training.{module}"))
    assert result.failed == 0


@pytest.mark.parametrize("module", MODULES)
def test_every_module_lists_its_public_names(module):
    imported = importlib.import_module(f"rlbench.training.{module}")
    assert [name for name in imported.__all__ if not hasattr(imported, name)] == []
