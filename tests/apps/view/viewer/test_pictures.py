"""Pictures of a page: rounded as finely as its size allows."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from rlbench.apps.view.viewer.pictures import PicturesError, pack_clips

T, SIDE = 3, 24


@dataclass(frozen=True)
class Images:
    method: str
    target_spp: float
    frames: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True)
class Clip:
    name: str
    scene: str
    fps: float
    cuts: tuple[int, ...]
    light_changes: tuple[int, ...]
    reference: np.ndarray
    buffers: dict[str, np.ndarray]
    images: tuple[Images, ...]


@pytest.fixture
def clip():
    rng = np.random.default_rng(0)
    frames = rng.lognormal(size=(T, 3, SIDE, SIDE)).astype(np.float32)
    own = Images("mean", 1.0, frames.astype(np.float16), np.ones((T, SIDE, SIDE), np.float16))
    depth = np.full((T, 1, SIDE, SIDE), np.inf, np.float32)
    return Clip("a", "a", 24.0, (1,), (), frames, {"depth": depth}, (own,))


def test_less_space_means_coarser_rounding(clip):
    sizes = [100_000, 40_000, 28_000]
    errors = [pack_clips([clip], size)[1] for size in sizes]
    assert errors == sorted(errors)
    assert errors[0] < errors[-1]


def test_texts_fit_the_space(clip):
    texts, _ = pack_clips([clip, replace(clip, name="b")], 60_000)
    assert sum(map(len, texts)) <= 60_000
    assert [json.loads(text)["name"] for text in texts] == ["a", "b"]


def test_images_that_do_not_fit_are_an_error_that_says_what_to_do(clip):
    with pytest.raises(PicturesError, match="--methods, --scenes or --spp, or .* --max-mb"):
        pack_clips([clip], 1000)


def test_a_page_without_clips_has_no_texts():
    assert pack_clips([], 10)[0] == []
