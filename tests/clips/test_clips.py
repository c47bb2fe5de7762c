"""The public names of `rlbench.clips`, which are imported lazily."""

from __future__ import annotations

import subprocess
import sys

import pytest

import rlbench.clips


@pytest.mark.parametrize("module", ["rlbench.clips", "rlbench.clips.header"])
def test_torch_is_not_imported_with_the_package_or_the_header(module):
    code = f"import sys, {module}; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", rlbench.clips.__all__)
def test_every_public_name_exists_and_has_a_docstring(name):
    assert getattr(rlbench.clips, name).__doc__


def test_the_public_names_are_those_that_are_imported_lazily():
    assert sorted(rlbench.clips.__all__) == sorted(dir(rlbench.clips))


def test_an_unknown_name_is_an_error():
    with pytest.raises(AttributeError, match="colour"):
        rlbench.clips.colour  # noqa: B018
