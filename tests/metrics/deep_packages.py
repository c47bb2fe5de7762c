"""Import of metrics packages that need torchvision, beside PyTorch for processors too."""

from __future__ import annotations

import importlib
from types import ModuleType

import pytest
import torch


def import_or_skip(name: str) -> ModuleType:
    """The module `name`; skips the test where it or a package that it needs is not installed.

    PyPI's torchvision is built for CUDA, and beside PyTorch for processors its import fails where
    it describes its compiled operators to the compiler. No metric uses these, so the descriptions
    are left out.
    """
    with pytest.MonkeyPatch.context() as patch:
        if not torch.cuda.is_available():
            patch.setattr(torch.library, "register_fake", lambda *args, **options: lambda f: f)
        try:
            return importlib.import_module(name)
        except ImportError as error:
            pytest.skip(f"{name} cannot be imported: {error}", allow_module_level=True)
