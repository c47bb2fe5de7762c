"""The XML room as a fixture."""

import pytest

from tests.apps.render.user.xml_room import document


@pytest.fixture
def room(llvm, tmp_path, monkeypatch):
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))
    return document(tmp_path / "room")
