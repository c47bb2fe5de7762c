"""A source for the tests of importers."""

from __future__ import annotations

import pytest

from tests.apps.dumps.importers.sources import write_oidn


@pytest.fixture
def source(tmp_path):
    """A folder of OIDN's training images: clip `walk`, 3 frames, 2 samples per pixel."""
    return write_oidn(tmp_path / "source")
