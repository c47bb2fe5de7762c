"""Fixtures of all tests: one thread, a separate cache, small clips on disk, plugin files."""

from __future__ import annotations

import gc
import itertools
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, settings

from rlbench import registry
from rlbench.apps.render.mitsuba.variant import wheel_files
from rlbench.clips.frame_files import write_frame
from rlbench.clips.header import Header, write_header
from rlbench.registry.apps import load_apps
from rlbench.system import paths

# Dr.Jit loads LLVM on its first import, which may be a test's own: not an older one of the system
for library in wheel_files():
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(library))


CACHES = itertools.count()

# a busy machine is not a failure
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


def pytest_collection_finish() -> None:
    """Modules and tests live to the end: no garbage collection walks through them again."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what runs a command of an app that is not installed."""
    for mark in item.iter_markers("app"):
        if mark.args[0] not in load_apps():
            pytest.skip(f"the app {mark.args[0]} is not installed")


@pytest.fixture(autouse=True)
def _own_cache(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
):
    """Tests do not touch the user's cache; plugin files are unloaded after each test."""
    if "tmp_path" in request.fixturenames:
        folder = request.getfixturevalue("tmp_path")
    else:  # not made before something writes there: making a folder per test takes seconds
        folder = tmp_path_factory.getbasetemp() / "caches" / str(next(CACHES))
    monkeypatch.setenv("RLBENCH_CACHE", str(folder / "cache"))
    monkeypatch.setattr(paths, "_synchronize", lambda path: None)  # it takes 10 ms per file
    torch.set_num_threads(1)
    yield
    registry.clear_plugins()


@pytest.fixture
def native_bf16(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in bfloat16 here, whether or not this processor emulates it."""
    monkeypatch.setattr("rlbench.system.half_precision.emulation_reason", lambda device: "")


@pytest.fixture
def clip_folder(tmp_path: Path) -> Path:
    """A complete clip on disk: 3 frames of 20 x 24 pixels, seeded noise."""
    return write_noise(tmp_path / "clips" / "noise")


def write_noise(
    folder: Path, scene: str = "noise", frames: int = 3, h: int = 20, w: int = 24, **header: object
) -> Path:
    """Write a clip folder of noise around a gradient; `header` overrides fields of clip.toml."""
    rng = np.random.default_rng(len(folder.name))
    fields = {
        "name": folder.name,
        "scene": scene,
        "sampler": "numpy",
        "height": h,
        "width": w,
        "frames": frames,
        "reference_spp": (64,) * frames,
        "sample_ms": 2.0,
        "device": "another machine",
        **header,
    }
    truth = np.linspace(0.1, 0.9, h * w * 3, dtype=np.float32).reshape(h, w, 3)
    for index in range(frames):
        gbuffer = {
            "albedo": truth,
            "normal": np.full((h, w, 3), 3**-0.5, np.float32),
            "depth": np.full((h, w, 1), 5, np.float32),
            "motion": np.zeros((h, w, 2), np.float32),
        }
        pool = truth * rng.exponential(size=(8, h, w, 3)).astype(np.float32)
        halves = [truth + rng.normal(0, 1e-3, truth.shape).astype(np.float32) for _ in "AB"]
        write_frame(folder, index, gbuffer, {"path": pool}, *halves)
    write_header(folder, Header(**fields))
    return folder


def install_plugin(
    folder: Path, monkeypatch: pytest.MonkeyPatch, group: str, entry: str, package: str = "strange"
) -> None:
    """Make `entry`, such as "mine = module:FAMILY", known as a package that is installed does.

    Its modules lie in `folder`, or can be imported already.
    """
    information = folder / f"{package}-1.dist-info"
    information.mkdir(parents=True)
    metadata = f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\n"
    (information / "METADATA").write_text(metadata)
    (information / "entry_points.txt").write_text(f"[rlbench.{group}]\n{entry}\n")
    monkeypatch.syspath_prepend(str(folder))


def write_plugin(
    path: Path,
    name: str,
    gain: float = 1.0,
    traits: str = "",
    body: str = "return samples.mean * GAIN, None",
    build: str = "return Scaled()",
) -> Path:
    """Write a plugin file with a method whose denoiser returns gain * mean, or runs `body`."""
    path.write_text(
        f'''
from dataclasses import dataclass

import torch

from rlbench.family import Family, Traits, Variant

GAIN = {gain}
TRAITS = Traits({traits})


@dataclass(frozen=True)
class Scaled:
    traits: Traits = TRAITS

    def start(self, size):
        return None

    def plan(self, gbuffer, samples, state):
        return torch.ones_like(samples.counts, dtype=torch.float32)

    def denoise(self, gbuffer, samples, state):
        {body}


def build(variant, device, weights):
    {build}


FAMILY = Family(
    "{name}", "A title", "Nobody 2026", "MIT",
    {{"": Variant("?", TRAITS, learned=False), "B1": Variant("??", TRAITS, learned=False)}},
    "{path.stem}:build",
)
'''
    )
    return path
