"""A served scene, and no mirror or server of the user."""

from __future__ import annotations

import pytest

from tests.scene_server import SceneServer


@pytest.fixture(autouse=True)
def _no_settings(monkeypatch):
    for name in ("RLBENCH_SCENES", "RLBENCH_SCENES_URL", "RLBENCH_SCENES_API"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def server(tmp_path):
    """A server of the scene `attic`, which is pinned."""
    served = SceneServer(tmp_path / "repository")
    served.write_pin()
    yield served
    served.close()
